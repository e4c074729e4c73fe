"""Many states at once: their arrays are read as one state's numbers are, and a loop in C calls a generated function."""

import ctypes as ct
import os
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from servogen.results import FloatArray, IntArray
from servogen.scene.symbols import Field
from servogen.tools import c_compiler, compile_c

STATES_FOR_A_THREAD = 500
"""Fewer are not worth a thread: they take about as long as starting one."""

STATES_IN_A_BLOCK = 128
"""Their inputs stay in the cache between being copied and being read."""

# The loop knows no scene. It copies the numbers of one state from their arrays into the struct that the function reads,
# whose members have one type and so no padding; it is compiled once in a process, for any package and either scalar.
_LOOP = (
    f"""
#include <string.h>

#define BLOCK {STATES_IN_A_BLOCK}
"""
    + """

struct span { const char *first; long stride; long bytes; };
struct batch {
    int (*prepare)(const void *params, void *model);   /* null: one model for all states */
    void *function;
    void *many;                                         /* the same for states of one model; null: there is none */
    long takes_dt;                                      /* 0: no; else the size of its scalar */
    double dt;
    long parameters, inputs;                            /* how many spans each */
    const struct span *parameter, *input;
    char *value, *info;                                 /* info null: the function has none */
    long value_bytes, info_bytes;
    int *status;
};

typedef size_t answers(const void *model, const void *in, size_t n, void *value, void *info, int *status);
typedef int evaluation(const void *model, const void *in, void *value);
typedef int answer(const void *model, const void *in, void *value, void *info);
typedef int step_double(const void *model, const void *in, double dt, void *value, void *info);
typedef int step_float(const void *model, const void *in, float dt, void *value, void *info);

static char *gather(const struct span *spans, long count, long state, char *to)
{
    long j;
    for (j = 0; j < count; ++j) {
        const char *from = spans[j].first + state * spans[j].stride;
        const char *const end = from + spans[j].bytes;
        for (; from < end; from += 4, to += 4) { /* numbers of 4 or 8 bytes, too few of them for a call of memcpy */
            memcpy(to, from, 4);
        }
    }
    return to;
}

void run_batch(const struct batch *b, long first, long end, void *params, void *model, void *in)
{
    long k;
    if (b->many && !b->prepare) {
        for (k = first; k < end; k += BLOCK) {
            const long last = end - k < BLOCK ? end : k + BLOCK;
            char *to = in;
            long j;
            for (j = k; j < last; ++j) {
                to = gather(b->input, b->inputs, j, to);
            }
            ((answers *)b->many)(model, in, (size_t)(last - k), b->value + k * b->value_bytes,
                                 b->info + k * b->info_bytes, b->status + k);
        }
        return;
    }
    for (k = first; k < end; ++k) {
        char *value = b->value + k * b->value_bytes;
        char *info = b->info ? b->info + k * b->info_bytes : 0;
        int status = 0;
        if (b->prepare) {
            gather(b->parameter, b->parameters, k, params);
            status = b->prepare(params, model);
        }
        if (status >= 0) {
            gather(b->input, b->inputs, k, in);
            if (!b->info) {
                status = ((evaluation *)b->function)(model, in, value);
            } else if (b->takes_dt == 0) {
                status = ((answer *)b->function)(model, in, value, info);
            } else if (b->takes_dt == sizeof(double)) {
                status = ((step_double *)b->function)(model, in, b->dt, value, info);
            } else {
                status = ((step_float *)b->function)(model, in, (float)b->dt, value, info);
            }
        }
        b->status[k] = status;
    }
}
"""
)


class _Span(ct.Structure):
    _fields_ = [("first", ct.c_void_p), ("stride", ct.c_long), ("bytes", ct.c_long)]


class _Batch(ct.Structure):
    _fields_ = [
        ("prepare", ct.c_void_p),
        ("function", ct.c_void_p),
        ("many", ct.c_void_p),
        ("takes_dt", ct.c_long),
        ("dt", ct.c_double),
        ("parameters", ct.c_long),
        ("inputs", ct.c_long),
        ("parameter", ct.POINTER(_Span)),
        ("input", ct.POINTER(_Span)),
        ("value", ct.c_void_p),
        ("info", ct.c_void_p),
        ("value_bytes", ct.c_long),
        ("info_bytes", ct.c_long),
        ("status", ct.c_void_p),
    ]


@dataclass(frozen=True)
class States:
    """Numbers of N states by name: arrays of shape (N, size), or (1, size) where all states share them."""

    count: int
    inputs: Mapping[str, FloatArray]
    parameters: Mapping[str, FloatArray]  # empty: the twin's own, as it was prepared

    def one(self, k: int) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
        """Inputs and parameters of state k, each an array (size,)."""

        def row(values: FloatArray) -> FloatArray:
            state: FloatArray = values[k if len(values) > 1 else 0]
            return state

        return {n: row(v) for n, v in self.inputs.items()}, {n: row(v) for n, v in self.parameters.items()}


def check_threads(threads: Any) -> None:
    """ValueError unless it is a number of threads, or None."""
    whole = isinstance(threads, (int, np.integer)) and not isinstance(threads, bool)
    if threads is not None and not (whole and threads >= 1):
        raise ValueError(f"threads={threads!r}: give a whole number from 1, or None for one a core")


def read_states(
    given: Mapping[str, Any],
    inputs: Mapping[str, Field],
    known: Iterable[str],
    parameters: Mapping[str, FloatArray],
    dtype: np.dtype[Any],
    function: str,
) -> States:
    """The arrays of a batch's keywords, without a copy where they are of `dtype` and each state's numbers lie together.

    inputs: the scene's. known: names that it knows and does not use. parameters: as they were prepared, each (size,).
    Raises TypeError for unknown names, ValueError for shapes that are not (size,), (N, size), or (N,) of one number.
    """
    sizes = {n: f.size for n, f in inputs.items()} | {n: len(v) for n, v in parameters.items()}
    unused = set(known) - set(sizes)
    for name in given:
        if name not in sizes and name not in unused:
            raise TypeError(f"{function}: no input or parameter {name!r}; there are {', '.join([*sizes, *unused])}")
    read = {n: _rows(v, sizes[n], n, dtype) for n, v in given.items() if n in sizes}
    lengths = {n: len(v) for n, (v, many) in read.items() if many}
    count = next(iter(lengths.values()), 1)
    for name, length in lengths.items():
        if length != count:
            first = next(iter(lengths))
            raise ValueError(f"{function}: {first} has {count} states and {name} has {length}; give one number of them")
    arrays = {n: v for n, (v, _) in read.items()}
    shared = {n: _rows(f.default, f.size, n, dtype)[0] for n, f in inputs.items() if n not in arrays}
    told = any(n in parameters for n in arrays)
    prepared = {n: arrays.get(n, np.asarray(v, dtype)[np.newaxis]) for n, v in parameters.items()} if told else {}
    return States(count, {n: arrays[n] if n in arrays else shared[n] for n in inputs}, prepared)


def _rows(value: Any, size: int, name: str, dtype: np.dtype[Any]) -> tuple[FloatArray, bool]:
    """The array (N, size) of what was given, and whether it has a row a state: else all share its one row."""
    try:
        if value is None or np.iscomplexobj(value):
            raise TypeError
        with np.errstate(over="ignore"):  # beyond float32: an infinity, which the code refuses
            array = np.asarray(value, dtype)
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(f"{name}: give numbers of shape ({size},), or (N, {size}) for N states") from None
    if size == 1 and array.ndim == 1 and len(array) != 1:
        array = array[:, np.newaxis]
    if array.shape in ((), (size,)) and array.size == size:
        return array.reshape(1, size), False
    if array.ndim != 2 or array.shape[1] != size:
        raise ValueError(f"{name} has shape {array.shape}; give ({size},), or (N, {size}) for N states")
    together = size == 1 or array.strides[1] == array.itemsize
    return (array if together else np.ascontiguousarray(array)), True


@dataclass(frozen=True)
class Call:
    """A generated function to be called at many states.

    prepare: of its package. model: as prepared, a ctypes struct. parameters, inputs: the members of its structs. dt: of
    a function that takes one. many: its package's function that does the same for many states, None where it has none.
    """

    function: Any
    prepare: Any
    model: Any
    parameters: Sequence[str]
    inputs: Sequence[str]
    dt: float | None = None
    many: Any = None


def run(call: Call, states: States, value: FloatArray, info: Any, threads: int | None) -> IntArray:
    """Call a function at each state: writes value (N, ...) and info (N,), returns the statuses (N,).

    info: None for a function that has none. threads: None for one a core; the bits are the same for any number.
    """
    parameters = [states.parameters[n] for n in call.parameters] if states.parameters else []
    inputs = [states.inputs[n] for n in call.inputs]
    status = np.zeros(states.count, np.int32)
    work = _Batch(
        prepare=_address(call.prepare) if states.parameters else None,
        function=_address(call.function),
        many=None if call.many is None else _address(call.many),
        takes_dt=0 if call.dt is None else value.itemsize,
        dt=call.dt or 0.0,
        parameters=len(parameters),
        inputs=len(inputs),
        parameter=_spans(parameters),
        input=_spans(inputs),
        value=value.ctypes.data,
        info=None if info is None else info.ctypes.data,
        value_bytes=value[:1].nbytes,
        info_bytes=0 if info is None else info.itemsize,
        status=status.ctypes.data,
    )

    def part(first: int, end: int) -> None:
        model = type(call.model).from_buffer_copy(call.model)  # a thread's own, where each state has its parameters
        sizes = [sum(v[:1].nbytes for v in arrays) for arrays in (parameters, inputs)]
        room = [ct.create_string_buffer(sizes[0] or 1), ct.create_string_buffer(sizes[1] * STATES_IN_A_BLOCK or 1)]
        _loop()(ct.byref(work), first, end, room[0], ct.byref(model), room[1])

    most = (os.cpu_count() or 1) if threads is None else threads
    pieces = max(1, min(most, states.count // STATES_FOR_A_THREAD))
    edges = [states.count * k // pieces for k in range(pieces + 1)]
    if pieces == 1:
        part(0, states.count)
    else:
        with ThreadPoolExecutor(pieces) as pool:  # ctypes lets go of the interpreter while C runs
            list(pool.map(part, edges[:-1], edges[1:]))
    return status


def _spans(arrays: Sequence[FloatArray]) -> Any:
    spans = (_Span * max(1, len(arrays)))()
    for span, array in zip(spans, arrays, strict=False):
        stride = array.strides[0] if len(array) > 1 else 0
        span.first, span.stride, span.bytes = array.ctypes.data, stride, array.shape[1] * array.itemsize
    return spans


def _address(function: Any) -> int | None:
    return ct.cast(function, ct.c_void_p).value


@cache
def _loop() -> Any:
    """`run_batch`, compiled for this process."""
    with tempfile.TemporaryDirectory(prefix="servogen-batch-") as folder:
        source, library = Path(folder) / "batch.c", Path(folder) / "batch.so"
        source.write_text(_LOOP)
        compile_c(c_compiler(), ["-O2"], ["-fPIC", "-shared", str(source), "-o", str(library)], "the loop of a batch")
        loop = ct.CDLL(str(library)).run_batch
    loop.restype = None
    loop.argtypes = [ct.POINTER(_Batch), ct.c_long, ct.c_long, ct.c_void_p, ct.c_void_p, ct.c_void_p]
    return loop
