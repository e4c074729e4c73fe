"""Operations of a solver, counted."""

import pytest
from servogen.plan.operations import solver_operations
from servogen.plan.solver import plan_solver
from servogen.scene.solver import Solver


def test_row_operations_counted_by_hand():
    # s s^T: 2 mul, 1 add; z - s y: 2 mul, 2 add; one division; y + s w: 2 mul, 2 add
    assert solver_operations(plan_solver(1, 2, "float64", Solver()))["closed_form"] == {
        "total": 12,
        "add": 5,
        "mul": 6,
        "div": 1,
        "sqrt": 0,
    }


@pytest.mark.parametrize(("m", "l"), [(1, 3), (3, 1), (3, 7), (12, 12)])
def test_operations_add_up(m, l):
    for counts in solver_operations(plan_solver(m, l, "float64", Solver())).values():
        assert counts["total"] == counts["add"] + counts["mul"] + counts["div"] + counts["sqrt"] > 0
