"""The plan of a solver: what shape takes which kind, defaults, refusals, operation counts."""

import math

import numpy as np
import pytest
from servogen.errors import SceneError
from servogen.plan.solver import plan_solver, solver_context, solver_operations
from servogen.results import Path, Status
from servogen.scene.solver import Solver


@pytest.mark.parametrize(
    ("m", "l", "kind"),
    [(1, 1, "row"), (1, 12, "row"), (2, 1, "column"), (2, 2, "full"), (7, 3, "full"), (12, 12, "full")],
)
def test_kind_by_shape(m, l, kind):
    plan = plan_solver(m, l, "float64", Solver())
    assert plan.kind == kind
    assert plan.path == (Path.SVD if kind == "full" else Path.CLOSED_FORM)


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


def test_context_names_every_status_and_path():
    context = solver_context(plan_solver(2, 3, "float64", Solver()), "pinv_2x3", str)
    assert {name for name, _, _ in context["statuses"]} == set(Status.__members__)
    assert {name for name, _, _ in context["paths"]} == set(Path.__members__)
    assert context["P"] == "PINV_2X3"


def test_plan_goes_to_json():
    import json

    shown = json.loads(json.dumps(plan_solver(3, 7, "float64", Solver(damping=0.1)).to_json()))
    assert (shown["m"], shown["l"], shown["damping"], shown["ladder"]) == (3, 7, 0.1, ["NORMAL", "QR", "SVD"])
    assert math.isclose(shown["rtol"], 7 * 2.0**-52)


def test_ladder_of_the_method():
    assert plan_solver(3, 7, "float64", Solver(method="svd")).ladder == (Path.SVD,)
    assert plan_solver(1, 7, "float64", Solver()).ladder == (Path.CLOSED_FORM,)


@pytest.mark.parametrize(("long", "width"), [(2, 2), (3, 3), (4, 4), (5, 8), (7, 8), (12, 12)])
def test_vectors_are_whole_blocks(long, width):
    assert plan_solver(2, long, "float64", Solver()).width == width
    assert plan_solver(long, 2, "float64", Solver()).m_width == width


@pytest.mark.parametrize("scalar", ["float64", "float32"])
@pytest.mark.parametrize("rtol", [None, 1e-3, 0.1])
def test_certificates_prove_more_than_the_tolerance(scalar, rtol):
    """sigma_min at the limit of either certificate exceeds rtol |S|_F with |S|_F at its largest: rows of length 2."""
    plan = plan_solver(3, 7, scalar, Solver(rtol=rtol))
    assert 1 / plan.normal_limit - plan.normal_rounding > plan.rtol**2 * 4 * 3
    assert plan.qr_limit**-0.5 - plan.qr_rounding > plan.rtol
