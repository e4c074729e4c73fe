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
from servogen.results import Status
from servogen.scene.solver import Solver
from servogen.singular import pseudo_solution, smallest_singular_value
from servogen.textbook import pseudo_inverse
from servogen.textbook.policy import policy_for


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
    users = Solver(rank=solver.rank, rtol=solver.rtol, atol=solver.atol, damping=solver.damping)
    policy = policy_for(m, l, solver.scalar, users)
    counted = pseudo_inverse.counted_rows(values, policy)
    _, info = pseudo_inverse.pinv(values, policy)
    if info.rank == exact.rank(matrix) and np.array_equal(counted, values) and info.status != Status.REGULARISED:
        entries = exact.pinv(matrix)
        numbers = [Fraction(int(q.p), int(q.q)) for q in (entries[i, j] for i in range(l) for j in range(m))]
    else:
        columns = [pseudo_solution(counted, unit, np.zeros(l), info.rank, solver.damping)[0] for unit in np.eye(m)]
        numbers = [Fraction(float(column[i])) for i in range(l) for column in columns]
    sigma_min = smallest_singular_value(values) if exact.rank(matrix) == min(m, l) else 0.0
    return KnownMatrix(
        name, "generation", tuple(constants), tuple(numbers), Status(info.status).name, info.rank, sigma_min
    )
