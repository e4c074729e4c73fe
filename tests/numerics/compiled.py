"""Renders a solver's templates alone, compiles them with the host's compiler and calls them through ctypes."""

import ctypes
import functools
import hashlib
import subprocess
import tempfile
from pathlib import Path as FilePath

import jinja2
import numpy as np

from servogen.plan.solver import SolverPlan, plan_solver, solver_context
from servogen.results import FloatArray, Info, Path, Status
from servogen.scene.solver import Scalar, Solver

STRICT = (
    "-std=c99 -Wall -Wextra -Wpedantic -Wconversion -Wdouble-promotion -Wmissing-prototypes -Wshadow -Werror "
    "-ffp-contract=off"
).split()

TEMPLATES = FilePath(__file__).parents[2] / "codegen" / "servogen" / "render" / "templates"


def literal(value: float, scalar: str) -> str:
    """The shortest decimal that comes back as the same number of the target type."""
    if scalar == "float64":
        text = repr(float(value))
    else:
        text = str(np.float32(value))
        assert np.float32(text) == np.float32(value)
    return text + ("f" if scalar == "float32" else "")


WRAPPERS = """
int {p}_solve(const {real} *S, const {real} *z, const {real} *y, {real} *tau, {p}_info *info);
int {p}_pinv(const {real} *S, {real} *S_pinv, {p}_info *info);
int {p}_solve(const {real} *S, const {real} *z, const {real} *y, {real} *tau, {p}_info *info)
{{
    return {p}_solve_core(S, z, y, tau, info);
}}
int {p}_pinv(const {real} *S, {real} *S_pinv, {p}_info *info)
{{
    return {p}_pinv_core(S, S_pinv, info);
}}
"""

# Stacks are looped over in C: a call through ctypes costs more than a solve.
STACKED = """
void {p}_solve_stack(long n, const {real} *S, const {real} *z, const {real} *y, {real} *tau, {p}_info *info);
void {p}_pinv_stack(long n, const {real} *S, {real} *S_pinv, {p}_info *info);
void {p}_solve_stack(long n, const {real} *S, const {real} *z, const {real} *y, {real} *tau, {p}_info *info)
{{
    long i;
    for (i = 0; i < n; ++i) {{
        (void){p}_solve_core(S + i * {m} * {l}, z + i * {m}, y ? y + i * {l} : NULL, tau + i * {l}, info + i);
    }}
}}
void {p}_pinv_stack(long n, const {real} *S, {real} *S_pinv, {p}_info *info)
{{
    long i;
    for (i = 0; i < n; ++i) {{
        (void){p}_pinv_core(S + i * {m} * {l}, S_pinv + i * {m} * {l}, info + i);
    }}
}}
"""


def render(plan: SolverPlan, prefix: str = "pinv", extra: str = "") -> str:
    """A whole C file: the info type, the two cores, and functions with external linkage around them."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    context = solver_context(plan, prefix, lambda value: literal(value, plan.scalar))
    names = {"p": prefix, "real": plan.real, "m": plan.m, "l": plan.l}
    return "\n".join(
        [
            "#include <math.h>\n#include <stddef.h>\n#include <stdint.h>\n",
            environment.get_template("solver/info.h.j2").render(context),
            environment.get_template("solver/solver.c.j2").render(context),
            (WRAPPERS + extra).format(**names),
        ]
    )


class CTwin:
    """The compiled solver: `solve` and `pinv` for one system or a stack of N."""

    def __init__(self, plan: SolverPlan, library: ctypes.CDLL, prefix: str = "pinv") -> None:
        self.plan = plan
        self.dtype = np.dtype(plan.scalar)
        self.library = library
        self.record = np.dtype(
            [(n, np.int32) for n in ("status", "path", "rank", "sweeps")]
            + [(n, self.dtype) for n in ("sigma_min", "residual")]
        )
        self._solve = getattr(library, f"{prefix}_solve_stack")
        self._pinv = getattr(library, f"{prefix}_pinv_stack")
        self.solve_one = getattr(library, f"{prefix}_solve")
        self.pinv_one = getattr(library, f"{prefix}_pinv")

    def solve_raw(self, S, z, y=None, last=None):  # noqa: ANN001, ANN201
        """A stack: tau (N, l) and the infos as one structured array."""
        m, l = self.plan.m, self.plan.l  # noqa: E741
        S = np.ascontiguousarray(S, self.dtype).reshape(-1, m, l)
        z = np.ascontiguousarray(z, self.dtype).reshape(-1, m)
        n = len(S)
        assert len(z) == n
        y = None if y is None else np.ascontiguousarray(y, self.dtype).reshape(n, l)
        tau = np.zeros((n, l), self.dtype) if last is None else np.array(last, self.dtype).reshape(n, l)
        info = np.zeros(n, self.record)
        self._solve(ctypes.c_long(n), _at(S), _at(z), _at(y), _at(tau), _at(info))
        return tau, info

    def pinv_raw(self, S, last=None):  # noqa: ANN001, ANN201
        m, l = self.plan.m, self.plan.l  # noqa: E741
        S = np.ascontiguousarray(S, self.dtype).reshape(-1, m, l)
        n = len(S)
        out = np.zeros((n, l, m), self.dtype) if last is None else np.array(last, self.dtype).reshape(n, l, m)
        info = np.zeros(n, self.record)
        self._pinv(ctypes.c_long(n), _at(S), _at(out), _at(info))
        return out, info

    def solve(self, S, z, y=None, last=None) -> tuple[FloatArray, Info]:  # noqa: ANN001
        tau, info = self.solve_raw(S, z, y, last)
        return (tau, info) if np.ndim(S) == 3 else (tau[0], _info(info[0]))

    def pinv(self, S, last=None) -> tuple[FloatArray, Info]:  # noqa: ANN001
        matrix, info = self.pinv_raw(S, last)
        return (matrix, info) if np.ndim(S) == 3 else (matrix[0], _info(info[0]))


def _at(array: np.ndarray | None) -> ctypes.c_void_p:
    return ctypes.c_void_p(None if array is None else array.ctypes.data)


def _info(record: np.void) -> Info:
    return Info(
        Status(int(record["status"])),
        Path(int(record["path"])),
        int(record["rank"]),
        int(record["sweeps"]),
        float(record["sigma_min"]),
        float(record["residual"]),
    )


@functools.cache
def _folder() -> FilePath:
    return FilePath(tempfile.mkdtemp(prefix="servogen-solver-"))


@functools.cache
def compile_solver(plan: SolverPlan, compiler: str = "gcc", optimise: str = "-O2") -> CTwin:
    """Compiled once per plan, compiler and level."""
    text = render(plan, extra=STACKED)
    name = hashlib.sha256(f"{text}{compiler}{optimise}".encode()).hexdigest()[:16]
    source = _folder() / f"{name}.c"
    source.write_text(text)
    target = source.with_suffix(".so")
    command = [compiler, *STRICT, *optimise.split(), "-shared", "-fPIC", str(source), "-o", str(target), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return CTwin(plan, ctypes.CDLL(str(target)))


def make(m: int, l: int, scalar: Scalar, solver: Solver) -> CTwin:  # noqa: E741
    return compile_solver(plan_solver(m, l, scalar, solver))
