"""S, z, A and B against the motion itself: constraints differentiated numerically along simulated trajectories."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from support.models import MASSES, defaults, derived, random_scene

NO_TAU = np.zeros(3)
STEPS, H = 4, 8e-3  # of the trajectory to either side of the state: derivatives by a stencil of five points


class Motion:
    """The scene's mechanism simulated in numpy from Eqs. (1)-(2) as given, with tau and references as polynomials."""

    def __init__(self, scene: sg.Scene) -> None:
        mech, fields = scene.mechanism, scene.input_fields()
        self.scene = scene
        self.names = [f.name for f in fields]
        symbols = [f.symbol for f in fields if f.name != "tau"] + [
            mech.tau,
            *(f.symbol for f in scene.parameters or ()),
        ]
        parts = [mech.q_dot, mech.Q, mech.P, mech.G, *(_constraint(c) for c in scene.constraints)]
        self.function = ca.Function("parts", symbols, [ca.densify(p) for p in parts])
        self.parameters = [list(f.default) for f in scene.parameters or ()]
        self.theta = [_theta(scene, c) for c in scene.constraints]

    def parts(self, state: dict[str, Any], s: float, q: Any, u: Any, tau: Any) -> list[Any]:
        """q', Q, P, G and the constraints at time t + s."""
        at = dict(state) | {"q": q, "u": u, "t": state["t"] + s}
        for name in self.names:
            if name + "_dot" in state and not name.endswith(("_dot", "_ddot")):
                rate, bend = state[name + "_dot"], state.get(name + "_ddot", 0.0 * state[name])
                at[name], at[name + "_dot"] = state[name] + s * rate + s * s / 2 * bend, rate + s * bend
        ordered = [at[n] for n in self.names if n != "tau"]
        return [np.array(v.full()) for v in self.function.call([ca.DM(x) for x in (*ordered, tau, *self.parameters)])]

    def rates(self, state: dict[str, Any], s: float, x: Any, tau: Any) -> Any:
        n = self.scene.mechanism.q.size1()
        q_dot, Q, P, G = self.parts(state, s, x[:n], x[n:], tau)[:4]
        return np.concatenate([q_dot.ravel(), np.linalg.solve(Q, P + G @ np.reshape(tau, (-1, 1))).ravel()])

    def constraints_at(self, state: dict[str, Any], tau_of: Any) -> list[Any]:
        """Each constraint's values at s = -2h, -h, 0, h, 2h: arrays (5, rows), by Runge and Kutta's method."""
        n = self.scene.mechanism.q.size1()
        start = np.concatenate([state["q"], state["u"]])
        samples: dict[int, list[Any]] = {0: self.parts(state, 0.0, state["q"], state["u"], tau_of(0.0))[4:]}
        for sign in (1, -1):
            x, h = start, sign * H / STEPS
            for k in range(2 * STEPS):
                s = k * h
                k1 = self.rates(state, s, x, tau_of(s))
                k2 = self.rates(state, s + h / 2, x + h / 2 * k1, tau_of(s + h / 2))
                k3 = self.rates(state, s + h / 2, x + h / 2 * k2, tau_of(s + h / 2))
                k4 = self.rates(state, s + h, x + h * k3, tau_of(s + h))
                x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
                if (k + 1) % STEPS == 0:
                    at = sign * (k + 1) // STEPS
                    samples[at] = self.parts(state, at * H, x[:n], x[n:], tau_of(at * H))[4:]
        return [np.stack([samples[k][c].ravel() for k in (-2, -1, 0, 1, 2)]) for c in range(len(self.theta))]


def _constraint(c: Any) -> Any:
    return c.phi if isinstance(c, sg.ControlsInvolved) else c.psi


def _theta(scene: sg.Scene, c: Any) -> list[Any]:
    parts = [c.Theta1, c.Theta2] if isinstance(c, sg.Holonomic) else [c.Theta]
    symbols = [f.symbol for f in scene.parameters or ()]
    values = [list(f.default) for f in scene.parameters or ()]
    return [
        v.full() for v in ca.Function("theta", symbols, [ca.densify(p) for p in parts]).call([ca.DM(v) for v in values])
    ]


def first(values: Any) -> Any:
    """Derivative in the middle of five points."""
    return (values[0] - 8 * values[1] + 8 * values[3] - values[4]) / (12 * H)


def second(values: Any) -> Any:
    """Second derivative in the middle of five points."""
    return (-values[0] + 16 * values[1] - 30 * values[2] + 16 * values[3] - values[4]) / (12 * H * H)


def excess(motion: Motion, samples: list[Any]) -> Any:
    """psi' - Theta psi, or psi'' - Theta1 psi' - Theta2 psi, rows stacked in the order of the constraints."""
    rows = []
    for c, theta, values in zip(motion.scene.constraints, motion.theta, samples, strict=True):
        if isinstance(c, sg.Holonomic):
            rows.append(second(values) - theta[0] @ first(values) - theta[1] @ values[2])
        else:
            rows.append(first(values) - theta[0] @ values[2])
    return np.concatenate(rows)


def random_state(scene: sg.Scene, rng: np.random.Generator) -> dict[str, Any]:
    state = {f.name: rng.uniform(-1, 1, f.size) for f in scene.input_fields()}
    return {"t": np.zeros(1)} | state


@pytest.mark.parametrize("kind", ["nonholonomic", "holonomic", "mixed"])
@pytest.mark.parametrize("mass", MASSES)
def test_servo_system_is_the_motion(kind: str, mass: str) -> None:
    """psi' - Theta psi = S tau - z (psi'' - Theta1 psi' - Theta2 psi likewise) for every tau, on random models."""
    for seed in (MASSES.index(mass),):
        scene = random_scene(seed, kind, mass=mass)
        _, quantities = derived(scene)
        motion, rng = Motion(scene), np.random.default_rng(seed)
        state = random_state(scene, rng)
        system = quantities(**state, tau=np.zeros(scene.controls))
        np.testing.assert_allclose(system["psi"].ravel(), np.concatenate(
            [v[2] for v in motion.constraints_at(state, lambda s: NO_TAU)]))  # fmt: skip
        for _ in range(2):
            tau = rng.uniform(-2, 2, scene.controls)
            left = excess(motion, motion.constraints_at(state, lambda s, tau=tau: tau))
            right = system["S"] @ tau - system["z"].ravel()
            np.testing.assert_allclose(left, right, rtol=2e-6, atol=2e-6 * (1 + np.abs(right).max()))


@pytest.mark.parametrize("mass", MASSES)
def test_controls_involved_system_is_the_motion(mass: str) -> None:
    """phi' - Theta phi = A tau' - B for every tau'."""
    for seed in (10 + MASSES.index(mass),):
        scene = random_scene(seed, "controls", mass=mass)
        _, quantities = derived(scene)
        motion, rng = Motion(scene), np.random.default_rng(seed)
        state = random_state(scene, rng)
        system = quantities(**state)
        for _ in range(2):
            rate = rng.uniform(-2, 2, scene.controls)
            left = excess(
                motion, motion.constraints_at(state, lambda s, start=state["tau"], rate=rate: start + s * rate)
            )
            right = system["A"] @ rate - system["B"].ravel()
            np.testing.assert_allclose(left, right, rtol=2e-6, atol=2e-6 * (1 + np.abs(right).max()))


@pytest.mark.parametrize(("m", "l", "n"), [(1, 1, 1), (1, 2, 2), (2, 2, 4), (2, 5, 3), (3, 3, 3)])
def test_other_shapes(m: int, l: int, n: int) -> None:
    for kind in ("nonholonomic", "controls"):
        scene = random_scene(7, kind, m, l, n)
        _, quantities = derived(scene)
        motion, rng = Motion(scene), np.random.default_rng(1)
        state, x = random_state(scene, rng), rng.uniform(-1, 1, l)
        matrix, right = scene.system.matrix, scene.system.right
        inputs = state if kind == "controls" else state | {"tau": x}
        system = quantities(**inputs)
        assert system[matrix].shape == (m, l)
        assert system[right].shape == (m, 1)
        start = state.get("tau", x)
        rate = x if kind == "controls" else 0.0 * x
        left = excess(motion, motion.constraints_at(state, lambda s, start=start, rate=rate: start + s * rate))
        np.testing.assert_allclose(left, system[matrix] @ x - system[right].ravel(), rtol=2e-6, atol=1e-5)


def test_the_check_can_fail() -> None:
    """A wrong sign in z is seen."""
    scene = random_scene(0, "nonholonomic")
    _, quantities = derived(scene)
    motion, rng = Motion(scene), np.random.default_rng(0)
    state, tau = random_state(scene, rng), rng.uniform(-1, 1, scene.controls)
    left = excess(motion, motion.constraints_at(state, lambda s: tau))
    system = quantities(**state, tau=tau)
    assert np.abs(left - (system["S"] @ tau + system["z"].ravel())).max() > 0.1


def test_a_reference_moves_z_but_not_the_matrix() -> None:
    scene = random_scene(0, "nonholonomic")
    _, quantities = derived(scene)
    state = random_state(scene, np.random.default_rng(0)) | {"tau": np.zeros(3)}
    moved = state | {"r_dot": state["r_dot"] + 1.0}
    assert np.array_equal(quantities(**state)["S"], quantities(**moved)["S"])
    assert np.all(quantities(**state)["z"] != quantities(**moved)["z"])


def test_defaults_are_parameters() -> None:
    assert defaults(random_scene(0, "mixed")) == {"m": [1.3], "k": [0.4, -0.7], "spare": [2.0]}
