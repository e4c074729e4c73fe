"""Example 2 of the paper: generated C in closed loop against the exact decay of K and an independent numpy model."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from servogen.scenes.spacecraft import stabilisation
from servogen.simulate.closed_loop import ClosedLoop

pytestmark = pytest.mark.xdist_group("spacecraft")  # one process makes the fixture

INERTIA = np.array([10.0, 6.3, 8.5])
START = {"q": [0.0, 0.0, 0.0], "u": [0.1, 0.1, 0.1], "tau": [0.1, 0.1, -0.3376]}
TAU_3 = -0.287 / 0.85  # that of phi = 0 with tau_1 = tau_2 = 0.1, Eq. (47)


def kinetic(omega: np.ndarray) -> np.ndarray:
    return omega**2 @ INERTIA / 2


def off_decay(trajectory) -> np.ndarray:
    """|K(t) - K(0) exp(-t)| / (K(0) exp(-t)) with K(0) = 0.124 J."""
    ideal = 0.124 * np.exp(-trajectory.t)
    return np.abs(kinetic(trajectory.u) - ideal) / ideal


def model(t: float, x: np.ndarray, smooth: bool) -> np.ndarray:
    """Eqs. (42)-(54) by hand, a = 1: sum I_i w_i P_i vanishes, so phi = sum I_i w_i tau_i + K."""
    omega, tau = x[:3], x[3:]
    differences = INERTIA[[1, 2, 0]] - INERTIA[[2, 0, 1]]
    omega_dot = differences / INERTIA * omega[[1, 2, 0]] * omega[[2, 0, 1]] + tau
    A = INERTIA * omega
    B = -np.dot(INERTIA * omega_dot, tau + omega)
    y = -tau if smooth else np.zeros(3)
    return np.concatenate([omega_dot, y + A * (B - A @ y) / (A @ A)])


def truth(loop_start: np.ndarray, duration: float, smooth: bool) -> np.ndarray:
    """omega and tau at the end, by DOP853 at rtol 1e-13."""
    return solve_ivp(model, (0, duration), loop_start, "DOP853", rtol=1e-13, atol=1e-16, args=(smooth,)).y[:, -1]


@pytest.fixture(scope="module")
def smooth() -> ClosedLoop:
    return ClosedLoop(stabilisation("spacecraft_smooth", smooth=True))


@pytest.fixture(scope="module")
def chattering() -> ClosedLoop:
    return ClosedLoop(stabilisation("spacecraft", smooth=False))


@pytest.fixture(scope="module")
def held() -> ClosedLoop:
    return ClosedLoop(stabilisation("held", smooth=True, Theta=-1.0))


@pytest.fixture(scope="module")
def held_fast() -> ClosedLoop:
    return ClosedLoop(stabilisation("held_fast", smooth=True, Theta=-5.0))


def test_the_start_is_projected_to_the_nearest_tau(smooth):
    start = smooth.run(start=START, duration=1e-3, step=1e-3)
    A, tau = INERTIA * 0.1, np.array(START["tau"])
    nearest = tau - A * (A @ tau + 0.124) / (A @ A)
    assert np.allclose(start.tau[0], nearest, rtol=0, atol=1e-15)
    assert abs(start.phi[0, 0]) < 1e-15


@pytest.mark.parametrize("step", [5e-4, 2.5e-4])
def test_K_decays_exactly_with_Theta_zero(smooth, step):
    run = smooth.run(start=START, duration=10.0, step=step)
    assert run.stop.reason == "finished"
    assert not np.any(run.status)
    assert off_decay(run).max() < 1e-9


@pytest.mark.parametrize("loop", ["held", "held_fast"])
def test_K_decays_exactly_with_a_stable_Theta(loop, request):
    run = request.getfixturevalue(loop).run(start=START, duration=10.0, step=5e-4)
    assert off_decay(run).max() < 1e-9


def test_the_printed_start_is_off_the_constraint_and_stays_so(smooth):
    run = smooth.run(start=START, duration=10.0, step=5e-4, project=False)
    assert run.phi[0, 0] == pytest.approx(4e-5, rel=1e-9)
    assert run.phi[-1, 0] == pytest.approx(4e-5, rel=1e-5)  # Theta = 0 keeps it
    # K' = -K + phi, hence K = 0.124 exp(-t) + 4e-5 (1 - exp(-t))
    expected = 0.124 * np.exp(-10.0) + 4e-5 * -np.expm1(-10.0)
    assert kinetic(run.u[-1]) == pytest.approx(expected, rel=1e-6)
    assert 8.0 < kinetic(run.u[-1]) / (0.124 * np.exp(-10.0)) < 8.2


def test_a_stable_Theta_forgives_the_printed_start(held_fast):
    run = held_fast.run(start=START, duration=10.0, step=5e-4, project=False)
    assert abs(run.phi[-1, 0]) < 1e-12
    assert np.allclose(run.constraint, run.ideal, rtol=0, atol=1e-9)


def test_the_exact_start_needs_no_projection(smooth):
    run = smooth.run(start=START | {"tau": [0.1, 0.1, TAU_3]}, duration=10.0, step=5e-4, project=False)
    assert off_decay(run).max() < 1e-9


def test_y_zero_agrees_with_the_independent_model_for_three_seconds(chattering):
    run = chattering.run(start=START, duration=3.0, step=1e-4)
    start = np.concatenate([run.u[0], run.tau[0]])
    assert run.t[-1] == pytest.approx(3.0)
    end = np.concatenate([run.u[-1], run.tau[-1]])
    error = np.abs(end - truth(start, 3.0, smooth=False))
    assert error[:3].max() < 5e-11  # of angular velocities of about 0.04 rad/s
    assert error[3:].max() < 2e-9  # of controls of about 1 rad/s^2
    assert off_decay(run).max() < 1e-10


def test_y_zero_chatters_faster_and_faster_and_y_minus_tau_does_not(chattering, smooth):
    run = chattering.run(start=START, duration=6.0, step=1e-4)

    def changes(tau: np.ndarray, a: float, b: float) -> int:
        part = np.sign(tau[(run.t >= a) & (run.t < b)])
        return int(np.sum(part[1:] != part[:-1]))

    counts = [changes(run.tau[:, 0], k, k + 1) for k in range(6)]
    assert counts == sorted(counts)
    assert counts[5] > 8 * counts[2]
    peak = [np.abs(run.tau[(run.t >= k) & (run.t < k + 1)]).max() for k in range(6)]
    assert peak[5] > 6 * peak[1]
    calm = smooth.run(start=START, duration=6.0, step=1e-3)
    for k in range(3):
        assert np.sum(np.diff(np.sign(calm.tau[:, k])) != 0) < 10
    assert np.abs(calm.tau).max() < 0.4


def test_coarse_steps_lose_the_chatter_and_say_so(chattering):
    """RK4 at 1e-3 s loses K by 5 s, for the chatter outruns it; the run must end with a status, not with nonsense."""
    run = chattering.run(start=START, duration=10.0, step=1e-3)
    assert 0.05 < off_decay(run)[np.searchsorted(run.t, 5.0 - 1e-9)] < 1.0
    assert run.stop.status < 0
    assert run.stop.reason == "controller"
    assert run.stop.t == run.t[-1]
    assert np.all(np.isfinite(run.u))


@pytest.mark.parametrize(("loop", "coarsest"), [("smooth", 75), ("chattering", 300)])
def test_rk4_is_of_order_four(loop, coarsest, request):
    closed = request.getfixturevalue(loop)
    start = closed.run(start=START, duration=1e-3, step=1e-3)
    end = truth(np.concatenate([start.u[0], start.tau[0]]), 1.5, loop == "smooth")
    errors = []
    for steps in (coarsest, 2 * coarsest, 4 * coarsest):
        run = closed.run(start=START, duration=1.5, step=1.5 / steps)
        errors.append(np.linalg.norm(np.concatenate([run.u[-1], run.tau[-1]]) - end))
    ratios = np.array(errors[:-1]) / errors[1:]
    assert np.all((ratios > 14.5) & (ratios < 18))


def test_hold_converges_at_first_order(smooth):
    continuous = smooth.run(start=START, duration=2.0, step=5e-4)
    errors = [
        np.abs(smooth.run(start=START, duration=2.0, step=step, hold=True).u[-1] - continuous.u[-1]).max()
        for step in (0.02, 0.01, 0.005, 0.0025)
    ]
    ratios = np.array(errors[:-1]) / errors[1:]
    assert np.all((ratios > 1.9) & (ratios < 2.1))


def test_hold_keeps_the_constraint_at_every_tick(smooth):
    """step(dt) projects, so phi = 0 to rounding at each tick, whatever dt is."""
    run = smooth.run(start=START, duration=5.0, step=0.01, hold=True)
    assert np.abs(run.phi).max() < 1e-15


def test_float32_follows_too():
    run = ClosedLoop(stabilisation("single", smooth=True, Theta=-2.0), scalar="float32").run(
        start=START, duration=5.0, step=1e-3
    )
    assert run.u.dtype == np.float32
    assert off_decay(run).max() < 1e-3
