"""The wider scenes in closed loop: each against what its mechanics ought to do."""

import numpy as np
import pytest
import servogen as sg
from servogen.loading import load_scene
from servogen.scene.domain import draw_states
from servogen.scenes.iiwa_position import EFFORT, JOINT_SPEED
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.trajectory import Trajectory
from servogen.simulate.wanted import load_simulation

pytestmark = pytest.mark.xdist_group("scenes")  # one process makes the fixture


def run(name: str, **options: object) -> Trajectory:
    return ClosedLoop(*load_simulation(name)).run(**options)  # type: ignore[arg-type]


def test_a_free_y_lets_E_follow_for_ten_seconds() -> None:
    found = run("double_pendulum_energy_free_y")
    assert found.stop.reason == "finished"
    assert found.t[-1] == pytest.approx(10.0)
    assert np.max(np.abs(found.outputs["E"] / found.decay["E"] - 1)) < 1e-9
    assert found.outputs["K/E"].min() > 0.48


@pytest.fixture(scope="module")
def arms() -> dict[str, Trajectory]:
    return {name: run(f"planar_arm_3r{name}") for name in ("", "_damped", "_weighted")}


def test_the_arms_error_decays_at_the_rates_of_Theta(arms: dict[str, Trajectory]) -> None:
    """psi'' = -6 psi' - 8 psi has the rates -2 and -4: psi = a exp(-2 t) + b exp(-4 t), fitted."""
    for found in arms.values():
        late = (found.t > 1.5) & (found.t < 4.0)
        size = np.linalg.norm(found.constraint, axis=1)
        slope = np.polyfit(found.t[late], np.log(size[late]), 1)[0]
        assert slope == pytest.approx(-2.0, abs=0.03)
        shape = np.exp(np.outer(found.t, [-2.0, -4.0]))
        weights = np.linalg.lstsq(shape, found.constraint, rcond=None)[0]
        assert np.max(np.abs(found.constraint - shape @ weights)) < 1e-6


def test_damping_and_weight_change_the_self_motion_only(arms: dict[str, Trajectory]) -> None:
    assert np.max(np.abs(arms["_damped"].constraint - arms[""].constraint)) < 1e-6
    late = arms[""].t > 3.0
    energy = {n: float(np.max(a.outputs["kinetic energy"][late])) for n, a in arms.items()}
    assert energy["_damped"] < 0.7 * energy[""]


def test_the_inverse_mass_matrix_as_weight_is_the_operational_space_solution() -> None:
    """tau = J^T Lambda z with Lambda = (J M^-1 J^T)^-1."""
    scene = load_scene("planar_arm_3r_weighted")
    code, textbook = sg.build(scene).load(), sg.reference(scene)
    states = draw_states(scene, 100)
    for k in range(100):
        state = {n: v[k] for n, v in states.items()}
        parts = textbook.parts(textbook.read_inputs(state))
        J, M = parts["J"], parts["Q"]
        expected = J.T @ np.linalg.solve(J @ np.linalg.solve(M, J.T), code.z(**state))
        assert np.max(np.abs(code.control(**state).value - expected)) <= 1e-10 * np.max(np.abs(expected))


def test_the_unicycle_reaches_its_circle_at_its_speed() -> None:
    found = run("unicycle_path")
    assert np.allclose(found.constraint, found.ideal, atol=1e-9)
    point = found.q[:, :2] + 0.2 * np.stack([np.cos(found.q[:, 2]), np.sin(found.q[:, 2])], axis=1)
    assert np.linalg.norm(point[-1]) == pytest.approx(2.0, abs=1e-4)
    assert found.u[-1, 0] == pytest.approx(0.8, abs=1e-5)
    forward = np.gradient(found.q[:, :2], found.t, axis=0)[1:-1]  # the wheels do not slip sideways
    aside = -np.sin(found.q[1:-1, 2]) * forward[:, 0] + np.cos(found.q[1:-1, 2]) * forward[:, 1]
    assert np.max(np.abs(aside)) < 1e-5


def test_the_quaternion_keeps_its_norm_within_the_methods_order() -> None:
    loop = ClosedLoop(*load_simulation("quaternion_pointing"))
    drift = [np.max(np.abs(loop.run(step=h).outputs["|q| - 1"])) for h in (0.2, 0.1, 0.05)]
    orders = np.log2(np.array(drift[:-1]) / drift[1:])
    assert np.all(orders > 3.7)
    found = loop.run()
    assert np.max(np.abs(found.constraint - found.ideal)) < 1e-8
    assert found.outputs["angle to the target"][-1] < 1e-3


def test_the_thrusters_hold_velocity_and_rate() -> None:
    found = run("skewed_thrusters")
    assert np.max(np.abs(found.constraint - found.ideal)) < 1e-9
    assert np.max(np.abs(found.u[-1] - [0.5, 0, 0, 0, 0, 0])) < 1e-3
    rest = found.tau[-1] - 0.5  # the free vector pulls all thrusters to 0.5 N, up to what holds the craft
    S = sg.reference(load_scene("skewed_thrusters")).S(u=[0] * 6)
    null = np.eye(8) - np.linalg.pinv(S) @ S
    assert np.linalg.norm(null @ rest) < 1e-9


@pytest.mark.parametrize("name", ["iiwa_position", "iiwa_pose"])
def test_the_iiwa_moves_as_prescribed_and_comes_to_rest(name: str) -> None:
    """The error decays with the double rate -10; no joint meets a limit of its angle, speed or effort on the way.

    The constraints leave joints free: the posture brings those to rest, and the weight keeps the light ones slow.
    """
    found = run(name)
    assert found.stop.reason == "finished"
    size = np.linalg.norm(found.constraint, axis=1)
    expected = size[0] * (1 + 10 * found.t) * np.exp(-10 * found.t)
    assert np.max(np.abs(size - expected)) < 1e-6
    assert found.sigma_min.min() > 0.1
    assert np.all(found.status == 0)
    assert np.max(np.abs(found.u)) < 0.2 * JOINT_SPEED
    assert np.max(np.abs(found.tau)) < 0.2 * EFFORT
    assert np.max(np.abs(found.u[-1])) < 1e-6
