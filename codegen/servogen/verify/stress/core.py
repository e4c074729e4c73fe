"""The SVD inside the solver, by the three ratios of LAPACK's ddrvbd."""

import ctypes as ct
import functools
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from servogen.compiler import build_solver
from servogen.plan.solver import plan_solver
from servogen.results import FloatArray
from servogen.scalars import Scalar
from servogen.scene.solver import Solver
from servogen.tools import find_tool
from servogen.verify.stress.rationals import norm2

SOURCE = Path(__file__).with_name("core.c")


@functools.cache
def _library(m: int, l: int, scalar: Scalar) -> ct.CDLL:
    solver = Solver(method="svd", rank="raw")
    plan = plan_solver(m, l, scalar, solver)
    compiler = find_tool("gcc", "gcc")
    with tempfile.TemporaryDirectory(prefix="servogen-core-") as name:
        folder = Path(name)
        build_solver(m, l, folder, scalar=scalar, solver=solver, prefix="pinv")
        defines = {
            "REAL": plan.real, "ROWS": m, "COLUMNS": l, "STRIDE": plan.stride, "RTOL": plan.rtol.hex(),
            "M_WIDTH": plan.m_width, "L_WIDTH": plan.l_width,
            "ROW_AT(i)": plan.m_at("(i)"), "COLUMN_AT(j)": plan.l_at("(j)"),
        }  # fmt: skip
        target = folder / "core.so"
        command = [str(compiler), "-std=c99", "-O1", "-ffp-contract=off", "-fPIC", "-shared", f"-I{folder}"]
        command += [*(f"-D{key}={value}" for key, value in defines.items()), str(SOURCE), "-o", str(target), "-lm"]
        subprocess.run(command, check=True, capture_output=True)
        return ct.CDLL(str(target))


def decompose(S: FloatArray, scalar: Scalar) -> tuple[FloatArray, FloatArray, FloatArray, Any]:
    """(U, sigma, V, rank) of a stack (N, m, l): the solver's own, by rows U (N, n, m) and V (N, n, l), zero from rank
    on. Raises ToolMissing without gcc."""
    N, m, l = S.shape
    n = min(m, l)
    S = np.ascontiguousarray(S, scalar)
    U, sigma, V = (np.zeros(shape, scalar) for shape in ((N, n, m), (N, n), (N, n, l)))
    rank = np.zeros(N, np.intc)
    function = _library(m, l, scalar).decompose
    function.restype = None
    function(ct.c_long(N), *(ct.c_void_p(a.ctypes.data) for a in (S, U, sigma, V, rank)))
    return U, sigma, V, rank


def ratios(S: FloatArray, scalar: Scalar, eps: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """|S - U s V^T| / (|S| max(m, l) eps), |I - U^T U| / (m eps), |I - V^T V| / (l eps) of the singular values kept."""
    m, l = S.shape[1:]
    U, sigma, V, rank = decompose(S, scalar)
    unit = np.abs(S).max(axis=(1, 2), keepdims=True).astype(np.longdouble)
    unit[unit == 0] = 1
    A, u_rows, v_rows = S.astype(np.longdouble) / unit, U.astype(np.longdouble), V.astype(np.longdouble)
    product = u_rows.transpose(0, 2, 1) @ (sigma.astype(np.longdouble)[:, :, None] / unit * v_rows)
    kept = (np.arange(min(m, l)) < rank[:, None])[:, :, None] * np.eye(min(m, l))

    def size(M: Any) -> FloatArray:
        return norm2(np.asarray(M, np.float64))

    whole = size(A)
    return (
        size(A - product) / (np.where(whole > 0, whole, 1.0) * max(m, l) * eps),
        size(u_rows @ u_rows.transpose(0, 2, 1) - kept) / (m * eps),
        size(v_rows @ v_rows.transpose(0, 2, 1) - kept) / (l * eps),
    )
