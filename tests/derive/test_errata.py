"""The paper's printed errors that the pendulum and the spacecraft touch: the printed form fails, ours passes.

Bajodah, Hodges and Chen (2004); each test names the place in the paper.
"""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.loading import load_scene
from support.models import derived

PENDULUM = load_scene("double_pendulum_energy")
SPACECRAFT = load_scene("spacecraft")
PENDULUM_QUANTITIES, SPACECRAFT_QUANTITIES = derived(PENDULUM)[1], derived(SPACECRAFT)[1]
STATES = 25
rng = np.random.default_rng(42)


@pytest.fixture(autouse=True)
def _same_numbers() -> None:
    """Each test draws the same states, whichever ran before."""
    rng.bit_generator.state = np.random.default_rng(42).bit_generator.state


@dataclass(frozen=True)
class Pendulum:
    """The numbers of Section 4 at one state; theta, omega, tau arrays of two."""

    theta: Any
    omega: Any
    tau: Any
    m: float = 1.0
    R: float = 0.5
    L: float = 1.2
    I_D: float = 0.2
    I_B: float = 0.12
    g: float = 9.81

    def at(self, theta: Any, omega: Any) -> "Pendulum":
        return Pendulum(theta, omega, self.tau)

    @property
    def cos(self) -> float:
        return float(np.cos(self.theta[0] - self.theta[1]))

    @property
    def sin(self) -> float:
        return float(np.sin(self.theta[0] - self.theta[1]))

    @property
    def Q(self) -> Any:
        """Eq. (20)."""
        coupling = self.m * self.L / 2 * self.R * self.cos
        return np.array([[self.m * self.R**2 + self.I_D, coupling], [coupling, self.m * self.L**2 / 4 + self.I_B]])

    @property
    def P(self) -> Any:
        """Eq. (21)."""
        m, g, R, h = self.m, self.g, self.R, self.L / 2
        return np.array([
            -m * g * R * np.sin(self.theta[0]) - m * h * R * self.omega[1] ** 2 * self.sin,
            -m * g * h * np.sin(self.theta[1]) + m * h * R * self.omega[0] ** 2 * self.sin,
        ])  # fmt: skip

    @property
    def acceleration(self) -> Any:
        """u' of Eq. (2) with G of Eq. (22)."""
        return np.linalg.solve(self.Q, self.P + np.array([[1, -1], [0, 1]]) @ self.tau)

    def energy(self, cross: float) -> float:
        """E below Eq. (22); cross: the factor of L R u1 u2 cos inside 1/2 m_B [...]: 1, printed -1/2."""
        u, h = self.omega, self.L / 2
        V = self.m * self.g * (self.R * (1 - np.cos(self.theta[0])) + h * (1 - np.cos(self.theta[1])))
        bracket = self.R**2 * u[0] ** 2 + h**2 * u[1] ** 2 + cross * self.L * self.R * u[0] * u[1] * self.cos
        return float(self.I_D * u[0] ** 2 / 2 + self.I_B * u[1] ** 2 / 2 + self.m * bracket / 2 + V)


def pendulum() -> Pendulum:
    return Pendulum(rng.uniform(-3, 3, 2), rng.uniform(-3, 3, 2), rng.uniform(-3, 3, 2))


def along_the_motion(p: Pendulum, quantity: Any) -> float:
    """d/dt of a function of theta and omega along Eqs. (1)-(2), by central differences."""
    h = 1e-6
    ahead = p.at(p.theta + h * p.omega, p.omega + h * p.acceleration)
    behind = p.at(p.theta - h * p.omega, p.omega - h * p.acceleration)
    return float((quantity(ahead) - quantity(behind)) / (2 * h))


def ours(p: Pendulum) -> dict[str, Any]:
    return PENDULUM_QUANTITIES(q=p.theta, u=p.omega, tau=p.tau, E_0=[0.0])


def test_eq_25_pseudo_inverse_of_a_row() -> None:
    """Printed S^T / ||S||; right S^T / ||S||^2: only the latter satisfies S S+ S = S."""
    twin = sg.reference(PENDULUM)
    for _ in range(STATES):
        S = rng.normal(size=(1, 2))
        norm = np.linalg.norm(S)
        printed, right = S.T / norm, S.T / norm**2
        np.testing.assert_allclose(S @ right @ S, S)
        assert np.abs(S @ printed @ S - S).max() > 1e-3
        np.testing.assert_allclose(twin.pinv(S), right, rtol=0, atol=1e-14 / norm)


def test_energy_below_eq_22_cross_term() -> None:
    """Printed -(L/2) R u1 u2 cos; right + L R u1 u2 cos: half u^T Q u with Q of Eq. (20), whose power is u^T G tau."""
    wrong = 0
    for _ in range(STATES):
        p = pendulum()
        power = p.omega @ np.array([[1, -1], [0, 1]]) @ p.tau
        assert along_the_motion(p, lambda x: x.energy(1.0)) == pytest.approx(power, rel=1e-6, abs=1e-6)
        wrong += abs(along_the_motion(p, lambda x: x.energy(-0.5)) - power) > 1e-2
        kinetic = p.energy(1.0) - Pendulum(p.theta, 0 * p.omega, p.tau).energy(1.0)
        assert kinetic == pytest.approx(p.omega @ p.Q @ p.omega / 2)
        assert ours(p)["psi"][0, 0] == pytest.approx(p.energy(1.0), rel=1e-12)
    assert wrong >= STATES - 2  # a wrong term may be small by chance


def test_X_below_eq_23() -> None:
    """X = psi_q u. Printed m_B (L/4) R (u1^2 u2 - u1 u2^2) sin + ...; right -m_B (L/2) R (...) sin + ..."""

    def X(p: Pendulum, factor: float) -> float:
        u = p.omega
        turning = factor * p.m * p.L * p.R * (u[0] ** 2 * u[1] - u[0] * u[1] ** 2) * p.sin
        return turning + p.m * p.g * (p.R * np.sin(p.theta[0]) * u[0] + p.L / 2 * np.sin(p.theta[1]) * u[1])

    wrong = 0
    for _ in range(STATES):
        p, h = pendulum(), 1e-6
        ahead, behind = (p.at(p.theta + s * h * p.omega, p.omega).energy(1.0) for s in (1, -1))
        true = (ahead - behind) / (2 * h)
        assert X(p, -0.5) == pytest.approx(true, rel=1e-6, abs=1e-6)
        wrong += abs(X(p, 0.25) - true) > 1e-2
        # z = -psi_u Q^-1 P - X + Theta psi, and psi_u Q^-1 = u^T
        assert ours(p)["z"][0, 0] == pytest.approx(-p.omega @ p.P - X(p, -0.5) - p.energy(1.0), rel=1e-9, abs=1e-9)
    assert wrong >= STATES - 2  # a wrong term may be small by chance


def independent_form(p: Pendulum, cross: float, last: int) -> tuple[float, float]:
    """A and B of Eqs. (26)-(29); cross: as in energy; last: whose square I_B takes in (29), printed u1 (0)."""
    u, m, R, L = p.omega, p.m, p.R, p.L
    below = p.I_B * u[1] + m * L / 4 * (L * u[1] + 2 * cross * R * u[0] * p.cos)
    A = (-p.I_D * u[0] - m * R * (R * u[0] + cross * L / 2 * u[1] * p.cos)) / below
    turning = cross * m * L / 2 * R * u[0] * u[1] * p.sin * (u[0] - u[1])
    V = m * p.g * (R * (1 - np.cos(p.theta[0])) + L / 2 * (1 - np.cos(p.theta[1])))
    bracket = R**2 * u[0] ** 2 + L**2 / 4 * u[1] ** 2 + cross * L * R * u[0] * u[1] * p.cos
    mu = (
        turning - p.I_D * u[0] ** 2 / 2 - p.I_B * u[last] ** 2 / 2 - m * p.g * R * np.sin(p.theta[0]) * u[0]
        - m * p.g * L / 2 * np.sin(p.theta[1]) * u[1] - V - m * bracket / 2
    )  # fmt: skip
    return A, mu / below


@pytest.mark.parametrize(
    ("cross", "last", "right"), [(1.0, 1, True), (-0.5, 1, False), (1.0, 0, False), (-0.5, 0, False)]
)
def test_eqs_27_to_29_independent_form(cross: float, last: int, right: bool) -> None:
    """u_D' = A u_I' + B must meet psi' = -psi: cross terms of (27)-(29), and I_B u2^2 (printed u1^2) in (29)."""
    met = 0
    for _ in range(STATES):
        p = pendulum()
        A, B = independent_form(p, cross, last)
        u_I_dot = rng.uniform(-2, 2)
        u_dot = np.array([u_I_dot, A * u_I_dot + B])
        h = 1e-6
        ahead, behind = (p.at(p.theta + s * h * p.omega, p.omega + s * h * u_dot).energy(1.0) for s in (1, -1))
        met += abs((ahead - behind) / (2 * h) + p.energy(1.0)) < 1e-4 * (1 + p.energy(1.0) + np.abs(u_dot).max())
    assert met == STATES if right else met <= STATES // 5  # a wrong term may be small by chance


def test_ideal_forces_agree_with_the_derived_system() -> None:
    """R = Q u' - P with any u' that meets (26) satisfies S tau = z for tau = G^-1 R, Eqs. (13)-(17)."""
    for _ in range(STATES):
        p = pendulum()
        A, B = independent_form(p, 1.0, 1)
        u_dot = np.array([0.3, A * 0.3 + B])
        tau = np.linalg.solve([[1, -1], [0, 1]], p.Q @ u_dot - p.P)
        system = ours(p)
        assert float((system["S"] @ tau)[0]) == pytest.approx(system["z"][0, 0], rel=1e-8, abs=1e-8)


# ---- Section 6: the spacecraft ----

INERTIA = np.array([10.0, 6.3, 8.5])


def euler(w: Any, tau: Any) -> Any:
    """w' of Eqs. (42)-(44) with tau as torque over inertia."""
    I_1, I_2, I_3 = INERTIA
    return np.array(
        [(I_2 - I_3) / I_1 * w[1] * w[2], (I_3 - I_1) / I_2 * w[2] * w[0], (I_1 - I_2) / I_3 * w[0] * w[1]]
    ) + tau  # fmt: skip


def bracket() -> float:
    """What Eqs. (48)-(50) and (52) multiply w1 w2 w3 and its rate with."""
    I_1, I_2, I_3 = INERTIA
    return (I_2 - I_3) / I_1 + (I_3 - I_1) / I_2 + (I_1 - I_2) / I_3


def energy(w: Any) -> float:
    return float(INERTIA @ w**2 / 2)


def spacecraft_state() -> tuple[Any, Any]:
    return rng.uniform(-1, 1, 3), rng.uniform(-1, 1, 3)


def of_spacecraft(w: Any, tau: Any) -> dict[str, Any]:
    return SPACECRAFT_QUANTITIES(q=np.zeros(3), u=w, tau=tau)


def test_eq_48_bracket() -> None:
    """K' + a K: the printed w1 w2 w3 [...] is absent, because I_i w_i times the terms of (42)-(44) sum to zero."""
    wrong = 0
    for _ in range(STATES):
        w, tau = spacecraft_state()
        h = 1e-6
        rate = (energy(w + h * euler(w, tau)) - energy(w - h * euler(w, tau))) / (2 * h)
        right = float(INERTIA * w @ tau + energy(w))
        assert rate + energy(w) == pytest.approx(right, rel=1e-7, abs=1e-7)
        assert of_spacecraft(w, tau)["phi"][0, 0] == pytest.approx(right, rel=1e-12, abs=1e-12)
        wrong += abs(right + np.prod(w) * bracket() - rate - energy(w)) > 1e-6
    assert abs(bracket()) > 0.02
    assert wrong >= STATES - 2  # a wrong term may be small by chance


def test_eqs_49_50_52_bracket() -> None:
    """B of (52) without the bracket is -d/dt (I w tau + a K) at constant tau; with it, it is not."""
    wrong = 0
    for _ in range(STATES):
        w, tau = spacecraft_state()
        rate = euler(w, tau)

        def phi(x: Any, tau: Any = tau) -> float:
            return float(INERTIA * x @ tau + energy(x))

        h = 1e-6
        true = -(phi(w + h * rate) - phi(w - h * rate)) / (2 * h)
        without = -float(INERTIA * rate @ tau + INERTIA * w @ rate)
        extra = rate[0] * w[1] * w[2] + w[0] * rate[1] * w[2] + w[0] * w[1] * rate[2]
        assert without == pytest.approx(true, rel=1e-7, abs=1e-7)
        wrong += abs(without - extra * bracket() - true) > 1e-6
        system = of_spacecraft(w, tau)
        np.testing.assert_allclose(system["A"], [INERTIA * w], rtol=1e-14)  # Eq. (51)
        assert system["B"][0, 0] == pytest.approx(without, rel=1e-11, abs=1e-11)
    assert wrong >= STATES - 2  # a wrong term may be small by chance


def test_eqs_42_to_44_tau_is_torque_over_inertia() -> None:
    """As torques in N m the power would be w tau, which K' is not. As torque over inertia, M = I tau does w M."""
    for _ in range(STATES):
        w, tau = spacecraft_state()
        h = 1e-6
        rate = (energy(w + h * euler(w, tau)) - energy(w - h * euler(w, tau))) / (2 * h)
        torque = INERTIA * tau
        assert rate == pytest.approx(float(w @ torque), rel=1e-7, abs=1e-7)
        assert abs(rate - float(w @ tau)) > 1e-6
    assert np.array_equal(ca.DM(SPACECRAFT.mechanism.G).full(), np.eye(3))


def test_section_6_start_value() -> None:
    """tau_3(0) = -0.287/0.85 meets (47); the printed -0.3376 leaves phi = 4e-5."""
    w = np.full(3, 0.1)
    exact, printed = (of_spacecraft(w, np.array([0.1, 0.1, x]))["phi"][0, 0] for x in (-0.287 / 0.85, -0.3376))
    assert abs(exact) < 1e-16
    assert printed == pytest.approx(4e-5, rel=1e-6)
    assert abs(1e-3 * bracket()) > 1e-5  # what the printed (48) would ask beside


def closed_loop(start: Any, y: Any, seconds: float = 2.0, steps: int = 1000, w: Any = None) -> tuple[float, float]:
    """(K, K expected from exp(-t)) after simulating (42)-(44) with tau' of (54), by Runge and Kutta's method."""
    x = np.concatenate([np.full(3, 0.1) if w is None else w, start])
    K_0 = energy(x[:3])

    def rates(x: Any) -> Any:
        w, tau = x[:3], x[3:]
        A = INERTIA * w
        B = -float(INERTIA * euler(w, tau) @ tau + A @ euler(w, tau))
        free = y(tau)
        square = float(A @ A)
        gain = A / square if square > 0 else np.zeros(3)
        return np.concatenate([euler(w, tau), free + gain * (B - A @ free)])

    h = seconds / steps
    for _ in range(steps):
        k1 = rates(x)
        k2 = rates(x + h / 2 * k1)
        k3 = rates(x + h / 2 * k2)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rates(x + h * k3))
    return energy(x[:3]), K_0 * float(np.exp(-seconds))


def test_section_6_every_y() -> None:
    """ "All choices of y satisfy (45)": with A != 0 and phi = 0 at the start they do, and else they do not."""
    on = np.array([0.1, 0.1, -0.287 / 0.85])
    for y in (lambda tau: -tau, lambda tau: 0.2 * np.ones(3) - 2 * tau):
        found, expected = closed_loop(on, y)
        assert found == pytest.approx(expected, rel=1e-8)
    off, expected = closed_loop(on + np.array([0.0, 0.0, 0.05]), lambda tau: -tau)
    assert abs(off / expected - 1) > 0.1  # phi stays what it was at the start
    at_rest, _ = closed_loop(np.array([0.1, 0.2, 0.3]), lambda tau: -tau, w=np.zeros(3), steps=400)
    assert at_rest > 1e-4  # A = 0, phi = 0, K = 0: it should have stayed there


# ---- general statements ----


def test_after_eq_10_null_space_of_S_not_of_its_transpose() -> None:
    """Case 3: [1, 1] has many solutions though its transpose has no null space, [1, 1]^T one though it has."""
    wide, tall = np.ones((1, 2)), np.ones((2, 1))

    def null_space(matrix: Any) -> int:
        return int(matrix.shape[1] - np.linalg.matrix_rank(matrix))

    assert null_space(wide.T) == 0
    assert null_space(tall.T) == 1
    solver = sg.build_solver(1, 2).load(flags=["-O0"])
    answers = [solver.solve(wide, [2.0], y)[0] for y in ([0.0, 0.0], [5.0, -3.0])]
    assert all(float((wide @ x)[0]) == pytest.approx(2.0) for x in answers)
    assert np.abs(answers[0] - answers[1]).max() > 1
    solver = sg.build_solver(2, 1).load(flags=["-O0"])
    answers = [solver.solve(tall, [2.0, 2.0], y)[0] for y in ([0.0], [5.0])]
    np.testing.assert_allclose(answers[0], answers[1], rtol=1e-14)
    assert null_space(wide) == 1
    assert null_space(tall) == 0


def test_after_eq_12_case_1_unique_needs_full_column_rank() -> None:
    """Case 1: l <= m is not enough. [[1, 2], [2, 4]] has l = m, a consistent right side and many solutions."""
    solver = sg.build_solver(2, 2).load(flags=["-O0"])
    S, z = np.array([[1.0, 2.0], [2.0, 4.0]]), np.array([1.0, 2.0])
    answers = [solver.solve(S, z, y) for y in ([0.0, 0.0], [3.0, 0.0])]
    for x, info in answers:
        np.testing.assert_allclose(S @ x, z, rtol=1e-13)
        assert info.status == sg.Status.RANK_DEFICIENT_CONSISTENT
        assert info.rank == 1  # below l: not unique
    assert np.abs(answers[0][0] - answers[1][0]).max() > 1


def test_eq_13_text_accelerations_are_first_derivatives_of_u() -> None:
    """Equating u' (printed: u with two dots) of (15) and (2) gives (13): R = Q u' - P; with u'' it does not hold."""
    for _ in range(STATES):
        p = pendulum()
        G = np.array([[1, -1], [0, 1]])
        np.testing.assert_allclose(p.Q @ p.acceleration - p.P, G @ p.tau, rtol=1e-12, atol=1e-12)
        h = 1e-5
        ahead, behind = (p.at(p.theta + s * h * p.omega, p.omega + s * h * p.acceleration) for s in (1, -1))
        jerk = (ahead.acceleration - behind.acceleration) / (2 * h)
        assert np.abs(p.Q @ jerk - p.P - G @ p.tau).max() > 1e-2


def test_eq_16_left_inverse_needs_full_column_rank() -> None:
    """G+ G = I "because l <= n" fails for a 3 x 2 G of rank 1, and holds where rank G = l."""
    full, deficient = np.array([[1.0, -1], [0, 1], [2, 0]]), np.array([[1.0, 2], [2, 4], [0, 0]])
    solver = sg.build_solver(3, 2).load(flags=["-O0"])
    assert np.abs(solver.pinv(full)[0] @ full - np.eye(2)).max() < 1e-14
    inverse, info = solver.pinv(deficient)
    assert info.rank == 1
    assert np.abs(inverse @ deficient - np.eye(2)).max() > 0.1
    np.testing.assert_allclose(deficient @ inverse @ deficient, deficient, atol=1e-14)


def test_after_eq_35_m_below_n_is_not_sufficient() -> None:
    """A mass driven through a spring has m = 1 < n = 2, and S is identically zero."""
    x, v, force = ca.SX.sym("x", 2), ca.SX.sym("v", 2), ca.SX.sym("force")
    pull = x[1] - x[0]
    mech = sg.Mechanism(q=x, u=v, tau=force, Q=ca.DM.eye(2), P=ca.vertcat(pull, -pull), G=[0.0, 1.0])
    scene = sg.Scene("spring", mech, [sg.Holonomic("first mass", x[0], -2.0, -1.0)])
    with pytest.raises(sg.SceneError, match="does not reach the controls"):
        sg.build(scene)


def path_scene() -> sg.Scene:
    """Energy and path together, Eqs. (30)-(35)."""
    mech, par = PENDULUM.mechanism, PENDULUM.parameters
    assert par is not None
    assert PENDULUM.references is not None
    path = par.R * ca.cos(mech.q[0]) + par.L * ca.sin(mech.q[1])
    constraints = [*PENDULUM.constraints, sg.Holonomic("path", path, -2.0, -1.0)]
    return sg.Scene("energy_and_path", mech, constraints, par, PENDULUM.references)


def test_eq_35_second_row() -> None:
    """Printed d psi_2 / du, which is zero; right d psi_2 / dq (C = I): generically a solution."""
    _, quantities = derived(path_scene())
    for _ in range(STATES):
        p = pendulum()
        system = quantities(q=p.theta, u=p.omega, tau=p.tau, E_0=[0.0])
        J = system["S"] @ np.linalg.inv([[1, -1], [0, 1]]) @ p.Q
        right = [-p.R * np.sin(p.theta[0]), p.L * np.cos(p.theta[1])]
        np.testing.assert_allclose(J[1], right, rtol=1e-9, atol=1e-9)
        assert np.abs(J[1]).max() > 1e-3  # as printed the row is zero
        assert np.linalg.matrix_rank(J) == 2  # and the text's "no solution" does not follow
