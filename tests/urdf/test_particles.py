"""Mass matrix, bias forces and kinematics against particles and differences: no rigid-body library involved."""

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from scipy.integrate import solve_ivp
from support.particles import Particles
from support.robots import A1, IIWA, IIWA_TOOL, ODD, draw_state

GRAVITY = (1.0, -2.0, -9.81)


@pytest.fixture(scope="module", params=["iiwa", "iiwa floating", "a1", "a1 floating", "odd", "odd floating"])
def case(request: Any, tmp_path_factory: Any) -> Any:
    """Robot, its particles, the name of a frame."""
    name, _, base = request.param.partition(" ")
    path, frame = {"iiwa": (IIWA, IIWA_TOOL), "a1": (A1, "RL_toe"), "odd": (Path("odd.urdf"), "tool")}[name]
    if name == "odd":
        path = tmp_path_factory.mktemp("odd") / "odd.urdf"
        path.write_text(ODD)
    robot = sg.urdf.load(path, base=base or "fixed", gravity=GRAVITY, quiet=True, damping=None)
    return robot, Particles(path, robot.joints, bool(base), GRAVITY), frame


def close(ours: Any, other: Any, tolerance: float) -> None:
    other = np.asarray(other)
    np.testing.assert_allclose(
        np.array(ours).reshape(other.shape), other, rtol=0, atol=tolerance * max(1e-3, np.max(np.abs(other)))
    )


def test_mass_matrix_and_bias_forces(case: Any) -> None:
    robot, particles, _ = case
    model = ca.Function("model", [robot.q, robot.u], [robot.mechanism.Q, robot.mechanism.P, robot.center_of_mass()])
    generator = np.random.default_rng(1)
    for _ in range(2):
        q, u, base = draw_state(robot, generator)
        joints = q[-len(robot.joints) :]
        Q, P, centre = (np.array(x) for x in model(q, u))
        assert np.array_equal(Q, Q.T)
        close(Q, particles.mass_matrix(base, joints), 1e-9)
        close(-P, particles.bias_forces(base, joints, u), 1e-7)
        close(centre, particles.center_of_mass(base, joints), 1e-10)


def test_kinematics(case: Any) -> None:
    robot, particles, frame = case
    outputs = [
        f(frame) for f in (robot.position, robot.rotation, robot.jacobian, robot.bias_acceleration, robot.velocity)
    ]
    model = ca.Function("model", [robot.q, robot.u], [*outputs, robot.mechanism.q_dot])
    q, u, base = draw_state(robot, np.random.default_rng(2))
    joints = q[-len(robot.joints) :]
    position, rotation, J, bias, velocity, q_dot = (np.array(x) for x in model(q, u))
    pose = particles.poses(base, joints)[frame]
    close(position, pose[:3, 3], 1e-10)
    close(rotation, pose[:3, :3], 1e-10)

    def place(*state: Any) -> Any:
        return particles.poses(*state)[frame][:3, 3]

    def turn(*state: Any) -> Any:
        return particles.poses(*state)[frame][:3, :3]

    def axial(m: Any) -> Any:
        skewed = m @ pose[:3, :3].T
        return np.array([skewed[2, 1] - skewed[1, 2], skewed[0, 2] - skewed[2, 0], skewed[1, 0] - skewed[0, 1]]) / 2

    columns = particles.jacobian(turn, base, joints)
    close(J[:3], particles.jacobian(place, base, joints), 1e-9)
    close(J[3:], np.stack([axial(columns[..., k]) for k in range(particles.n_u)], axis=-1), 1e-9)
    close(velocity, J @ u, 1e-12)
    close(bias[:3], particles.second_difference(place, base, joints, u), 1e-7)
    close(bias[3:], axial(particles.second_difference(turn, base, joints, u)), 1e-7)  # axial part of R'' is omega'
    if particles.floating:
        h = 1e-6
        step = [particles.moved(base, joints, u, s * h)[0] for s in (-1, 1)]
        close(q_dot[:3].ravel(), (step[1] - step[0])[:3, 3] / (2 * h), 1e-7)
        np.testing.assert_allclose(q_dot[3:7].ravel() @ q[3:7], 0, atol=1e-14)


def test_energy_is_conserved_without_controls(case: Any) -> None:
    robot, _, _ = case
    mech, centre = robot.mechanism, robot.center_of_mass()
    model = ca.Function("model", [robot.q, robot.u], [mech.q_dot, mech.Q, mech.P])
    kinetic = ca.Function("T", [robot.q, robot.u], [ca.bilin(mech.Q, robot.u, robot.u) / 2, centre])
    q, u, base = draw_state(robot, np.random.default_rng(3))
    mass = case[1].masses(base, q[-len(robot.joints) :]).sum()
    n = len(q)

    def rate(_: float, x: Any) -> Any:
        q_dot, Q, P = (np.array(e) for e in model(x[:n], x[n:]))
        return np.concatenate([q_dot.ravel(), np.linalg.solve(Q, P).ravel()])

    run = solve_ivp(rate, (0, 0.05), np.concatenate([q, u]), "DOP853", rtol=1e-9, atol=1e-9)

    def energy(x: Any) -> float:
        T, r = kinetic(x[:n], x[n:])
        return float(T) - mass * float(np.dot(GRAVITY, np.array(r).ravel()))

    start, end = energy(run.y[:, 0]), energy(run.y[:, -1])
    assert run.success
    moved = abs(float(kinetic(run.y[:n, 0], run.y[n:, 0])[0]) - float(kinetic(run.y[:n, -1], run.y[n:, -1])[0]))
    assert abs(end - start) < 1e-5 * moved
