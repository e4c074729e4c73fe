"""The plan of a solver: what shape takes which form, defaults, refusals."""

import math

import numpy as np
import pytest
from servogen.errors import SceneError
from servogen.plan.solver import plan_solver
from servogen.results import Path
from servogen.scene.solver import Solver


@pytest.mark.parametrize(
    ("m", "l", "form"),
    [(1, 1, "row"), (1, 12, "row"), (2, 1, "column"), (2, 2, "full"), (7, 3, "full"), (12, 12, "full")],
)
def test_form_by_shape(m, l, form):
    plan = plan_solver(m, l, "float64", Solver())
    assert plan.form == form
    assert plan.path == (Path.SVD if form == "full" else Path.CLOSED_FORM)


@pytest.mark.parametrize(("size", "cap"), [(2, 5), (3, 7), (4, 10), (6, 10), (7, 12), (12, 12)])
def test_sweep_caps(size, cap):
    assert plan_solver(size, 12, "float64", Solver()).sweep_cap == cap
    assert plan_solver(12, size, "float32", Solver()).sweep_cap == cap


def test_default_tolerances():
    plan = plan_solver(3, 7, "float32", Solver())
    assert plan.rtol == 7 * 2.0**-23
    assert plan.atol == (0.0, 0.0, 0.0)


def test_rtol_never_below_what_jacobi_leaves():
    assert plan_solver(4, 4, "float64", Solver(rtol=0.0)).rtol == 2 * 2.0**-52


def test_numbers_are_exact_in_the_target_type():
    plan = plan_solver(2, 3, "float32", Solver(rtol=0.1, atol=[0.1, 0.3], damping=0.7))
    for value in (plan.rtol, *plan.atol, plan.damping, plan.orthogonal):
        assert float(np.float32(value)) == value


@pytest.mark.parametrize("shape", [(0, 3), (13, 3), (3, 0), (3, 13)])
def test_sizes_outside_are_refused(shape):
    with pytest.raises(SceneError, match=r"1 to 12 rows and columns; leave out"):
        plan_solver(*shape, "float64", Solver())


def test_wrong_number_of_row_tolerances():
    with pytest.raises(SceneError, match="2 numbers, S has 3 rows: give"):
        plan_solver(3, 3, "float64", Solver(atol=[1e-3, 1e-3]))


@pytest.mark.parametrize(
    ("solver", "words"),
    [(Solver(damping=1e-60), "is zero in float32"), (Solver(damping=1e60), "too large for float32")],
)
def test_tolerances_outside_the_type(solver, words):
    with pytest.raises(SceneError, match=words):
        plan_solver(2, 3, "float32", solver)


def test_plan_goes_to_json():
    import json

    shown = json.loads(json.dumps(plan_solver(3, 7, "float64", Solver(damping=0.1)).to_json()))
    assert (shown["m"], shown["l"], shown["damping"], shown["ladder"]) == (3, 7, 0.1, ["NORMAL", "QR", "SVD"])
    assert math.isclose(shown["rtol"], 7 * 2.0**-52)


def test_ladder_of_the_method():
    assert plan_solver(3, 7, "float64", Solver(method="svd")).ladder == (Path.SVD,)
    assert plan_solver(3, 7, "float64", Solver(method="cod")).ladder == (Path.QR,)
    assert plan_solver(1, 7, "float64", Solver(method="cod")).ladder == (Path.CLOSED_FORM,)
    assert plan_solver(1, 7, "float64", Solver()).ladder == (Path.CLOSED_FORM,)
