"""How a solver's vectors are padded."""

import pytest
from servogen.plan.solver import plan_solver
from servogen.scene.solver import Solver


@pytest.mark.parametrize(("long", "width"), [(2, 2), (3, 3), (4, 4), (5, 8), (7, 8), (12, 12)])
def test_vectors_are_whole_blocks(long, width):
    assert plan_solver(2, long, "float64", Solver()).width == width
    assert plan_solver(long, 2, "float64", Solver()).m_width == width
