"""Weights: the answer meets the constraints and minimises (tau - y)^T W (tau - y), by the conditions of Lagrange."""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.loading import load_scene
from servogen.scene.domain import draw_states
from support.models import random_scene
from support.robots import IIWA
from support.twins import as_derived

NUMBERS = np.array([[2.0, 0.3, -0.1], [0.3, 1.5, 0.4], [-0.1, 0.4, 0.7]])


def weighted(seed: int, weight: Any, kind: str = "mixed", y: Any = None) -> sg.Scene:
    """A random scene, 2 x 3, with a weight; weight and y may be functions of the scene."""
    s = random_scene(seed, kind)
    weight, y = (v(s) if callable(v) else v for v in (weight, y))
    return sg.Scene(f"weighted_{kind}", s.mechanism, s.constraints, s.parameters, s.references, y=y, weight=weight)


def of_state(s: sg.Scene) -> Any:
    """A full W of q, t and a parameter, symmetric as written."""
    q, t, m = s.mechanism.q, s.mechanism.t, next(iter(s.parameters)).symbol
    bend = 0.3 * ca.vertcat(ca.sin(q[0]), ca.cos(q[1] + t), ca.sin(q[2]))
    return ca.triu2symm(ca.triu(NUMBERS + m * bend @ bend.T))


def of_parameters(s: sg.Scene) -> Any:
    m = next(iter(s.parameters)).symbol
    return ca.diag(ca.vertcat(m, 2 * m, 5.0))


def of_velocity(s: sg.Scene) -> Any:
    return -s.mechanism.u[:3] + ca.sin(s.mechanism.t)


def numeric(scene: sg.Scene, expression: Any, state: dict[str, Any]) -> np.ndarray:
    fields = [*scene.input_fields(), *scene.parameters]
    values = [state.get(f.name, f.default) for f in fields]
    return np.array(ca.Function("value", [f.symbol for f in fields], [ca.densify(expression)])(*values))


@pytest.mark.parametrize("weight", [NUMBERS, of_parameters, of_state], ids=["numbers", "parameters", "state"])
@pytest.mark.parametrize("y", [None, of_velocity, "input"], ids=["no y", "y of u", "y input"])
def test_the_answer_is_the_weighted_minimum(weight: Any, y: Any) -> None:
    scene = weighted(3, weight, y=y)
    code, textbook = as_derived(scene), sg.reference(scene)
    states = draw_states(scene, 20)
    for k in range(20):
        state = {n: v[k] for n, v in states.items()}
        S, z, tau = code.S(**state), code.z(**state), code.control(**state).value
        W = numeric(scene, scene.weight, state)
        free = np.zeros(3) if y is None else state["y"] if y == "input" else numeric(scene, scene.y, state).ravel()
        size = np.linalg.norm(tau) + np.linalg.norm(free)
        assert np.linalg.norm(S @ tau - z) <= 1e-12 * (np.linalg.norm(S) * size + np.linalg.norm(z))
        gradient = W @ (tau - free)  # must lie in the range of S^T
        rest = gradient - S.T @ np.linalg.lstsq(S.T, gradient, rcond=None)[0]
        assert np.linalg.norm(rest) <= 1e-11 * np.linalg.norm(W) * size
        assert np.allclose(tau, textbook.control(**state).value, rtol=0, atol=1e-11 * size)


def test_the_inverse_mass_as_a_word_is_the_inverse_mass() -> None:
    """weight="inverse_mass" beside weight=inv(Q), in the C and in the reference."""
    arm = load_scene("planar_arm_3r")
    Q = arm.mechanism.Q
    word = replace(arm, name="word", weight="inverse_mass", y="input")
    written = replace(arm, name="written", weight=ca.triu2symm(ca.triu(ca.inv(Q))), y="input")
    twins = [make(scene) for scene in (word, written) for make in (as_derived, sg.reference)]
    states = draw_states(word, 20)
    for k in range(20):
        state = {n: v[k] for n, v in states.items()}
        answers = [t.control(**state) for t in twins]
        assert {a.info.status for a in answers} == {sg.Status.OK}
        size = np.linalg.norm(answers[0].value) + np.linalg.norm(state["y"])
        for other in answers[1:]:
            assert np.allclose(other.value, answers[0].value, rtol=0, atol=1e-12 * size)


def inverse_mass_scenes() -> dict[str, sg.Scene]:
    """Every kind of scene and of Q, with a posture or another y, G the identity or not."""
    arm = load_scene("planar_arm_3r")
    mech = arm.mechanism

    def other(Q: Any, P: Any, G: Any) -> sg.Mechanism:
        return sg.Mechanism(mech.q, mech.u, mech.tau, Q, P, G)

    simple = other(ca.diag(ca.vertcat(*arm.parameters.m.nonzeros())), -mech.u, np.eye(3))
    phi = sg.ControlsInvolved("power", ca.dot(mech.tau, mech.u) + mech.tau[0], Theta=-1.0)
    posture = mech.posture(damping=[3.0, 2.0, 1.0], stiffness=arm.parameters.g, centre=[0.1, 0.2, 0.3])
    scenes = {
        "posture": replace(arm, y=posture),
        "diagonal": replace(arm, mechanism=simple, y=simple.posture(damping=2.0)),
        "identity": replace(arm, mechanism=other(np.eye(3), -mech.u, np.eye(3)), y=-mech.u),
        "geared": replace(arm, mechanism=other(mech.Q, mech.P, np.diag([1, 2, 3.0])), y=-3.0 * mech.u),
        "ideal": replace(arm, mode="ideal", mechanism=other(mech.Q, mech.P, NUMBERS)),
        "controls": replace(arm, constraints=[phi], references=None, y=-mech.tau),
    }
    return {name: replace(s, name=name, weight="inverse_mass") for name, s in scenes.items()}


@pytest.mark.parametrize("name", ["posture", "diagonal", "identity", "geared", "ideal", "controls"])
def test_the_inverse_mass_as_weight_of_every_kind_of_scene(name: str) -> None:
    """tau = y + Q S^T (S Q S^T)^+ (z - S y)."""
    scene = inverse_mass_scenes()[name]
    code, textbook = as_derived(scene), sg.reference(scene)
    states = draw_states(scene, 10)
    for k in range(10):
        state = {n: v[k] for n, v in states.items()}
        matrix, right = scene.system.matrix, scene.system.right
        S = numeric(scene, scene.mechanism.G, state) if name == "ideal" else getattr(textbook, matrix)(**state)
        z, Q = getattr(textbook, right)(**state), numeric(scene, scene.mechanism.Q, state)
        y = np.zeros(3) if scene.y is None else numeric(scene, scene.y, state).ravel()
        expected = y + Q @ S.T @ np.linalg.pinv(S @ Q @ S.T) @ (z - S @ y)
        for twin in (code, textbook):
            answer = twin.control(**state)
            assert answer.info.status == sg.Status.OK
            assert np.allclose(answer.value, expected, rtol=0, atol=1e-11 * np.linalg.norm([expected, y]))


def test_the_inverse_mass_costs_little_more_than_no_weight() -> None:
    """Q is factorised once, and its triangular factor is half of the solve that S needs without a weight."""
    plain = load_scene("planar_arm_3r")
    weighted = sg.build(replace(plain, weight="inverse_mass")).manifest["entry_points"]["control"]["operations"]
    assert weighted["total"] <= sg.build(plain).manifest["entry_points"]["control"]["operations"]["total"] + 10
    assert weighted["sqrt"] == 3


def test_a_posture_cancels_all_forces_and_damps() -> None:
    """u' = -d u - k (q - centre) where y alone acts, for a robot as for any mechanism."""
    robot = sg.urdf.load(IIWA, quiet=True, damping=None)
    plain = sg.Mechanism(q=robot.q, u=robot.u, tau=robot.tau, Q=robot.mechanism.Q, P=robot.mechanism.P, G=ca.DM.eye(7))
    generator = np.random.default_rng(1)
    q, u, centre = generator.uniform(-1, 1, (3, 7))
    for y in (robot.posture(5.0, 3.0, centre), plain.posture(5.0, [3.0] * 7, centre)):
        mech = robot.mechanism
        u_dot = ca.Function("u_dot", [robot.q, robot.u], [ca.solve(mech.Q, mech.P + y)])(q, u)
        assert np.allclose(np.array(u_dot).ravel(), -5 * u - 3 * (q - centre), rtol=1e-9, atol=1e-9)
    geared = sg.Mechanism(q=robot.q, u=robot.u, tau=robot.tau, Q=ca.DM.eye(7), P=-robot.u, G=np.diag(range(1, 8)))
    y = ca.Function("y", [robot.u], [geared.posture(damping=2.0)])(u)
    assert np.allclose(np.array(y).ravel(), -u / np.arange(1, 8), atol=1e-12)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"damping": -1.0}, "posture: damping has an entry -1.0"),
        ({"damping": [1.0, 2.0]}, "damping has shape 2x1; it must be a column of 3"),
        ({"stiffness": 1.0}, "give both, or neither"),
        ({"centre": [0, 0, 0]}, "give both, or neither"),
        ({"stiffness": 1.0, "centre": [0, 0]}, "centre has shape 2x1"),
    ],
)
def test_errors_of_a_posture(options: Any, words: str) -> None:
    with pytest.raises(sg.SceneError, match=words):
        load_scene("planar_arm_3r").mechanism.posture(**options)


def test_a_posture_needs_a_control_for_each_rate() -> None:
    q, u = ca.SX.sym("q", 2), ca.SX.sym("u", 2)
    few = sg.Mechanism(q=q, u=u, tau=ca.SX.sym("tau"), Q=ca.DM.eye(2), P=-u, G=np.array([[1.0], [0]]))
    with pytest.raises(sg.SceneError, match="one control per velocity parameter"):
        few.posture(damping=1.0)
    with pytest.raises(sg.SceneError, match="one control per velocity parameter"):
        sg.Scene("few", few, [sg.Nonholonomic("still", u[0], Theta=-1.0)], weight="inverse_mass")
    turning = sg.Mechanism(q=q, u=u, tau=ca.SX.sym("tau", 2), Q=ca.DM.eye(2), P=-u, G=ca.DM.eye(2), C=ca.DM.eye(2))
    with pytest.raises(sg.SceneError, match="stiffness needs q' = u"):
        turning.posture(stiffness=1.0, centre=[0, 0])


def test_controls_involved_constraints_take_a_weight_as_well() -> None:
    scene = weighted(5, NUMBERS, "controls", y=of_velocity)
    code, textbook = sg.build(scene).load(), sg.reference(scene)
    states = draw_states(scene, 10)
    for k in range(10):
        state = {n: v[k] for n, v in states.items()}
        A, B, rate = code.A(**state), code.B(**state), code.control(**state).value
        y = numeric(scene, scene.y, state).ravel()
        inverse = np.linalg.inv(NUMBERS) @ A.T @ np.linalg.inv(A @ np.linalg.inv(NUMBERS) @ A.T)
        assert np.allclose(rate, y + inverse @ (B - A @ y), rtol=1e-9, atol=1e-9)
        assert np.allclose(rate, textbook.control(**state).value, rtol=1e-10, atol=1e-10)


def test_the_identity_costs_nothing() -> None:
    plain, one = weighted(3, None), weighted(3, np.eye(3))
    counts = [sg.build(s).manifest["entry_points"]["control"]["operations"] for s in (plain, one)]
    assert counts[0] == counts[1]


def test_what_parameters_decide_is_done_in_prepare() -> None:
    plain, diagonal = sg.build(weighted(3, None)).manifest, sg.build(weighted(3, of_parameters)).manifest
    counts = [m["entry_points"]["control"]["operations"]["total"] for m in (plain, diagonal)]
    assert counts[1] - counts[0] == 6  # S times a diagonal, nothing else
    assert diagonal["prepare"]["operations"]["sqrt"] == 2
    assert any("weight: diagonal" in text for text in diagonal["entry_points"]["control"]["skipped"])


def test_a_weight_that_parameters_spoil_is_refused_in_prepare() -> None:
    scene = weighted(3, of_parameters)
    assert sg.build(scene).load().prepare(m=-1.0) == sg.Status.OVERFLOW


@pytest.mark.parametrize(
    ("weight", "words"),
    [
        (np.eye(2), "3x3"),
        (np.array([[1.0, 0.2, 0], [0.1, 1, 0], [0, 0, 1]]), "not symmetric by proof"),
        (np.diag([1.0, -1.0, 2.0]), "not positive definite"),
        (np.diag([1.0, 0.0, 2.0]), "not positive definite"),
        (np.diag([1.0, np.nan, 2.0]), "finite"),
        (lambda s: ca.diag(s.mechanism.tau), "weight depends on tau"),
        (lambda s: ca.diag(ca.sin(s.mechanism.q[:3])), "not positive definite"),
        ("inverse mass", "weight='inverse mass'; give None, 'inverse_mass'"),
    ],
)
def test_errors_name_the_weight(weight: Any, words: str) -> None:
    with pytest.raises(sg.SceneError, match=words):
        sg.build(weighted(3, weight))


def test_the_inverse_of_a_q_that_is_no_mass_matrix_is_refused() -> None:
    s = random_scene(3, "mixed", mass="exchange")
    scene = sg.Scene("odd", s.mechanism, s.constraints, s.parameters, s.references, weight="inverse_mass")
    with pytest.raises(sg.SceneError, match="needs a Q that is symmetric and positive definite; Q is not symmetric"):
        sg.build(scene)
