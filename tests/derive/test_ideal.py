"""Ideal control forces: both routes to R, Gauss's principle, the pendulum's closed form, and what cannot be done."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from hypothesis import assume, given
from hypothesis import strategies as st
from servogen.scene.domain import draw_states
from servogen.scenes import double_pendulum_ideal
from servogen.scenes.double_pendulum_energy import E, G, K, P, Q, par, q, ref, tau, u
from servogen.scenes.double_pendulum_energy_free_y import scene as free_y
from servogen.scenes.double_pendulum_energy_free_y import simulation as free_run
from servogen.simulate.closed_loop import ClosedLoop
from support.models import MASSES, derived, random_scene
from support.programs import examples
from support.twins import as_derived


def ideal(seed: int, kind: str = "mixed", mass: str = "spd", l: int = 3) -> sg.Scene:
    s = random_scene(seed, kind, mass=mass, l=l)
    return sg.Scene(f"ideal_{kind}", s.mechanism, s.constraints, s.parameters, s.references, mode="ideal")


def states_of(scene: sg.Scene, count: int, seed: int = 0) -> list[dict[str, Any]]:
    drawn = draw_states(scene, count, seed)
    return [{n: v[k] for n, v in drawn.items()} for k in range(count)]


def relative(a: Any, b: Any) -> float:
    return float(np.max(np.abs(a - b)) / np.max(np.abs(b)))


@pytest.mark.parametrize("kind", ["nonholonomic", "holonomic", "mixed"])
@pytest.mark.parametrize("mass", MASSES)
def test_reaction_and_nonminimal_form_agree(kind: str, mass: str) -> None:
    """C: J^T (J Q^-1 J^T)^+ (b - J Q^-1 P). Reference: Q T^-1 F - P with u_D chosen at each state."""
    scene = ideal(11, kind, mass)
    code, textbook = as_derived(scene), sg.reference(scene)
    compared = 0
    for state in states_of(scene, 25):
        parts = textbook.parts(textbook.read_inputs(state))
        inertia = parts["J"] @ np.linalg.solve(parts["Q"], parts["J"].T)
        if np.linalg.cond(inertia) > 1e3:  # the stated distance from rank changes
            continue
        compared += 1
        assert relative(code.R(**state), textbook.R(**state)) < 1e-11
        T, F = code.T(**state), code.F(**state)
        R = parts["Q"] @ np.linalg.solve(T, F) - parts["P"].ravel()
        assert relative(R, textbook.R(**state)) < 1e-9 * max(1.0, np.linalg.cond(T) / 1e3)
        assert relative(T, textbook.T(**state)) < 1e-11
        assert relative(F, textbook.F(**state)) < 1e-10
        answer, expected = code.control(**state), textbook.control(**state)
        assert answer.info.status == expected.info.status
        assert np.allclose(answer.value, expected.value, rtol=1e-8, atol=1e-9)
    assert compared >= 8


def test_both_routes_agree_over_the_pendulums_domain() -> None:
    """Away from rest (K above 1e-3 J, where the row J = u^T Q vanishes)."""
    scene = double_pendulum_ideal.scene
    code, textbook = sg.build(scene).load(), sg.reference(scene)
    worst = 0.0
    for state in states_of(scene, 500):
        if np.linalg.norm(state["u"]) > 0.1:
            worst = max(worst, relative(code.R(**state), textbook.R(**state)))
    assert worst < 1e-11


def test_gauss_principle() -> None:
    """u' = Q^-1 (P + R) minimises (u' - a)^T Q (u' - a), a = Q^-1 P, subject to the rows: by Lagrange's conditions."""
    scene = ideal(7)
    code, textbook = sg.build(scene).load(), sg.reference(scene)
    for state in states_of(scene, 25):
        parts = textbook.parts(textbook.read_inputs(state))
        Q, P, J = parts["Q"], parts["P"].ravel(), parts["J"]
        b = (parts["prescribed"] - parts["X"]).ravel()
        a = np.linalg.solve(Q, P)
        lagrange = np.block([[Q, J.T], [J, np.zeros((2, 2))]])
        least = np.linalg.solve(lagrange, np.concatenate([Q @ a, b]))[:3]
        ours = np.linalg.solve(Q, P + code.R(**state))
        assert np.allclose(ours, least, rtol=1e-9, atol=1e-9)
        rng = np.random.default_rng(1)
        null = np.linalg.svd(J)[2][2:].T
        for move in rng.normal(size=(20, 1)) @ null.T:  # no admissible neighbour is nearer to a
            other = ours + 1e-3 * move
            assert (other - a) @ Q @ (other - a) >= (ours - a) @ Q @ (ours - a)


def pendulum(state: dict[str, Any]) -> tuple[float, float, np.ndarray]:
    """E, K and Q at a state, by CasADi's virtual machine."""
    symbols = [f.symbol for f in par]
    function = ca.Function("energy", [q, u, *symbols], [E, K, Q])
    energy, kinetic, inertia = function(state["q"], state["u"], *(f.default for f in par))
    return float(energy), float(kinetic), np.array(inertia)


def test_the_pendulums_forces_have_a_closed_form() -> None:
    """G tau = Theta (E - E_0) Q u / (2 K), and the residual is zero: G is square."""
    code = sg.build(double_pendulum_ideal.scene).load()
    for state in states_of(double_pendulum_ideal.scene, 100):
        energy, kinetic, inertia = pendulum(state)
        force = -(energy - state["E_0"][0]) * inertia @ state["u"] / (2 * kinetic)
        answer = code.control(**state)
        assert np.allclose(np.array(ca.DM(G)) @ answer.value, force, rtol=1e-9, atol=1e-9)
        assert answer.info.status == sg.Status.OK
        assert answer.info.path == sg.Path.PRECOMPUTED
        assert answer.info.residual <= 1e-13 * np.linalg.norm(force)


def test_ideal_torques_vanish_with_E_only_where_K_does_not_vanish_faster() -> None:
    """Both regimes: they fall as exp(-t/2) where K/E stays, and grow as the mechanism comes to rest."""
    code = sg.build(double_pendulum_ideal.scene).load()
    moving = ClosedLoop(free_y, free_run).run()
    sizes = [np.linalg.norm(code.control(q=moving.q[k], u=moving.u[k]).value) for k in (0, 2000, 4000, 6000, 8000)]
    slope = np.polyfit([0, 2, 4, 6, 8], np.log(sizes), 1)[0]
    assert slope == pytest.approx(-0.5, abs=0.1)
    stopping = ClosedLoop(double_pendulum_ideal.scene, double_pendulum_ideal.simulation).run()
    assert stopping.stop.event == "K/E < 1e-3"
    assert np.max(np.abs(stopping.outputs["E"] / stopping.decay["E"] - 1)) < 1e-8  # E follows to t*
    for run in (moving, stopping):  # G tau = Theta (E - E_0) Q u / (2 K) all the way
        for k in range(0, len(run.t), len(run.t) // 40):
            energy, kinetic, inertia = pendulum({"q": run.q[k], "u": run.u[k]})
            force = -energy * inertia @ run.u[k] / (2 * kinetic)
            tau = run.tau[k] if run is stopping else code.control(q=run.q[k], u=run.u[k]).value
            assert np.allclose(np.array(ca.DM(G)) @ tau, force, rtol=1e-9, atol=1e-9)
    last = np.abs(stopping.tau[-1]).max()
    assert stopping.outputs["E"][-1] < 0.4 * stopping.outputs["E"][0]
    assert last > 4 * np.abs(stopping.tau[0]).max()


def test_forces_out_of_reach_are_told() -> None:
    """Two controls for three velocities: generically R has a part outside the range of G."""
    scene = ideal(9, l=2)
    code, textbook = sg.build(scene).load(), sg.reference(scene)
    for state in states_of(scene, 10):
        answer = code.control(**state)
        matrix = textbook.parts(textbook.read_inputs(state))["G"]
        R = code.R(**state)
        assert answer.info.status == sg.Status.RANK_DEFICIENT_INCONSISTENT
        outside = np.linalg.norm(R - matrix @ np.linalg.pinv(matrix) @ R)
        assert answer.info.residual == pytest.approx(outside, rel=1e-8)


def test_at_rest_the_pendulum_gets_no_torque_and_a_remark() -> None:
    answer = sg.build(double_pendulum_ideal.scene).load().control(q=[1.0, 0.5], u=[0.0, 0.0])
    assert answer.info.status == sg.Status.RANK_DEFICIENT_INCONSISTENT
    assert np.array_equal(answer.value, [0.0, 0.0])


def test_twins_of_an_ideal_scene_have_no_S() -> None:
    twin = sg.reference(double_pendulum_ideal.scene)
    with pytest.raises(AttributeError, match="ideal"):
        twin.S(q=[0, 0], u=[1, 1])


def test_errors() -> None:
    s = random_scene(2, "controls")
    with pytest.raises(sg.SceneError, match="controls-involved"):
        sg.Scene("s", s.mechanism, s.constraints, s.parameters, s.references, mode="ideal")
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=Q, P=P, G=G)
    rows = [sg.Nonholonomic(f"c{k}", u[0] + k * u[1] ** 2, -1.0) for k in range(3)]
    with pytest.raises(sg.SceneError, match="at most as many"):
        sg.Scene("s", mech, rows, par, ref, mode="ideal")
    with pytest.raises(sg.SceneError, match="choose 'servo' or 'ideal'"):
        sg.Scene("s", mech, rows[:1], par, ref, mode="other")


@examples(8)
@given(seed=st.integers(0, 10_000), mass=st.sampled_from(MASSES), kind=st.sampled_from(["holonomic", "mixed"]))
def test_T_u_dot_is_F_on_random_models(seed: int, mass: str, kind: str) -> None:
    """With u' = Q^-1 (P + R): both forms are the same motion, and it obeys the constraint rows J u' = b."""
    scene = ideal(seed, kind, mass)
    _, quantities = derived(scene)
    for state in states_of(scene, 3, seed):
        found, parts = quantities(**state), sg.reference(scene).parts(sg.reference(scene).read_inputs(state))
        matrix, right = found["reaction_matrix"], found["reaction_right"].ravel()
        assume(np.linalg.cond(matrix) < 1e4 and np.linalg.cond(found["T"]) < 1e6)
        R = found["J"].T @ np.linalg.solve(matrix, right)
        u_dot = np.linalg.solve(parts["Q"], parts["P"].ravel() + R)
        size = np.linalg.norm(found["T"]) * np.linalg.norm(u_dot) + np.linalg.norm(found["F"])
        assert np.linalg.norm(found["T"] @ u_dot - found["F"].ravel()) <= 1e-8 * size
        b = (parts["prescribed"] - parts["X"]).ravel()
        assert np.allclose(parts["J"] @ u_dot, b, rtol=1e-8, atol=1e-8 * (1 + np.linalg.norm(b)))


def in_units(scene: sg.Scene, *units: float) -> sg.Scene:
    """The scene with each of its constraints written in another unit."""
    parts = {sg.Holonomic: ("Theta1", "Theta2"), sg.Nonholonomic: ("Theta",)}
    constraints = [
        type(c)(c.name, unit * c.psi, *(getattr(c, name) for name in parts[type(c)]))
        for unit, c in zip(units, scene.constraints, strict=True)
    ]
    return sg.Scene("units", scene.mechanism, constraints, scene.parameters, scene.references, mode="ideal")


@pytest.mark.parametrize("units", [(1e20, 1.0), (1e-9, 1e9), (1.0, 1e-120), (1e80, 1e-80)])
@pytest.mark.parametrize("mass", ["spd", "indefinite", "exchange"])
def test_the_unit_of_a_constraint_does_not_change_its_force(units: tuple[float, float], mass: str) -> None:
    """Rows whose sizes differ by more than 1/eps once were taken for dependent."""
    plain = ideal(11, mass=mass)
    scene = in_units(plain, *units)
    code, textbook, expected = as_derived(scene), sg.reference(scene), sg.reference(plain)
    for state in states_of(plain, 5):
        R = expected.R(**state)
        assert relative(code.R(**state), R) < 1e-10
        assert relative(textbook.R(**state), R) < 1e-10
        assert code.control(**state).info.status == expected.control(**state).info.status


def test_T_and_F_do_not_exist_where_the_dependent_columns_are_singular() -> None:
    """At rest the pendulum's row u^T Q vanishes: both twins answer NaN, neither raises."""
    code, textbook = sg.build(double_pendulum_ideal.scene).load(), sg.reference(double_pendulum_ideal.scene)
    rest = {"q": np.array([1.0, 2.0]), "u": np.zeros(2), "E_0": np.zeros(1)}
    assert code.evaluate("T", rest)[0] == textbook.nonminimal(rest)[0] == sg.Status.OVERFLOW  # type: ignore[attr-defined]
    for twin in (code, textbook):
        assert np.all(np.isnan(twin.T(**rest)))
        assert twin.F(**rest).shape == (2,)
        assert np.all(np.isnan(twin.F(q=[np.nan, 0.0], u=[1.0, 1.0])))
