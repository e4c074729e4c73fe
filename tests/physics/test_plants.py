"""The mechanisms themselves, as generated C with tau = 0: what mechanics conserves stays."""

import ctypes as ct
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp
from servogen.compiler import build_plant
from servogen.loading import load_scene
from servogen.twins.compiled import compile_library


def plant(name: str) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """(q, u, tau) -> (q', u') of a built-in scene's generated plant; its structs hold nothing but doubles."""
    package = build_plant(load_scene(name))
    library = compile_library(package, None, ("-O2",))
    assert package.prefix == f"{name}_plant"
    call = getattr(library, f"{name}_plant_q_dot_u_dot")
    parameters = np.concatenate([f.default for f in package.module.parameters])
    model = (ct.c_double * 64)()
    assert getattr(library, f"{name}_plant_prepare")(ct.c_void_p(parameters.ctypes.data), model) == 0

    def rate(q: np.ndarray, u: np.ndarray, tau: np.ndarray) -> np.ndarray:
        given = np.concatenate([q, u, tau])
        q_dot, u_dot = np.empty(len(q)), np.empty(len(u))
        pointers = [ct.c_void_p(a.ctypes.data) for a in (given, q_dot, u_dot)]
        assert call(model, *pointers) == 0
        return np.concatenate([q_dot, u_dot])

    rate.library = library  # type: ignore[attr-defined]
    return rate


def coast(name: str, q: np.ndarray, u: np.ndarray, controls: int, duration: float) -> np.ndarray:
    """Rows (q, u) of the free motion."""
    rate, n = plant(name), len(q)
    run = solve_ivp(
        lambda t, x: rate(x[:n], x[n:], np.zeros(controls)), (0, duration), np.concatenate([q, u]),
        "DOP853", rtol=1e-12, atol=1e-13,
    )  # fmt: skip
    return run.y.T


def test_a_free_spacecraft_keeps_energy_and_angular_momentum():
    inertia = np.array([10.0, 6.3, 8.5])
    omega = coast("spacecraft", np.zeros(3), np.array([0.3, -0.5, 0.2]), 3, 60.0)[:, 3:]
    energy, momentum = omega**2 @ inertia / 2, np.linalg.norm(omega * inertia, axis=1)
    assert np.ptp(omega[:, 0]) > 0.1  # it does tumble
    assert np.ptp(energy) < 1e-10 * energy[0]
    assert np.ptp(momentum) < 1e-10 * momentum[0]


def test_a_free_double_pendulum_keeps_its_energy():
    rows = coast("double_pendulum_energy", np.array([1.6, -1.8]), np.array([-1.6, 0.8]), 2, 10.0)
    q, u = rows[:, :2], rows[:, 2:]
    m, R, h, g = 1.0, 0.5, 0.6, 9.81
    K = ((m * R**2 + 0.2) * u[:, 0] ** 2 + (m * h**2 + 0.12) * u[:, 1] ** 2) / 2
    K += m * h * R * np.cos(q[:, 0] - q[:, 1]) * u[:, 0] * u[:, 1]
    E = K + m * g * (R * (1 - np.cos(q[:, 0])) + h * (1 - np.cos(q[:, 1])))
    assert np.ptp(K) > 1.0
    assert np.ptp(E) < 1e-9 * E[0]


def test_tau_enters_through_G():
    rate = plant("double_pendulum_energy")
    q, u, tau = np.array([0.4, -0.3]), np.array([1.0, 2.0]), np.array([0.7, -0.2])
    coupling = 0.3 * np.cos(0.7)
    Q = np.array([[0.45, coupling], [coupling, 0.48]])
    G = np.array([[1.0, -1.0], [0.0, 1.0]])
    difference = rate(q, u, tau)[2:] - rate(q, u, 0 * tau)[2:]
    assert np.allclose(difference, np.linalg.solve(Q, G @ tau), rtol=1e-13)


def test_a_plant_refuses_nan_and_leaves_its_outputs():
    rate = plant("spacecraft")
    call = rate.library.spacecraft_plant_q_dot_u_dot  # type: ignore[attr-defined]
    given, out = np.array([0.0] * 8 + [np.nan]), np.array([7.0] * 6)
    model = (ct.c_double * 64)()
    pointers = [ct.c_void_p(a) for a in (given.ctypes.data, out.ctypes.data, out.ctypes.data + 24)]
    assert call(model, *pointers) == -1
    assert np.array_equal(out, [7.0] * 6)
