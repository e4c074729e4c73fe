"""Who takes part in the diagrams of run time against error: our steps, CasADi's C, Eigen and LAPACK, Python."""

import dataclasses
import re
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import scipy.linalg

from servogen.compiler import target_for
from servogen.law.steps import SYSTEM
from servogen.package import write
from servogen.plan.planner import plan_solver_only
from servogen.render.render import render
from servogen.results import FloatArray
from servogen.scalars import EPSILON, Scalar
from servogen.scene.solver import Solver

HERE = Path(__file__).parent
FLAGS = ("-O2", "-march=native")
REFINEMENT = re.compile(r"^    /\* refined once.*?(?=^    if \()", re.DOTALL | re.MULTILINE)
"""The generated C's step of refinement, from its comment to the test of the answer's range."""


@dataclass(frozen=True)
class Variant:
    """One of ours: a generated package, perhaps with other limits of NORMAL's certificate, or its refinement cut."""

    name: str
    prefix: str
    solver: Solver = field(default_factory=Solver)
    limits: Mapping[str, float] = field(default_factory=dict)
    refined: bool = True


def variants(scalar: Scalar) -> tuple[Variant, ...]:
    """auto; each step whatever its certificate says; forced SVD; and those without refinement."""
    always = 2.0**100 if scalar == "float64" else 2.0**60
    steps = (
        Variant("servogen NORMAL, unproven", "normal", limits={"normal_limit": always, "normal_floor": 0.0}),
        Variant("servogen QR (NORMAL in vain)", "qr", limits={"normal_limit": 0.0}),
        Variant("servogen SVD", "svd", Solver(method="svd")),
        Variant("servogen COD", "complete", Solver(method="cod")),
    )
    bare = tuple(
        dataclasses.replace(v, name=f"{v.name}, unrefined", prefix=f"{v.prefix}_bare", refined=False) for v in steps
    )
    return (Variant("servogen auto", "automatic"), *steps, *bare)


def generate(m: int, l: int, scalar: Scalar, variant: Variant, folder: Path) -> Path:
    """The package's C file."""
    module = plan_solver_only(m, l, target_for("pinv", scalar, variant.prefix), variant.solver)
    assert module.solver is not None
    changed: dict[str, Any] = dict(variant.limits)
    module = dataclasses.replace(module, solvers={SYSTEM: dataclasses.replace(module.solver, **changed)})
    path = write(render(module), folder / variant.prefix, module, None).path / f"{variant.prefix}.c"
    if not variant.refined:
        cut, found = REFINEMENT.subn("", path.read_text())
        if not found:
            raise RuntimeError(f"{path.name} has no refinement to cut: REFINEMENT no longer fits the templates")
        path.write_text(cut)
    return path


def casadi_pinv(m: int, l: int, scalar: Scalar, folder: Path) -> Path:
    """CasADi's own C of pinv(S) z. S^T is its input: CasADi stores columns, we rows."""
    S_transposed, z = ca.SX.sym("S", l, m), ca.SX.sym("z", m)
    function = ca.Function("casadi_rival", [S_transposed, z], [ca.mtimes(ca.pinv(S_transposed.T), z)])
    real = "double" if scalar == "float64" else "float"
    generator = ca.CodeGenerator("casadi_rival", {"casadi_real": real})
    generator.add(function)
    generator.generate(f"{folder}/")
    return folder / "casadi_rival.c"


def header(m: int, l: int, scalar: Scalar, chosen: tuple[Variant, ...]) -> str:
    """C++ that declares our packages and CasADi's C, and lists them as contenders."""
    real = "double" if scalar == "float64" else "float"
    lines = ['extern "C" {']
    lines += [f'#include "{v.prefix}/{v.prefix}.h"' for v in chosen]
    lines.append(f"int casadi_rival(const {real} **arg, {real} **res, long long int *iw, {real} *w, int mem);")
    lines.append("int casadi_rival_work(long long int *, long long int *, long long int *, long long int *);")
    lines.append("}")
    for v in chosen:
        lines.append(
            f"static void run_{v.prefix}(int i) {{ {v.prefix}_solve(&S[i * {m * l}], &z[i * {m}], nullptr, "
            f"&tau[i * {l}], nullptr); }}"
        )
    lines.append(
        f"static void run_casadi(int i)\n{{\n    const {real} *arg[8] = {{&S[i * {m * l}], &z[i * {m}]}};\n"
        f"    {real} *res[8] = {{&tau[i * {l}]}};\n    casadi_rival(arg, res, nullptr, nullptr, 0);\n}}"
    )
    names = [f'{{"{v.name}", run_{v.prefix}}},' for v in chosen]
    lines.append(f'#define OUR_CONTENDERS {" ".join(names)} {{"casadi.pinv, generated C", run_casadi}},')
    return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class Library:
    """A library of rivals: C++ that shows whether it is here, flags, and the packages that bring it."""

    name: str
    probe: str
    define: str
    compile: tuple[str, ...]
    link: tuple[str, ...]
    packages: str

    def here(self, compiler: str) -> bool:
        argv = [compiler, "-x", "c++", "-fsyntax-only", *self.compile, "-"]
        return subprocess.run(argv, input=self.probe, capture_output=True, text=True).returncode == 0


LIBRARIES = (
    Library("Eigen", "#include <Eigen/Core>", "HAVE_EIGEN", ("-I/usr/include/eigen3",), (), "libeigen3-dev"),
    Library(
        "LAPACK", "#include <lapacke.h>", "HAVE_LAPACK", (), ("-llapacke", "-lopenblas"),
        "liblapacke-dev libopenblas-dev",
    ),
)  # fmt: skip


def _numpy_pinv(S: FloatArray, z: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.pinv(S, rcond=_rcond(S)) @ z)


def _numpy_lstsq(S: FloatArray, z: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(S, z, rcond=_rcond(S))[0])


def _scipy_lstsq(S: FloatArray, z: FloatArray) -> FloatArray:
    return np.asarray(scipy.linalg.lstsq(S, z, cond=_rcond(S), check_finite=False)[0])


def _scipy_pinv(S: FloatArray, z: FloatArray) -> FloatArray:
    return np.asarray(scipy.linalg.pinv(S, rtol=_rcond(S), check_finite=False) @ z)


def _rcond(S: FloatArray) -> float:
    scalar: Scalar = "float32" if S.dtype == np.float32 else "float64"
    return float(max(S.shape) * EPSILON[scalar])


PYTHON: dict[str, Callable[[FloatArray, FloatArray], Any]] = {
    "numpy pinv, from Python": _numpy_pinv,
    "numpy lstsq, from Python": _numpy_lstsq,
    "scipy lstsq, from Python": _scipy_lstsq,
    "scipy pinv, from Python": _scipy_pinv,
}
"""Timed in Python: the call's overhead is in their figures."""
