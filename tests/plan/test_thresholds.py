"""The limits of certificates and of short forms keep what they promise."""

import pytest
from servogen.plan.solver import plan_solver
from servogen.scene.solver import Solver


def test_row_range_leaves_atol_and_damping_to_the_scaled_form():
    l, atol, damping = 5, 3e-4, 2e-3
    for solver, bound in ((Solver(atol=atol), l * atol**2), (Solver(damping=damping), damping**2)):
        row_range = plan_solver(1, l, "float64", solver).row_range
        assert row_range is not None
        assert 2.0 ** (row_range.square_floor / 2 - 1023) > bound
    assert plan_solver(1, l, "float32", Solver(damping=1e9)).row_range is None
    for scalar in ("float64", "float32"):
        plain = plan_solver(1, l, scalar, Solver()).row_range
        assert plain is not None
        assert plain.square_floor is None
        assert plain.span & (plain.span + 1) == 0  # one comparison of several numbers' bits


@pytest.mark.parametrize("scalar", ["float64", "float32"])
@pytest.mark.parametrize("rtol", [None, 1e-3, 0.1])
def test_certificates_prove_more_than_the_tolerance(scalar, rtol):
    """sigma_min at the limit of either certificate exceeds rtol |S|_F with |S|_F at its largest: rows of length 2."""
    plan = plan_solver(3, 7, scalar, Solver(rtol=rtol))
    assert 1 / plan.normal_limit - plan.normal_rounding > plan.rtol**2 * 4 * 3
    assert plan.qr_limit**-0.5 - plan.qr_rounding > plan.rtol
