"""A matrix that no state changes: its pseudo-inverse is computed at generation, or in prepare."""

from fractions import Fraction
from typing import Any

import flint
import numpy as np

from servogen import exact
from servogen.ir.program import Program
from servogen.plan.module import Kernel, KnownMatrix, Result
from servogen.plan.solver import SolverPlan
from servogen.plan.stage import Staged, cut
from servogen.results import FloatArray, Status
from servogen.singular import kept_singular_values, pseudo_solution, smallest_singular_value


def plan_known_matrix(staged: Staged, result: Result, solver: SolverPlan) -> KnownMatrix | None:
    """How the matrix `result` of the tick is known before it; None where the state decides it."""
    part = cut(staged.tick, result.name, (result.name,))
    kinds = {i.name: i.kind for i in part.inputs}
    leaves = {kinds[i.const[0]] for i in part.instrs if isinstance(i.const, tuple)}
    if "input" in leaves:
        return None
    constants = [part.instrs[n].const for n in part.output(result.name).nodes]
    if all(isinstance(c, Fraction) for c in constants):
        return _at_generation(result.name, constants, solver)
    return KnownMatrix(
        result.name, "prepare", kernel=Kernel(f"known_{result.name}", _renamed(part, f"known_{result.name}"), (result,))
    )


def _renamed(program: Program, name: str) -> Program:
    return Program(name, program.inputs, program.instrs, program.outputs)


def _at_generation(name: str, constants: list[Any], solver: SolverPlan) -> KnownMatrix:
    """Exact rationals, or 50 digits where the solver's tolerances or damping ask for another answer than the exact one.

    Nothing printed depends on the host's LAPACK.
    """
    m, l = solver.m, solver.l
    matrix = flint.fmpq_mat(m, l, [flint.fmpq(c.numerator, c.denominator) for c in constants])
    values = exact.nearest(matrix)
    counted, rank, status = judge(values, solver)
    if rank == exact.rank(matrix) and np.array_equal(counted, values) and status != Status.REGULARISED:
        entries = exact.pinv(matrix)
        numbers = [Fraction(int(q.p), int(q.q)) for q in (entries[i, j] for i in range(l) for j in range(m))]
    else:
        columns = [pseudo_solution(counted, unit, np.zeros(l), rank, solver.damping)[0] for unit in np.eye(m)]
        numbers = [Fraction(float(column[i])) for i in range(l) for column in columns]
    if any(abs(n) > float(np.finfo(solver.scalar).max) for n in numbers):
        numbers, rank, status = [Fraction(0)] * (l * m), 0, Status.OVERFLOW
    sigma_min = smallest_singular_value(values) if exact.rank(matrix) == min(m, l) else 0.0
    return KnownMatrix(name, "generation", tuple(constants), tuple(numbers), status.name, rank, sigma_min)


def judge(S: FloatArray, solver: SolverPlan) -> tuple[FloatArray, int, Status]:
    """S (m, l) with the rows that count as zero at zero, its rank, and its status if all rows can be met.

    As the solver would find them at run time, to 50 digits: rows within their atol are zero; the rank is that of the
    rows brought to one size, or of S as it is, by the pivots of a QR where the method is "cod"; a singular value of
    what is kept below the damping regularises.
    """
    counted = np.where(np.max(np.abs(S), axis=1, keepdims=True) > np.array(solver.atol)[:, None], S, 0.0)
    length = np.linalg.norm(counted, axis=1)
    own = np.ldexp(1.0, np.frexp(np.where(length > 0, length, 1.0))[1] - 1)
    units = own if solver.rank == "scaled" else np.ones(solver.m)
    if solver.method == "cod" and solver.form == "full":
        rank = exact.rank_by_pivots(exact.rational(counted / units[:, None]), solver.rtol)
        return counted, rank, Status.OK if rank == solver.m else Status.RANK_DEFICIENT_CONSISTENT
    kept = kept_singular_values(counted, units, solver.rtol)
    if solver.damping is not None and any(sigma < solver.damping for sigma in kept):
        return counted, len(kept), Status.REGULARISED
    return counted, len(kept), Status.OK if len(kept) == solver.m else Status.RANK_DEFICIENT_CONSISTENT
