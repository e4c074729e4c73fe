"""Example 1 of the paper: E follows E(0) exp(-t) until K/E vanishes, in generated C."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from servogen.scenes.double_pendulum_energy import scene, simulation
from servogen.simulate.closed_loop import ClosedLoop

M_B, R, L, I_D, I_B, GRAVITY = 1.0, 0.5, 1.2, 0.2, 0.12, 9.81


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    return ClosedLoop(scene, simulation)


def mass(q: np.ndarray) -> np.ndarray:
    """Q of Eq. (20)."""
    coupling = M_B * L / 2 * R * np.cos(q[0] - q[1])
    return np.array([[M_B * R**2 + I_D, coupling], [coupling, M_B * L**2 / 4 + I_B]])


def energies(q: np.ndarray, u: np.ndarray) -> tuple[float, float]:
    """K and V; V is zero hanging at rest."""
    V = M_B * GRAVITY * (R * (1 - np.cos(q[0])) + L / 2 * (1 - np.cos(q[1])))
    return u @ mass(q) @ u / 2, V


def model(t: float, x: np.ndarray) -> np.ndarray:
    """The closed loop by hand, y = 0: the power u^T G tau must be -E, so tau = -G^T u E / |G^T u|^2."""
    q, u = x[:2], x[2:]
    s = np.sin(q[0] - q[1])
    P = np.array(
        [
            -M_B * GRAVITY * R * np.sin(q[0]) - M_B * L / 2 * R * u[1] ** 2 * s,
            -M_B * GRAVITY * L / 2 * np.sin(q[1]) + M_B * L / 2 * R * u[0] ** 2 * s,
        ]
    )
    G = np.array([[1.0, -1.0], [0.0, 1.0]])
    S = G.T @ u
    tau = -S * sum(energies(q, u)) / (S @ S)
    return np.concatenate([u, np.linalg.solve(mass(q), P + G @ tau)])


def test_E_follows_its_decay_until_K_vanishes(loop):
    run = loop.run()
    assert run.stop.reason == "event"
    assert run.stop.event == "K/E < 1e-3"
    energy = np.array([sum(energies(q, u)) for q, u in zip(run.q, run.u, strict=True)])
    error = np.abs(energy / (energy[0] * np.exp(-run.t)) - 1)
    assert error.max() < 1e-8
    assert error[run.t < run.stop.t - 0.01].max() < 1e-10
    assert np.allclose(run.outputs["E"], energy, rtol=1e-12)
    assert np.array_equal(run.decay["E"], run.outputs["E"][0] * np.exp(-run.t))
    assert np.allclose(run.psi, run.ideal, rtol=1e-8)


def test_the_escape_is_the_first_instant_and_stable_under_halving(loop):
    times = []
    for step in (5e-4, 2.5e-4, 1.25e-4, 6.25e-5):
        run = loop.run(step=step)
        ratio = run.outputs["K/E"]
        assert run.stop.t == run.t[-1]
        assert ratio[-1] < 1e-3
        assert np.all(ratio[:-1] >= 1e-3)
        times.append(run.stop.t)
    assert np.ptp(times) <= 5e-4  # within one step of the coarsest
    assert times[-1] == pytest.approx(2.4637, abs=2e-4)


def test_the_escape_is_that_of_the_independent_model(loop):
    def ratio(t: float, x: np.ndarray) -> float:
        K, V = energies(x[:2], x[2:])
        return K / (K + V) - 1e-3

    ratio.terminal = True
    start = np.concatenate([simulation.start["q"], simulation.start["u"]])
    truth = solve_ivp(model, (0, 5), start, "DOP853", rtol=1e-12, atol=1e-14, events=ratio)
    escape = truth.t_events[0][0]
    run = loop.run(step=6.25e-5)
    assert 0 <= run.stop.t - escape <= 6.25e-5 + 1e-9
    same = loop.run(duration=2.0, step=6.25e-5)
    there = solve_ivp(model, (0, 2), start, "DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    assert np.allclose(np.concatenate([same.q[-1], same.u[-1]]), there, rtol=0, atol=3e-10)


def test_another_energy_can_be_held(loop):
    run = loop.run(references={"E_0": 9.0}, duration=1.0)
    assert run.stop.reason == "finished"
    expected = 9.0 + (run.outputs["E"][0] - 9.0) * np.exp(-run.t)
    assert np.allclose(run.outputs["E"], expected, rtol=1e-10)
    rounding = len(run.t) * 2.0**-52  # the decay is a product a sample
    assert np.allclose(run.decay["E"], expected, rtol=rounding)


def test_parameters_reach_controller_plant_and_stop_expression(loop):
    run = loop.run(parameters={"m_B": 2.0, "g": 1.62}, duration=0.5)
    assert np.allclose(run.outputs["E"], run.outputs["E"][0] * np.exp(-run.t), rtol=1e-9)
    assert not np.allclose(run.q[-1], loop.run(duration=0.5).q[-1], atol=1e-2)


def test_rk4_is_of_order_four(loop):
    start = np.concatenate([simulation.start["q"], simulation.start["u"]])
    truth = solve_ivp(model, (0, 0.5), start, "DOP853", rtol=1e-13, atol=1e-14).y[:, -1]
    errors = []
    for step in (0.02, 0.01, 0.005, 0.0025):
        run = loop.run(duration=0.5, step=step)
        errors.append(np.linalg.norm(np.concatenate([run.q[-1], run.u[-1]]) - truth))
    ratios = np.array(errors[:-1]) / errors[1:]
    assert np.all((ratios > 13) & (ratios < 19))


def test_hold_converges_at_first_order(loop):
    continuous = loop.run(duration=1.0)
    errors = [
        np.abs(loop.run(duration=1.0, step=step, hold=True).u[-1] - continuous.u[-1]).max()
        for step in (4e-3, 2e-3, 1e-3, 5e-4)
    ]
    ratios = np.array(errors[:-1]) / errors[1:]
    assert np.all((ratios > 1.85) & (ratios < 2.15))
