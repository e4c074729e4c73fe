"""Weights: the answer meets the constraints and minimises (tau - y)^T W (tau - y), by the conditions of Lagrange."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.scene.domain import draw_states
from support.models import random_scene
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
    ],
)
def test_errors_name_the_weight(weight: Any, words: str) -> None:
    with pytest.raises(sg.SceneError, match=words):
        sg.build(weighted(3, weight))
