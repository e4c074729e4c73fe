"""Constraints on a robot's frames: geometric Jacobians and bias accelerations give what differentiation gives."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.compiler import derived_scene
from servogen.derive.constraint_rates import cut
from servogen.loading import load_scene
from support.robots import A1, A1_FEET, IIWA, IIWA_TOOL, draw_state

GAINS: dict[str, Any] = {"Theta1": -2.0, "Theta2": -3.0}


def derived(scene: sg.Scene) -> Any:
    formulation = derived_scene(scene)[0]
    fields = scene.input_fields()
    symbols = [f.symbol for f in (*fields, *scene.parameters)]
    defaults = [ca.DM(f.default) for f in scene.parameters]
    function = ca.Function("derived", symbols, [formulation[n] for n in ("psi", "S", "z")])
    return lambda state: [np.array(x) for x in function(*(state[f.name] for f in fields), *defaults)]


def compare(scene: sg.Scene, states: list[dict[str, Any]], tolerance: float = 1e-9) -> None:
    ours, textbook = derived(scene), sg.reference(scene)
    for state in states:
        for name, value in zip(("psi", "S", "z"), ours(state), strict=True):
            expected = np.asarray(getattr(textbook, name)(**state))
            scale = max(1.0, np.max(np.abs(expected)))
            np.testing.assert_allclose(value.reshape(expected.shape), expected, rtol=0, atol=tolerance * scale)


def draw(scene: sg.Scene, robot: sg.urdf.Robot, count: int = 3) -> list[dict[str, Any]]:
    generator = np.random.default_rng(0)
    states = []
    for _ in range(count):
        q, u, _ = draw_state(robot, generator)
        rest = {f.name: generator.uniform(-1, 1, f.size) for f in scene.input_fields() if f.name not in ("q", "u")}
        states.append({"q": q, "u": u} | rest)
    return states


@pytest.mark.parametrize("name", ["iiwa_position", "iiwa_pose"])
def test_built_in_scenes(name: str) -> None:
    scene = load_scene(name)
    _, cuts = cut(scene, ca.vertcat(*(c.psi for c in scene.constraints)))  # type: ignore[union-attr]
    assert len(cuts) == scene.rows  # every row by its known rates
    robot = sg.urdf.load(IIWA, quiet=True)
    compare(scene, draw(scene, robot))


def test_orientation_that_follows_a_moving_reference() -> None:
    robot = sg.urdf.load(IIWA, quiet=True)
    ref = sg.References(o=sg.Ref([1.0, 0, 0, 0], order=2))
    error = robot.orientation_error(IIWA_TOOL, sg.urdf.quaternion_rotation(ref.o))
    scene = sg.Scene("turning", robot.mechanism, [sg.Holonomic("turn", error, **GAINS)], references=ref)
    compare(scene, draw(scene, robot))


def test_orientation_error_is_the_axis_times_the_sine() -> None:
    robot = sg.urdf.load(IIWA, quiet=True)
    axis, angle = np.array([2.0, -1.0, 2.0]) / 3, 0.4
    skew = np.array(ca.skew(ca.DM(axis)))
    turn = np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * skew @ skew
    q, _, _ = draw_state(robot, np.random.default_rng(1))
    now = np.array(ca.Function("R", [robot.q], [robot.rotation(IIWA_TOOL)])(q))
    error = ca.Function("e", [robot.q], [robot.orientation_error(IIWA_TOOL, turn.T @ now)])(q)
    np.testing.assert_allclose(np.array(error).ravel(), np.sin(angle) * axis, atol=1e-12)


def test_functions_of_known_quantities_mixed_with_others() -> None:
    robot = sg.urdf.load(IIWA, quiet=True)
    r, R, v = robot.position(IIWA_TOOL), robot.rotation(IIWA_TOOL), robot.velocity(IIWA_TOOL)
    t = ca.SX.sym("t")
    mech = robot.mechanism
    timed = sg.Mechanism(
        q=mech.q, u=mech.u, tau=mech.tau, Q=mech.Q, P=mech.P, G=mech.G, t=t, known_rates=mech.known_rates
    )
    psi = ca.vertcat(ca.dot(r, r) * ca.sin(t) + robot.q[1], R[0, 1] * r[2] - robot.q[3] ** 2)
    speed = ca.vertcat(v[0] * r[1] + robot.u[2], v[4] * R[2, 2] - ca.cos(t))
    scene = sg.Scene("mixed", timed, [sg.Holonomic("place", psi, **GAINS), sg.Nonholonomic("speed", speed, Theta=-1.0)])
    compare(scene, draw(scene, robot))


def test_friction_and_rotor_inertia_are_not_lost() -> None:
    """The robot's own choice of accelerations holds for its own Q and P alone."""
    robot = sg.urdf.load(IIWA, quiet=True)
    mech = robot.mechanism
    assert mech.gauge is not None
    constraint = sg.Holonomic("place", robot.position(IIWA_TOOL), **GAINS)
    for Q, P in ((mech.Q, mech.P - 0.3 * mech.u), (mech.Q + 0.1 * ca.SX.eye(7), mech.P)):
        changed = sg.Mechanism(q=mech.q, u=mech.u, tau=mech.tau, Q=Q, P=P, G=mech.G, known_rates=mech.known_rates)
        assert changed.gauge is None
        scene = sg.Scene("changed", changed, [constraint])
        compare(scene, draw(scene, robot))


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_accelerations_at_ease_obey_the_equations_of_motion(base: Any) -> None:
    robot = sg.urdf.load(A1, base=base, quiet=True)
    mech, gauge = robot.mechanism, robot.mechanism.gauge
    assert gauge is not None
    off = ca.Function("off", [mech.q, mech.u], [mech.P - mech.Q @ gauge.u_dot - gauge.force, mech.P])
    q, u, _ = draw_state(robot, np.random.default_rng(4))
    difference, P = off(q, u)
    assert ca.norm_inf(difference) < 1e-12 * ca.norm_inf(P)


@pytest.mark.parametrize("stretch", [1.0, 1.3])
def test_feet_of_a_floating_quadruped(stretch: float) -> None:
    robot = sg.urdf.load(A1, base="floating", quiet=True)
    feet = [sg.Holonomic(foot, robot.position(foot), **GAINS) for foot in A1_FEET]
    scene = sg.Scene("feet", robot.mechanism, feet)
    states = draw(scene, robot, 2)
    for state in states:
        state["q"][3:7] *= stretch  # rates belong to what they are rates of, for quaternions of any length
    compare(scene, states)
