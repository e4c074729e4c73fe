"""A matrix no state changes: its pseudo-inverse is made at generation or in prepare, and the answers are the same."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.plan.known_matrix import judge
from servogen.plan.solver import plan_solver
from servogen.scene.domain import draw_states
from servogen.scenes import skewed_thrusters
from servogen.textbook import pseudo_inverse
from servogen.textbook.policy import policy_for


def linear(rows: Any, G: Any, parameters: sg.Parameters | None = None, Q: Any = None, **options: Any) -> sg.Scene:
    """psi = rows u on Q u' = -3 u + G tau, S = rows Q^-1 G."""
    G = ca.SX(ca.DM(np.asarray(G, dtype=float))) if not isinstance(G, ca.SX) else G
    n, l = G.shape
    u = ca.SX.sym("u", n)
    mech = sg.Mechanism(
        q=ca.SX.sym("q", n), u=u, tau=ca.SX.sym("tau", l), Q=ca.DM.eye(n) if Q is None else Q, P=-3 * u, G=G
    )
    psi = ca.DM(np.asarray(rows, dtype=float)) @ u
    return sg.Scene("linear", mech, [sg.Nonholonomic("task", psi, -1.0)], parameters, **options)


def compare(scene: sg.Scene, scalar: Any = "float64", **parameters: float) -> Any:
    """C and reference at drawn states: same statuses and ranks, same answers. The last answer."""
    code, textbook = sg.build(scene, scalar=scalar).load(), sg.reference(scene, scalar)
    assert code.prepare(**parameters) == textbook.prepare(**parameters) == sg.Status.OK
    states = draw_states(scene, 20)
    tolerance = 1e-12 if scalar == "float64" else 1e-4
    for k in range(20):
        state = {n: v[k] for n, v in states.items()}
        a, b = code.control(**state), textbook.control(**state)
        assert (a.info.status, a.info.rank) == (b.info.status, b.info.rank)
        assert np.allclose(a.value, b.value, rtol=tolerance, atol=tolerance)
        assert a.info.residual == pytest.approx(b.info.residual, abs=tolerance * 100)
        assert a.info.sigma_min == pytest.approx(b.info.sigma_min, rel=1e-4)
        assert a.info.path == sg.Path.PRECOMPUTED
    return a


@pytest.mark.parametrize("scalar", ["float64", "float32"])
@pytest.mark.parametrize("y", [None, "input"])
def test_a_constant_matrix_is_inverted_at_generation(scalar: str, y: Any) -> None:
    rng = np.random.default_rng(0)
    scene = linear(np.eye(2, 3), rng.integers(-3, 4, (3, 4)), y=y)
    compare(scene, scalar)
    manifest = sg.build(scene).manifest
    assert manifest["solver"]["known"] == "generation"
    assert manifest["entry_points"]["control"]["solver_operations"]["apply"]["div"] == 0


@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_no_y_reaches_a_square_system_of_full_rank(scalar: Any) -> None:
    """y = 1e16 cost the answer all digits, and 1e308 the answer."""
    scene = linear([[3, 1], [1, 2]], [[1, 0.5], [0.25, 1]], y="input")
    for twin in (sg.build(scene, scalar=scalar).load(), sg.reference(scene, scalar)):
        twin.prepare()
        state = {n: v[0] for n, v in draw_states(scene, 1).items()}
        plain = twin.control(**(state | {"y": np.zeros(2)}))
        for size in (1e8, 1e30, float(np.finfo(scalar).max)):
            answer = twin.control(**(state | {"y": np.array([size, -size])}))
            assert answer.info == plain.info
            assert np.array_equal(answer.value, plain.value)


def test_rank_deficiency_of_a_constant_matrix_is_still_told() -> None:
    duplicate = [[1, 0, 0], [1, 0, 0]]
    with pytest.warns(sg.Remark, match="never be independent"):
        answer = compare(linear(duplicate, np.eye(3)))
    assert answer.info.status == sg.Status.RANK_DEFICIENT_CONSISTENT
    with pytest.warns(sg.Remark, match="never be independent"):
        answer = compare(linear([[1, 0], [0, 1]], [[1.0], [2.0]]))
    assert answer.info.status == sg.Status.RANK_DEFICIENT_INCONSISTENT


def test_parameters_alone_are_a_matter_of_prepare() -> None:
    par = sg.Parameters(m=2.0, J=[3.0, 4.0])
    scene = linear(np.eye(3), [[1, 1, 0, 1], [0, 1, -1, 2], [1, 0, 3, 1]], par, Q=ca.diag(ca.vertcat(par.m, par.J)))
    compare(scene)
    compare(scene, m=0.7, J=[1.0, 9.0])
    compare(scene, "float32")
    manifest = sg.build(scene).manifest
    assert manifest["solver"]["known"] == "prepare"
    assert any("in prepare" in text for text in manifest["entry_points"]["control"]["skipped"])


def test_a_matrix_of_the_state_is_not_known() -> None:
    n = 2
    q, u, tau = ca.SX.sym("q", n), ca.SX.sym("u", n), ca.SX.sym("tau", n)
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=ca.DM.eye(n), P=-u, G=ca.diag(2 + ca.sin(q)))
    scene = sg.Scene("s", mech, [sg.Nonholonomic("task", u, -1.0)])
    assert sg.build(scene).manifest["solver"]["known"] is None


def test_damping_of_a_constant_matrix() -> None:
    scene = linear(np.eye(2), np.diag([1.0, 1e-3]), solver=sg.Solver(damping=1e-2))
    assert compare(scene).info.status == sg.Status.REGULARISED


def test_skewed_thrusters_factorise_nothing_at_run_time() -> None:
    """S+ is 8 x 6: 48 products, 40 sums; with y another 48 of each, and the sums with y itself."""
    manifest = sg.build(skewed_thrusters.scene).manifest
    control = manifest["entry_points"]["control"]
    assert manifest["solver"]["known"] == "prepare"
    assert control["solver_operations"] == {"apply": {"total": 192, "add": 96, "mul": 96, "div": 0, "sqrt": 0}}
    assert control["operations"].get("div", 0) <= 6  # P over masses and inertias
    assert "sqrt" not in control["operations"]
    compare(skewed_thrusters.scene)


@pytest.mark.parametrize("rank", ["scaled", "raw"])
@pytest.mark.parametrize("shape", [(1, 3), (3, 1), (2, 3), (3, 2)])
def test_a_matrix_is_judged_as_the_reference_does(shape: tuple[int, int], rank: Any) -> None:
    """Singular values about rtol, rows about atol, sizes about the damping; the textbook shares none of our numbers."""
    rng = np.random.default_rng(3)
    seen = set()
    for k in range(24):
        users = sg.Solver(rank=rank, rtol=1e-3, atol=1e-4, damping=[None, 2e-3][k % 2])
        if k % 3 == 0:
            users = sg.Solver(method="cod", rank=rank, rtol=1e-3, atol=1e-4)
        S = rng.normal(size=(shape[0], 1)) @ rng.normal(size=(1, shape[1]))
        S += 10.0 ** rng.uniform(-4, -2) * rng.normal(size=shape)
        S *= 10.0 ** rng.uniform(-5, 0, (shape[0], 1))
        _, found, status = judge(S, plan_solver(*shape, "float64", users))
        info = pseudo_inverse.pinv(S, policy_for(*shape, "float64", users))[1]
        assert (found, status) == (info.rank, info.status), (k, S.tolist())
        seen.add((found, status))
    assert len(seen) > 1
