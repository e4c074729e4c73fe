"""Two writings of the thresholds of numerics.md, the plan's and the textbook's: a wrong factor in either shows here."""

import numpy as np
import pytest
from servogen.plan.solver import plan_solver
from servogen.scalars import EPSILON, Scalar
from servogen.scene.solver import Solver
from servogen.textbook import pseudo_inverse
from servogen.textbook.policy import policy_for

SOLVERS = {
    "default": Solver(),
    "raw": Solver(rank="raw"),
    "rtol": Solver(rtol=1e-3),
    "rtol too small": Solver(rtol=0.0),
    "atol": Solver(atol=1e-7),
    "damping": Solver(damping=0.02),
}


@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_every_shape_and_solver(scalar: Scalar) -> None:
    for m in range(1, 13):
        for l in range(1, 13):
            for name, solver in SOLVERS.items():
                plan, policy = plan_solver(m, l, scalar, solver), policy_for(m, l, scalar, solver)
                for number in ("rank", "rtol", "atol", "damping", "consistency"):
                    assert getattr(plan, number) == getattr(policy, number), (m, l, name, number)


def test_numbers_of_numerics() -> None:
    """rtol = max(m, l) eps; met within 8 max(m, l) eps; noise where the user gives no atol, and only there."""
    for scalar, eps in EPSILON.items():
        policy = policy_for(3, 7, scalar, Solver(), noise=[1e-9, 0.0, 2e-9])
        assert policy.rtol == np.dtype(scalar).type(7 * eps)
        assert policy.consistency == 56 * eps
        assert policy.atol == tuple(float(np.dtype(scalar).type(a)) for a in (1e-9, 0.0, 2e-9))
        assert policy_for(3, 7, scalar, Solver(atol=0.25), noise=[1.0, 1.0, 1.0]).atol == (0.25,) * 3


@pytest.mark.parametrize(("factor", "rank"), [(0.25, 1), (4.0, 2)])
def test_rank_turns_at_rtol(factor: float, rank: int) -> None:
    policy = policy_for(2, 3, "float64", Solver())
    S = np.diag([1.0, factor * policy.rtol])
    S = np.hstack([S, np.zeros((2, 1))])
    raw = policy_for(2, 3, "float64", Solver(rank="raw"))
    assert pseudo_inverse.pinv(S, raw)[1].rank == rank


@pytest.mark.parametrize(("factor", "met"), [(0.25, True), (4.0, False)])
def test_consistency_turns_at_its_bound(factor: float, met: bool) -> None:
    policy = policy_for(2, 2, "float64", Solver())
    S = np.array([[1.0, 0.0], [1.0, 0.0]])
    z = np.array([1.0, 1.0 + factor * 2 * 2 * policy.consistency])  # half of the gap remains in each row, of size 2
    status = pseudo_inverse.solve(S, z, None, policy)[1].status
    assert (status == 1) is met
