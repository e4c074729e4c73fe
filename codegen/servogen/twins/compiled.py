"""The generated C, compiled on this machine and called through ctypes."""

import ctypes as ct
import platform
import struct
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any, Protocol

import numpy as np

from servogen.law.law import shapes
from servogen.plan.module import Module, Result, StructField
from servogen.results import INFO_INTEGERS, INFO_REALS, Batch, Control, FloatArray, Info, Path, Status, refusal
from servogen.scalars import Scalar
from servogen.scene.limits import INPUTS
from servogen.scene.scene import Scene
from servogen.scene.system import Function
from servogen.tools import c_compiler, compile_c
from servogen.twins.batch import Call, States, run
from servogen.twins.interface import Twin

CROSS_CHECK_FLAGS = ("-std=c99", "-ffp-contract=off")

# One call for a stack of systems: a loop in C, so that Python's call costs nothing.
_STACK = """
#include "{p}.h"
void {p}_solve_stack(long n, const {real} *S, const {real} *z, const {real} *y, {limits}{real} *tau, {p}_info *info)
{{
    long k;
    for (k = 0; k < n; ++k) {{
        {p}_solve(S + k * {ml}, z + k * {m}, y ? y + k * {l} : 0, {at}tau + k * {l}, info + k);
    }}
}}
"""
_BATCH = """
#include "{p}_batch.h"
void {p}_solve_stack(long n, const {real} *S, const {real} *z, const {real} *y, {real} *tau, {p}_info *info)
{{
    {p}_solve_batch(S, z, y, (size_t)n, tau, info, NULL);
}}
"""
_PINV_STACK = """
void {p}_pinv_stack(long n, const {real} *S, {real} *S_pinv, {p}_info *info)
{{
    long k;
    for (k = 0; k < n; ++k) {{
        {p}_pinv(S + k * {ml}, S_pinv + k * {ml}, info + k);
    }}
}}
"""


class Built(Protocol):
    """A folder of generated C and what it was printed from, as a Package is; scene: None for a solver alone."""

    @property
    def path(self) -> FilePath: ...
    @property
    def manifest(self) -> Mapping[str, Any]: ...
    @property
    def module(self) -> Module: ...
    @property
    def scene(self) -> Scene | None: ...
    @property
    def prefix(self) -> str: ...
    @property
    def core(self) -> FilePath | None: ...


def stack_source(module: Module, batch: bool = False) -> str:
    """C that calls a solver's functions for stacks of systems, which CompiledSolver needs beside the package's.

    batch: the package has solve for many systems itself.
    """
    real, shape = module.target.real, _shape(module)
    limits, at = "", ""
    if module.limits is not None:
        limits = f"const {real} *lower, const {real} *upper, "
        at = "lower + k * {l}, upper + k * {l}, ".format(**shape)
    solve = _BATCH if batch else _STACK
    return (solve + _PINV_STACK).format(p=module.target.prefix, real=real, limits=limits, at=at, **shape)


def load_package(
    package: Built, compiler: str | None = None, flags: tuple[str, ...] = ("-O2",)
) -> "CompiledTwin | CompiledSolver | LimitedSolver":
    """Compile and load. Raises ToolMissing without a C compiler, CompilerUnusable or CompilerRefused where it fails."""
    module = package.module
    if package.scene is None:
        kind = CompiledSolver if module.limits is None else LimitedSolver
        stacks = stack_source(module, _batch_of(package) is not None)
        return kind(module, compile_library(package, compiler, flags, stacks))
    library = compile_library(package, compiler, flags)
    return CompiledTwin(package.scene, module, library)


def compile_library(package: Built, compiler: str | None, flags: tuple[str, ...], extra: str = "") -> ct.CDLL:
    """The package's C, and `extra` C beside it, as a shared library in this process."""
    with tempfile.TemporaryDirectory(prefix="servogen-load-") as folder:
        return ct.CDLL(str(build_library(package, FilePath(folder), compiler, flags, extra)))


def build_library(
    package: Built, folder: FilePath, compiler: str | None, flags: tuple[str, ...], extra: str = ""
) -> FilePath:
    """The shared library as a file in `folder`. Raises ToolMissing and CompilerRefused as load_package does."""
    command = c_compiler(compiler)
    library = folder / f"{package.prefix}.so"
    sources = [str(package.path / f"{package.prefix}.c")]
    folders = [f"-I{package.path}"]
    if package.core is not None:
        sources.append(str(package.core / f"{package.module.target.core}.c"))
        folders.append(f"-I{package.core}")
    native: list[str] = []
    batch = _batch_of(package)
    if batch is not None:
        sources.append(str(batch))
        native = ["-march=native"] if platform.machine() in ("x86_64", "AMD64") else []  # vectors as long as they come
    if extra:
        beside = folder / "extra.c"
        beside.write_text(extra)
        sources.append(str(beside))
    sources += [word for word in flags if word.endswith(".c")]
    chosen = [word for word in flags if not word.endswith(".c")]
    more = ["-fPIC", "-shared", *folders, *sources, "-o", str(library), "-lm"]
    compile_c(command, [*CROSS_CHECK_FLAGS, *native, *chosen], more, f"{package.prefix}.c")
    return library


def _batch_of(package: Built) -> FilePath | None:
    """The C that does control, or solve, for many states by vectors; None unless the package was built with batch.

    The manifest tells: a file of that name may be there from an earlier package.
    """
    name = f"{package.prefix}_batch.c"
    return package.path / name if name in package.manifest["files"] else None


def _shape(module: Module) -> dict[str, int]:
    assert module.solver is not None
    m, l = module.solver.m, module.solver.l
    return {"m": m, "l": l, "ml": m * l}


def c_real(scalar: Scalar) -> Any:
    """The C type of a scalar."""
    return ct.c_double if scalar == "float64" else ct.c_float


def _struct(name: str, fields: tuple[StructField, ...], scalar: Scalar) -> Any:
    real = c_real(scalar)
    members: list[tuple[str, Any]] = [(f.name, real * f.size if f.size > 1 else real) for f in fields]
    return type(name, (ct.Structure,), {"_fields_": members or [("none", ct.c_char)]})


def _model_struct(module: Module) -> Any:
    """<prefix>_model: its fields, and the matrix known in prepare with its pseudo-inverse and info."""
    if module.known_matrix is None or module.known_matrix.when == "generation":
        return _struct("model", module.model, module.target.scalar)
    assert module.solver is not None
    size = module.solver.m * module.solver.l
    fields = (*module.model, StructField("known_matrix", size), StructField("known_pinv", size))
    base = _struct("model", fields, module.target.scalar)
    return type("model_known", (base,), {"_fields_": [("known_info", _info_struct(module))]})


def _members(module: Module) -> list[tuple[str, bool, int]]:
    """Of <prefix>_info in its order: the name, whether it is an integer, and how many there are, 0 for one alone."""
    members = [*((n, True, 0) for n in INFO_INTEGERS), *((n, False, 0) for n in INFO_REALS)]
    if module.cascade is not None:
        levels = len(module.cascade.levels)
        members += [("level_residual", False, levels), ("level_rank", True, levels)]
    if module.limits is not None:
        members += [("scale", False, 0), ("active", True, 0)]
    return members


def _info_struct(module: Module) -> Any:
    real = c_real(module.target.scalar)
    kinds = ((name, ct.c_int if integer else real, count) for name, integer, count in _members(module))
    return type("info", (ct.Structure,), {"_fields_": [(n, kind * k if k else kind) for n, kind, k in kinds]})


def _info_dtype(module: Module) -> np.dtype[Any]:
    """An array of infos, as C lays it out."""
    real = np.dtype(module.target.scalar)
    members = [(n, np.dtype("i4") if integer else real, (k,) if k else ()) for n, integer, k in _members(module)]
    return np.dtype(members, align=True)


def _fill(struct: Any, fields: tuple[StructField, ...], values: dict[str, FloatArray]) -> Any:
    for f in fields:
        if f.size > 1:
            getattr(struct, f.name)[:] = [float(x) for x in values[f.name]]
        else:
            setattr(struct, f.name, float(values[f.name][0]))
    return struct


_NEVER_LEFT_OUT = ("q", "u", *INPUTS.values())
"""Inputs for which no default would make sense."""

_STATUS, _PATH = {int(s): s for s in Status}, {int(p): p for p in Path}


def _read_info(info: Any) -> Info:
    return Info(_STATUS[info.status], _PATH[info.path], info.rank, info.sweeps, info.sigma_min, info.residual)


def _reader(module: Module) -> Callable[[Any], Info]:
    """What reads <prefix>_info: of a package with limits or priorities, their members too."""
    more = [(name, count) for name, _, count in _members(module) if name not in (*INFO_INTEGERS, *INFO_REALS)]
    if not more:
        return _read_info

    def read(info: Any) -> Info:
        return replace(_read_info(info), **{n: getattr(info, n)[:] if k else getattr(info, n) for n, k in more})

    return read


class CompiledTwin(Twin):
    """A scene's generated C behind the interface of a twin."""

    def __init__(self, scene: Scene, module: Module, library: ct.CDLL) -> None:
        self._module = module
        self._library = library
        scalar = module.target.scalar
        self._params_type = _struct("params", module.parameters, scalar)
        self._info_type = _info_struct(module)
        self._read_info = _reader(module)
        self._model = _model_struct(module)()
        self._entries = {e.name: e for e in module.entry_points}
        self._layout = struct.Struct(f"{sum(f.size for f in module.inputs)}{'d' if scalar == 'float64' else 'f'}")
        self._value_type = c_real(scalar) * scene.controls
        self._found: dict[str, Any] = {}
        super().__init__(scene, scalar)

    def _function(self, entry: str) -> Any:
        """A function of the library, kept once found: looking takes longer than most of them."""
        if entry in self._found:
            return self._found[entry]
        there = ("prepare", *(e.name for e in self._module.entry_points), *(r.name for r in self._module.law.routines))
        if entry not in there:
            raise AttributeError(
                f"this package was built without {entry}; ask for it in entry_points (it has {', '.join(there)})"
            )
        return self._found.setdefault(entry, getattr(self._library, f"{self._module.target.prefix}_{entry}"))

    def _prepare(self, parameters: dict[str, FloatArray]) -> Status:
        params = _fill(self._params_type(), self._module.parameters, parameters)
        return Status(self._function("prepare")(ct.byref(params), ct.byref(self._model)))

    def _read(self, given: dict[str, Any], function: str) -> bytes:
        """<prefix>_input as C lays it out; numbers, lists and vectors of the right length without a detour."""
        return self._at_once(given) or self._input(self.read_inputs(given, function))

    def _at_once(self, given: dict[str, Any]) -> bytes | None:
        """None where something is missing, unknown, of another shape, or beyond the scalar: for whom to tell."""
        numbers: list[float] = []
        used = 0
        for f in self._module.inputs:
            value: Any = given.get(f.name, None if f.name in _NEVER_LEFT_OUT else f.default)
            used += f.name in given
            kind = type(value)
            if kind is float and f.size == 1:
                numbers.append(value)
            elif kind is np.ndarray and value.shape == (f.size,):
                numbers += value.tolist()
            elif kind in (list, tuple) and len(value) == f.size:
                numbers += value
            else:
                return None
        if used != len(given):
            return None
        try:
            return self._layout.pack(*numbers)
        except (struct.error, OverflowError, TypeError):
            return None

    def _input(self, inputs: dict[str, FloatArray]) -> bytes:
        """<prefix>_input as C lays it out: one type of member, so no padding."""
        with np.errstate(over="ignore"):  # beyond float32: an infinity, which the code refuses
            arrays = [inputs[f.name].astype(self.dtype) for f in self._module.inputs]
        return b"".join(a.tobytes() for a in arrays)

    def evaluate(self, entry: str, inputs: dict[str, FloatArray]) -> tuple[Status, tuple[FloatArray, ...]]:
        """Call an entry point by its C name: its status and outputs, NaN where untouched."""
        return self._outputs(entry, self._input(inputs))

    def _outputs(self, entry: str, packed: bytes) -> tuple[Status, tuple[FloatArray, ...]]:
        function, results = self._function(entry), self._results(entry)
        outputs = tuple(np.full(r.size, np.nan, self.dtype) for r in results)
        pointers = [ct.c_void_p(o.ctypes.data) for o in outputs]
        status = Status(function(ct.byref(self._model), packed, *pointers))
        matrices = {f.name for f in self.scene.system.functions if len(f.shape) == 2}
        shaped = (
            o.reshape(r.rows, r.columns) if r.name in matrices else o for o, r in zip(outputs, results, strict=True)
        )
        return status, tuple(shaped)

    def _results(self, entry: str) -> tuple[Result, ...]:
        """What an entry point hands out, by name and shape: quantities, or the result of a routine of the law."""
        if entry in self._entries:
            return self._entries[entry].kernel.results
        law = self._module.law
        name = law.routine(entry).result
        return (Result(name, *shapes(law)[name], "", ""),)

    def _evaluate(self, name: str, inputs: bytes) -> FloatArray:
        return self._outputs(name, inputs)[1][0]

    def _pinv(self, matrix: FloatArray) -> tuple[FloatArray, Info]:
        S = np.ascontiguousarray(matrix, self.dtype)
        inverse = np.full(matrix.T.shape, np.nan, self.dtype)
        info = self._info_type()
        self._function("pinv")(ct.c_void_p(S.ctypes.data), ct.c_void_p(inverse.ctypes.data), ct.byref(info))
        return inverse, _read_info(info)

    def _control(self, entry: str, inputs: bytes, last: FloatArray, *numbers: float) -> Control:
        value = self._value_type.from_buffer_copy(last)
        info = self._info_type()
        before: list[Any] = [ct.byref(self._model), inputs, *(c_real(self.scalar)(number) for number in numbers)]
        self._function(entry)(*before, ct.byref(value), ct.byref(info))
        return Control(np.frombuffer(value, self.dtype), self._read_info(info))

    def _control_batch(
        self, entry: str, states: States, value: FloatArray, threads: int | None, *numbers: float
    ) -> Batch:
        info = np.zeros(states.count, _info_dtype(self._module))
        status = run(self._call(entry, *numbers), states, value, info, threads)
        info["status"] = status  # prepare's, where it refused a state's parameters
        info[status < 0] = _refused(info.dtype, status[status < 0])
        members = {n: info[n] for n in info.dtype.names or ()}
        if "scale" not in members:
            members |= {"scale": (status >= 0).astype(self.dtype), "active": np.zeros(states.count, np.int32)}
        if "level_rank" not in members:
            nothing = (states.count, 0)
            members |= {"level_rank": np.zeros(nothing, np.int32), "level_residual": np.zeros(nothing, self.dtype)}
        return Batch(value, **members)

    def _evaluate_batch(self, offered: Function, states: States, threads: int | None) -> FloatArray:
        values = np.full((states.count, *self.scene.shape_of(offered)), np.nan, self.dtype)
        run(self._call(offered.name), states, values, None, threads)
        return values

    def _call(self, entry: str, dt: float | None = None) -> Call:
        parameters, inputs = ([f.name for f in fields] for fields in (self._module.parameters, self._module.inputs))
        many = getattr(self._library, f"{self._module.target.prefix}_control_batch") if self._by_many(entry) else None
        return Call(self._function(entry), self._function("prepare"), self._model, parameters, inputs, dt, many)

    def _by_many(self, entry: str) -> bool:
        """Whether the package has its control function for many states, too (sg.build with batch)."""
        return entry == "control" and hasattr(self._library, f"{self._module.target.prefix}_control_batch")


def _refused(dtype: np.dtype[Any], status: Any) -> Any:
    """What `info` says of states that were refused, beside the status."""
    info = np.zeros(len(status), dtype)
    info["status"], info["path"] = status, Path.NONE
    return info


class _Solver:
    """What a pseudo-inverse alone has with limits or without."""

    def __init__(self, module: Module, library: ct.CDLL) -> None:
        assert module.solver is not None
        self.m, self.l = module.solver.m, module.solver.l
        self.dtype = np.dtype(module.target.scalar)
        self._library = library
        self._prefix = module.target.prefix
        self._info_type = _info_dtype(module)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {self.m}x{self.l} matrices, {self.dtype}>"

    def _solve(
        self, S: Any, z: Any, y: Any, limits: tuple[Any, ...], last: Any, active: Any = 0
    ) -> tuple[FloatArray, Info]:
        S, many = self._stack(S, (self.m, self.l), "S")
        z, _ = self._stack(z, (self.m,), "z", len(S))
        y = None if y is None else self._stack(y, (self.l,), "y", len(S))[0]
        tau = (
            np.zeros((len(S), self.l), self.dtype) if last is None else self._stack(last, (self.l,), "last", len(S))[0]
        )
        stacks = [self._limit(name, given, len(S)) for name, given in zip(("lower", "upper"), limits, strict=False)]
        return self._call("solve_stack", many, [S, z, y, *stacks], tau.copy(), active)

    def _limit(self, name: str, given: Any, count: int) -> FloatArray:
        """A limit of each system, from one for all of them."""
        value = np.asarray(given, self.dtype)
        value = np.broadcast_to(value, (count, self.l)) if value.ndim < 2 and value.size in (1, self.l) else value
        return self._stack(value, (self.l,), name, count)[0]

    def pinv(self, S: Any, last: Any = None) -> tuple[FloatArray, Info]:
        """S+ of shape (l, m), or (N, l, m)."""
        S, many = self._stack(S, (self.m, self.l), "S")
        shape = (self.l, self.m)
        inverse = (
            np.zeros((len(S), *shape), self.dtype) if last is None else self._stack(last, shape, "last", len(S))[0]
        )
        return self._call("pinv_stack", many, [S], inverse.copy())

    def _stack(
        self, value: Any, shape: tuple[int, ...], name: str, count: int | None = None
    ) -> tuple[FloatArray, bool]:
        array = np.ascontiguousarray(value, self.dtype)
        many = array.ndim == len(shape) + 1
        stacked = array if many else array[np.newaxis]
        if stacked.shape[1:] != shape or (count is not None and len(stacked) != count):
            raise ValueError(f"{name} has shape {array.shape}; it must be {shape}, or a stack of them as long as S's")
        return stacked, many

    def _call(
        self, entry: str, many: bool, arrays: list[Any], out: FloatArray, active: Any = 0
    ) -> tuple[FloatArray, Info]:
        info = np.zeros(len(out), self._info_type)
        if "active" in (self._info_type.names or ()):
            info["active"] = active
        pointers = [ct.c_void_p(None if a is None else a.ctypes.data) for a in arrays]
        function = getattr(self._library, f"{self._prefix}_{entry}")
        function.restype = None
        function(ct.c_long(len(out)), *pointers, ct.c_void_p(out.ctypes.data), ct.c_void_p(info.ctypes.data))
        if many:
            columns: list[Any] = [info[name] for name in self._info_type.names or ()]
            return out, Info(*columns)
        one = info[0]
        status = Status(int(one["status"]))
        if status < 0:
            return out[0], refusal(status)
        return out[0], Info(status, Path(int(one["path"])), *(one[name].item() for name in one.dtype.names[2:]))


class CompiledSolver(_Solver):
    """The pseudo-inverse alone: one system, or a stack of N (then `info` holds arrays of N)."""

    def solve(self, S: Any, z: Any, y: Any = None, last: Any = None) -> tuple[FloatArray, Info]:
        """tau = y + S+ (z - S y). S: (m, l), z: (m,), y, last and tau: (l,); or each with N in front."""
        return self._solve(S, z, y, (), last)


class LimitedSolver(_Solver):
    """The pseudo-inverse alone, its answer within limits of tau: one system, or a stack of N."""

    def solve(
        self,
        S: Any,
        z: Any,
        y: Any = None,
        lower: Any = -np.inf,
        upper: Any = np.inf,
        last: Any = None,
        active: Any = 0,
    ) -> tuple[FloatArray, Info]:
        """The best tau with lower <= tau <= upper (numerics.md: Limits). S: (m, l), z: (m,), the rest: (l,).

        Each with N in front for a stack; a limit may be a number or (l,) there, too. active: `info.active` of a system
        close to this one, or one for each: while it is right, the answer comes sooner; it is the same in any case.
        """
        return self._solve(S, z, y, (lower, upper), last, active)
