"""Test vectors as a C header: no file is read on the target, so the same vectors run on any board.

An expected value is a pair hi + lo of the target's scalars, so that errors below one unit in the last place can be
measured in the scalar itself: error = (value - hi) - lo.
"""

import dataclasses
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servogen.ir.balls import ball, working
from servogen.render.render import environment

Scalar = Literal["float64", "float32"]
Call = Literal["plain", "control", "pinv", "solve"]
Floats = NDArray[np.floating[Any]]
Integers = NDArray[np.integer[Any]]

ANY_ANSWER = 127
"""Expected status of a vector whose answer must be written, whatever the remark that comes with it."""
ANY_STATUS = -127
"""Expected status of a vector of which nothing is known but that a refusal leaves the outputs alone."""
ANY_RANK = -1
"""Expected rank of a vector whose rank is not compared."""
MAX_OUTPUTS = 8
"""Outputs one entry point may have; harness.h has this number too."""

_ARGUMENTS: dict[str, tuple[str, ...]] = {"pinv": ("S",), "solve": ("S", "z", "y")}
_OPTIONAL = {"y"}
_WITH_INFO = {"control", "pinv", "solve"}
_NUMBERS_PER_LINE = 5


@dataclass(frozen=True, eq=False)
class OutputVectors:
    """Expected values of one output of an entry point, for N vectors.

    hi, lo: (N, size) in the target's scalar; see `split`. tolerance: (N, size), absolute, inf where not compared.
    scale: the largest magnitude of the output over the domain; errors are reported in ulps of it.
    Rows whose expected status is negative are not read: there the output must stay as it was.
    """

    name: str
    size: int
    hi: Floats
    lo: Floats
    tolerance: Floats
    scale: float

    @classmethod
    def of(cls, name: str, expected: ArrayLike, tolerance: ArrayLike, scale: float, scalar: Scalar) -> "OutputVectors":
        """From expected values of shape (N, size), floats or balls, and a tolerance that broadcasts to it."""
        hi, lo = split(expected, scalar)
        tolerances = np.broadcast_to(np.asarray(tolerance, dtype=np.float64), hi.shape)
        return cls(name, hi.shape[1], hi, lo, tolerances, scale)


@dataclass(frozen=True, eq=False)
class EntryVectors:
    """One entry point: how it is called, and what must come back.

    name: as in the C name <prefix>_<name>. call: which signature.
        plain    (model, in, output, ...)
        control  (model, in, output, info), numbers before the output where there are any
        pinv     (S, output, info), with S in `arguments`
        solve    (S, z, y, output, info), with S, z and perhaps y in `arguments`; without, y is NULL
    status: (N,) expected status, ANY_ANSWER or ANY_STATUS; None stands for ANY_ANSWER throughout.
    rank: (N,) expected rank, or ANY_RANK; None compares none. numbers: what control takes beside the state, dt say.
    domain: errors are measured in ulps over the first `domain` vectors; those behind them (huge, say) are judged by
    their tolerance alone. None: over all.
    """

    name: str
    call: Call
    outputs: tuple[OutputVectors, ...]
    status: Integers | None = None
    rank: Integers | None = None
    numbers: tuple[float, ...] = ()
    arguments: Mapping[str, Floats] = field(default_factory=dict)
    domain: int | None = None

    @property
    def count(self) -> int:
        """N, the number of vectors."""
        return len(self.outputs[0].hi)

    @property
    def uses_model(self) -> bool:
        """Whether the entry point takes the model and the input struct."""
        return self.call not in _ARGUMENTS

    def at(self, places: Integers) -> "EntryVectors":
        """The vectors at these places, in rising order."""
        outputs = tuple(
            dataclasses.replace(o, hi=o.hi[places], lo=o.lo[places], tolerance=o.tolerance[places])
            for o in self.outputs
        )
        return dataclasses.replace(
            self,
            outputs=outputs,
            status=None if self.status is None else np.asarray(self.status)[places],
            rank=None if self.rank is None else np.asarray(self.rank)[places],
            arguments={name: values[places] for name, values in self.arguments.items()},
            domain=None if self.domain is None else int((places < self.domain).sum()),
        )

    def statuses(self) -> Integers:
        """The expected status of each vector, shape (N,)."""
        return np.full(self.count, ANY_ANSWER) if self.status is None else np.asarray(self.status)

    def comparisons(self, output: OutputVectors) -> int:
        """How many values of `output` the harness must compare if every status is as expected."""
        return int(np.isfinite(output.tolerance[self.statuses() >= 0]).sum())


@dataclass(frozen=True, eq=False)
class VectorSet:
    """All vectors of one package.

    params: values of members of <prefix>_params; a member left out keeps its default. input_fields: (name, size) of
    every member of <prefix>_input. inputs: name to (N, size), NaN and Inf welcome.
    """

    prefix: str
    scalar: Scalar
    entries: tuple[EntryVectors, ...]
    params: Mapping[str, float | list[float]] = field(default_factory=dict)
    input_fields: tuple[tuple[str, int], ...] = ()
    inputs: Mapping[str, Floats] = field(default_factory=dict)

    def thinned(self, count: int) -> "VectorSet":
        """At most `count` vectors of every entry point, evenly chosen."""
        return dataclasses.replace(
            self,
            entries=tuple(e.at(_evenly(e.count, count)) for e in self.entries),
            inputs={name: values[_evenly(len(values), count)] for name, values in self.inputs.items()},
        )


def _evenly(have: int, want: int) -> Integers:
    return np.arange(have) if have <= want else np.linspace(0, have - 1, want).round().astype(int)


def split(expected: ArrayLike, scalar: Scalar) -> tuple[Floats, Floats]:
    """The pair (hi, lo) of the target's scalars with hi the nearest to `expected` and hi + lo nearer still.

    expected: any shape, floats or balls. NaN stays NaN; what is finite and overflows becomes infinite.
    """
    exact = np.asarray(expected)
    kind = np.dtype(scalar)
    with np.errstate(over="ignore", invalid="ignore"):
        if exact.dtype == object:
            hi = np.array([float(x) for x in exact.flat], dtype=np.float64).reshape(exact.shape).astype(kind)
            with working():
                rest = [float(ball(x) - ball(h)) for x, h in zip(exact.flat, hi.flat, strict=True)]
            return hi, np.array(rest, dtype=np.float64).reshape(exact.shape).astype(kind)
        wide = exact.astype(np.float64)
        hi = wide.astype(kind)
        return hi, (wide - hi.astype(np.float64)).astype(kind)


def take(vectors: VectorSet, rows: ArrayLike) -> VectorSet:
    """The vectors of the given row numbers alone, in that order; all count as of the domain."""
    index = np.asarray(rows, dtype=np.intp)

    def pick(array: Any) -> Any:
        return None if array is None else np.asarray(array)[index]

    def pick_entry(entry: EntryVectors) -> EntryVectors:
        outputs = tuple(
            dataclasses.replace(o, hi=pick(o.hi), lo=pick(o.lo), tolerance=pick(o.tolerance)) for o in entry.outputs
        )
        arguments = {name: pick(array) for name, array in entry.arguments.items()}
        return dataclasses.replace(
            entry, outputs=outputs, status=pick(entry.status), rank=pick(entry.rank), arguments=arguments, domain=None
        )

    inputs = {name: pick(array) for name, array in vectors.inputs.items()}
    return dataclasses.replace(vectors, inputs=inputs, entries=tuple(pick_entry(e) for e in vectors.entries))


def render_vectors(vectors: VectorSet) -> str:
    """The C header <prefix>_vectors.h; the same vectors give the same bytes.

    Raises:
        ValueError: shapes, names or numbers do not fit together; the message says which.
    """
    return environment().get_template("vectors.h.j2").render(_context(vectors))


def data_bytes(vectors: VectorSet) -> int:
    """The memory that the header's arrays take on the target, in bytes (equal arrays are stored once)."""
    arrays: list[_Array] = _context(vectors)["arrays"]
    return sum(array.values.nbytes for array in arrays)


def ulp(scale: float, scalar: Scalar) -> float:
    """eps * 2^floor(log2(scale)), never below the smallest subnormal (which it is for a scale of zero)."""
    limits = np.finfo(scalar)
    smallest = float(limits.smallest_subnormal)
    if scale == 0:
        return smallest
    return max(smallest, math.ldexp(float(limits.eps), math.frexp(scale)[1] - 1))


@dataclass(frozen=True, eq=False)
class _Array:
    """A `static const` array as the template prints it."""

    ctype: str
    name: str
    values: NDArray[Any]

    @property
    def count(self) -> int:
        """Elements."""
        return self.values.size

    @property
    def text(self) -> str:
        """The initialiser's lines."""
        flat = self.values.ravel().tolist()
        words = [str(x) for x in flat] if self.ctype != "real" else [literal(x, self.values.dtype.name) for x in flat]
        lines = (words[i : i + _NUMBERS_PER_LINE] for i in range(0, len(words), _NUMBERS_PER_LINE))
        return ",\n".join("    " + ", ".join(line) for line in lines)


class _Pool:
    """The arrays of one header. Equal arrays share one name; an array whose rows are all equal keeps one row."""

    def __init__(self, scalar: Scalar) -> None:
        self.scalar = scalar
        self.arrays: list[_Array] = []
        self._known: dict[tuple[str, bytes], str] = {}

    def reals(self, name: str, values: Floats) -> dict[str, Any]:
        """The array's name, row length and stride; values: (N, size)."""
        rows = np.ascontiguousarray(values, dtype=self.scalar)
        if not len(rows):  # C has no empty arrays; that there are zero vectors the harness finds by itself
            rows = np.zeros((1, rows.shape[1]), dtype=self.scalar)
        bits = rows.view(f"u{rows.itemsize}")
        constant = bool((bits == bits[:1]).all())
        kept = rows[:1] if constant else rows
        return {
            "data": self._store("real", name, kept),
            "size": rows.shape[1],
            "stride": 0 if constant else rows.shape[1],
        }

    def small(self, name: str, values: Integers | None) -> str:
        """The name of an array of small integers, or NULL."""
        if values is None:
            return "NULL"
        if np.any(np.abs(values) > 127):
            raise ValueError(f"{name}: a status or rank lies beyond +-127")
        kept = np.asarray(values if len(values) else [0], dtype=np.int8)
        return self._store("int8_t", name, kept)

    def _store(self, ctype: str, name: str, values: NDArray[Any]) -> str:
        key = (ctype, values.tobytes())
        if key not in self._known:
            self._known[key] = name
            self.arrays.append(_Array(ctype, name, values))
        return self._known[key]


def literal(value: float, scalar: str) -> str:
    """A number as C writes it, exact in the scalar: hexadecimal."""
    if math.isnan(value):
        return "REAL_NAN"
    if math.isinf(value):
        return "REAL_INFINITY" if value > 0 else "-REAL_INFINITY"
    mantissa, exponent = value.hex().split("p")
    return mantissa.rstrip("0").rstrip(".") + "p" + exponent + ("f" if scalar == "float32" else "")


def _context(vectors: VectorSet) -> dict[str, Any]:
    """What the template prints."""
    _check_set(vectors)
    pool = _Pool(vectors.scalar)
    params = [
        {"name": name, **pool.reals(f"hv_param_{name}", np.atleast_2d(np.asarray(value, dtype=np.float64)))}
        for name, value in vectors.params.items()
    ]
    inputs = [
        {"name": name, **pool.reals(f"hv_input_{name}", vectors.inputs[name])} for name, _ in vectors.input_fields
    ]
    entries = [_entry(entry, vectors.scalar, pool) for entry in vectors.entries]
    return {
        "p": vectors.prefix,
        "scalar": vectors.scalar,
        "bits": 8 * np.dtype(vectors.scalar).itemsize,
        "has_model": any(entry.uses_model for entry in vectors.entries),
        "params": params,
        "inputs": inputs,
        "entries": entries,
        "arrays": pool.arrays,
    }


def _entry(entry: EntryVectors, scalar: Scalar, pool: _Pool) -> dict[str, Any]:
    """What the template prints of one entry point."""
    arguments = [
        {"name": name, "buffer": f"hv_argument_{entry.name}_{name}", **pool.reals(f"hv_{entry.name}_in_{name}", array)}
        for name, array in entry.arguments.items()
    ]
    return {
        "name": entry.name,
        "vectors": entry.count,
        "domain": entry.count if entry.domain is None else entry.domain,
        "uses_model": entry.uses_model,
        "has_info": entry.call in _WITH_INFO,
        "actuals": ", ".join(_actuals(entry, scalar)),
        "arguments": arguments,
        "outputs": [_output(entry, j, scalar, pool) for j in range(len(entry.outputs))],
        "status": pool.small(f"hv_{entry.name}_status", entry.status),
        "rank": pool.small(f"hv_{entry.name}_rank", entry.rank),
    }


def _actuals(entry: EntryVectors, scalar: Scalar) -> list[str]:
    """The arguments of the C call, without the info."""
    results = [f"out[{j}]" for j in range(len(entry.outputs))]
    if not entry.uses_model:
        given = [f"hv_argument_{entry.name}_{n}" if n in entry.arguments else "NULL" for n in _ARGUMENTS[entry.call]]
        return given + results
    numbers = [literal(float(np.dtype(scalar).type(number)), scalar) for number in entry.numbers]
    return ["&hv_model", "&in", *numbers, *results]


def _output(entry: EntryVectors, j: int, scalar: Scalar, pool: _Pool) -> dict[str, Any]:
    """What the template prints of output j; values that are not compared are zero, their tolerance -1."""
    output = entry.outputs[j]
    compared = np.isfinite(output.tolerance) & (entry.statuses() >= 0)[:, None]
    largest = float(np.finfo(scalar).max)  # a tolerance beyond float32 must not turn into "not compared"
    arrays = {
        "hi": np.where(compared, output.hi, 0),
        "lo": np.where(compared, output.lo, 0),
        "tolerance": np.where(compared, np.minimum(output.tolerance, largest), -1),
    }
    name = f"{entry.name}_{j}"
    return {
        "name": output.name,
        "size": output.size,
        "ulp": literal(ulp(output.scale, scalar), scalar),
        "guarded": f"hv_guarded_{name}",
        "exact": f"hv_exact_{name}",
        **{part: pool.reals(f"hv_{name}_{part}", array) for part, array in arrays.items()},
    }


def _check_set(vectors: VectorSet) -> None:
    """Raises ValueError where the parts of a set do not fit together."""
    p = vectors.prefix
    if vectors.scalar not in ("float64", "float32"):
        raise ValueError(f"vectors of {p}: scalar is {vectors.scalar!r}; it is float64 or float32")
    if not vectors.entries:
        raise ValueError(f"vectors of {p}: there is no entry point to check")
    if repeated := {e.name for e in vectors.entries if [x.name for x in vectors.entries].count(e.name) > 1}:
        raise ValueError(f"vectors of {p}: entry points given twice: {', '.join(sorted(repeated))}")
    if unknown := set(vectors.inputs) ^ {name for name, _ in vectors.input_fields}:
        raise ValueError(f"vectors of {p}: inputs and input_fields disagree on {', '.join(sorted(unknown))}")
    for name, size in vectors.input_fields:
        _check_shape(f"vectors of {p}, input {name}", vectors.inputs[name], (None, size))
    for entry in vectors.entries:
        _check_entry(f"vectors of {p}, entry {entry.name}", entry, vectors)


def _check_entry(where: str, entry: EntryVectors, vectors: VectorSet) -> None:
    """Raises ValueError where one entry point's vectors do not fit together."""
    if not 0 < len(entry.outputs) <= MAX_OUTPUTS:
        raise ValueError(f"{where}: {len(entry.outputs)} outputs; give 1 to {MAX_OUTPUTS}")
    if entry.call != "plain" and len(entry.outputs) != 1:
        raise ValueError(f"{where}: the call {entry.call!r} has one output, {len(entry.outputs)} are given")
    if entry.numbers and entry.call != "control":
        raise ValueError(f"{where}: numbers belong to the call 'control', and only to it")
    if entry.rank is not None and entry.call not in _WITH_INFO:
        raise ValueError(f"{where}: the call {entry.call!r} reports no rank; leave rank at None")
    _check_arguments(where, entry)
    lengths = {f"input {name}": len(array) for name, array in vectors.inputs.items()} if entry.uses_model else {}
    lengths |= {f"argument {name}": len(array) for name, array in entry.arguments.items()}
    lengths |= {name: len(a) for name, a in (("status", entry.status), ("rank", entry.rank)) if a is not None}
    lengths |= {f"output {output.name}": len(output.hi) for output in entry.outputs}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"{where}: numbers of vectors differ: {lengths}")
    for output in entry.outputs:
        _check_output(f"{where}, output {output.name}", entry, output, vectors.scalar)


def _check_arguments(where: str, entry: EntryVectors) -> None:
    """Raises ValueError unless the arrays passed as pointers are those the call takes."""
    wanted = set(_ARGUMENTS.get(entry.call, ()))
    if missing := wanted - _OPTIONAL - set(entry.arguments):
        raise ValueError(f"{where}: the call {entry.call!r} lacks arguments: {', '.join(sorted(missing))}")
    if unknown := set(entry.arguments) - wanted:
        raise ValueError(f"{where}: the call {entry.call!r} takes no {', '.join(sorted(unknown))}")
    for name, array in entry.arguments.items():
        _check_shape(f"{where}, argument {name}", array, (None, None))


def _check_output(where: str, entry: EntryVectors, output: OutputVectors, scalar: Scalar) -> None:
    """Raises ValueError where one output's arrays do not fit together, or hold numbers that prove nothing."""
    if not re.fullmatch(r"[A-Za-z_]\w*", output.name):
        raise ValueError(f"{where}: the name is no C identifier")
    if output.size < 1:
        raise ValueError(f"{where}: size is {output.size}; an output has at least one value")
    if not (math.isfinite(output.scale) and output.scale >= 0):
        raise ValueError(f"{where}: scale is {output.scale}; give the largest magnitude over the domain")
    shape = (entry.count, output.size)
    for part in ("hi", "lo", "tolerance"):
        _check_shape(f"{where}, {part}", getattr(output, part), shape)
    for part in ("hi", "lo"):
        if getattr(output, part).dtype != np.dtype(scalar):
            raise ValueError(f"{where}, {part}: {getattr(output, part).dtype}, not {scalar}; use OutputVectors.of")
    answered = (entry.statuses() >= 0)[:, None]
    if np.any(answered & ~(output.tolerance >= 0)):
        raise ValueError(f"{where}: tolerances must not be negative or NaN (inf: not compared)")
    compared = answered & np.isfinite(output.tolerance)
    if np.any(compared & ~(np.isfinite(output.hi) & np.isfinite(output.lo))):
        row = int(np.argwhere(compared & ~(np.isfinite(output.hi) & np.isfinite(output.lo)))[0][0])
        raise ValueError(f"{where}, vector {row}: the expected value is not finite in {scalar}, but is compared")


def _check_shape(where: str, array: Any, shape: tuple[int | None, int | None]) -> None:
    """Raises ValueError unless `array` is two-dimensional with that shape; None is any length."""
    given = np.shape(array)
    if len(given) != 2 or any(w is not None and w != g for w, g in zip(shape, given, strict=True)):
        wanted = ", ".join("N" if n is None else str(n) for n in shape)
        raise ValueError(f"{where}: shape {given}, expected ({wanted})")
