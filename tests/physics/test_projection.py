"""project: the nearest tau with phi = 0, against scipy's constrained minimum, and how fast it gets there."""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from scipy.optimize import minimize
from servogen.derive import controls
from servogen.loading import load_scene
from servogen.scene.domain import draw_states
from servogen.verify import check as check_module
from servogen.verify.check import check
from support.models import awkward_scenes, random_scene

q, u, tau = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau", 2)
MECHANISM = sg.Mechanism(q=q, u=u, tau=tau, Q=ca.DM.eye(2), P=-q, G=ca.DM.eye(2))
CIRCLE = sg.Scene("circle", MECHANISM, [sg.ControlsInvolved("power", ca.sumsqr(tau) - 4 - u[0] ** 2)])
"""|tau|^2 = 4 + u_1^2: the nearest point lies on the ray from the origin."""


def twins(scene: sg.Scene) -> tuple[Any, Any]:
    return sg.build(scene).load(), sg.reference(scene)


@pytest.mark.parametrize("start", [[3.0, 0.1], [0.4, -0.3], [2.5, 2.5], [-40.0, 9.0], [1e6, 1e6]])
def test_the_nearest_point_of_a_circle(start: list[float]) -> None:
    """Its distance is no small one: a step along A+ phi alone would end elsewhere on the circle."""
    for twin in twins(CIRCLE):
        answer = twin.project(u=[0.0, 0.0], tau=start)
        assert answer.info.status == sg.Status.OK
        np.testing.assert_allclose(answer.value, 2 * np.array(start) / np.linalg.norm(start), rtol=1e-9, atol=1e-9)


def test_random_scenes_against_a_minimiser() -> None:
    scene = random_scene(3, "controls")
    code, textbook = twins(scene)
    states = draw_states(scene, 12)
    met = 0
    for k in range(12):
        state = {n: v[k] for n, v in states.items()}
        ours, theirs = code.project(**state), textbook.project(**state)
        assert ours.info.status == theirs.info.status
        if ours.info.status < 0:
            continue
        met += 1
        np.testing.assert_allclose(ours.value, theirs.value, rtol=1e-9, atol=1e-9)
        found = minimize(
            lambda x, s=state: float(np.sum((x - s["tau"]) ** 2)),
            ours.value + 1e-3,
            constraints={"type": "eq", "fun": lambda x, s=state: textbook.phi(**(s | {"tau": x}))},
            options={"ftol": 1e-15, "maxiter": 200},
        )
        assert np.linalg.norm(ours.value - state["tau"]) <= np.linalg.norm(found.x - state["tau"]) + 1e-6
    assert met >= 9


def test_convergence_is_quadratic(monkeypatch: pytest.MonkeyPatch) -> None:
    """From 0.5 off a circle of radius 2: with n iterations allowed, when does the twin converge?"""
    needed = []
    for angle in np.linspace(0.1, 6.2, 20):
        start = 2.5 * np.array([np.cos(angle), np.sin(angle)]) + [0.0, 0.2]
        for cap in range(1, 26):
            monkeypatch.setattr("servogen.twins.reference.BENT_CAP", cap)
            if sg.reference(CIRCLE).project(u=[0, 0], tau=start).info.status >= 0:
                needed.append(cap)
                break
    assert len(needed) == 20
    assert max(needed) <= 6  # a linear rate of 1/4 would take 26


def test_both_twins_give_up_alike() -> None:
    """phi = 1 + |tau|^2 has no zero."""
    nowhere = sg.Scene("nowhere", MECHANISM, [sg.ControlsInvolved("none", ca.sumsqr(tau) + 1 + u[0] ** 2)])
    for twin in twins(nowhere):
        answer = twin.project(u=[0.3, 0.0], tau=[1.0, 2.0], last=[7.0, 8.0])
        assert answer.info.status == sg.Status.NOT_CONVERGED
        assert np.array_equal(answer.value, [7.0, 8.0])
    assert f"at most {controls.BENT_CAP} steps" in (sg.build(nowhere).path / "nowhere.h").read_text()


@pytest.mark.parametrize("far", [1e3, 1e16, -1e25])
def test_an_affine_phi_from_far_away(far: float) -> None:
    """One step leaves the rounding of the start, 1 at 1e16; what remains is of the size of the answer."""
    scene = load_scene("spacecraft")
    state = {"u": np.array([0.1, 0.2, 0.3])}
    code, textbook = twins(scene)
    A = code.A(**state).ravel()
    start = far * A / np.linalg.norm(A) + np.array([0.1, -0.2, 0.3])
    for twin in (code, textbook):
        answer = twin.project(**state, tau=start)
        phi = twin.phi(**state, tau=answer.value)
        assert np.max(np.abs(phi)) <= 1e-14 * (1 + np.linalg.norm(A) * np.linalg.norm(answer.value))


def test_project_and_step_of_a_curved_phi_have_vectors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_module, "HOST_COMPILERS", ("gcc",))  # it is about the truth
    scene = replace(awkward_scenes()["one_cubic"], name="cubic")
    report = check([scene, CIRCLE], states=30)
    assert report.passed, report.problems
    judged = {(o.scene, o.entry, o.scalar) for o in report.outputs if o.entry in ("project", "step") and o.compared}
    assert len(judged) == 8
