"""Outputs of any relative degree: against closed forms, motions known beforehand, and their own first cases."""

from math import comb, factorial
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.compiler import derived_scene
from servogen.simulate.closed_loop import simulate
from support.high_degree import cars, cars_scene, flexible_joint_arm, rod_dynamics, thetas
from support.models import random_model

PULL = 5.0


def force_on_two(y: dict[int, float], m: tuple[float, float]) -> float:
    """F under which the first of two cars has these derivatives y: by solving for the second one by hand."""
    return m[0] * m[1] / PULL * y[4] + (m[0] + m[1]) * y[2]


def force_on_three(y: dict[int, float]) -> float:
    second = {k: y[k] + 1 / PULL * y[k + 2] for k in (2, 4)}
    third = second[2] + (2 * second[4] + 1 * y[4]) / PULL
    return 1 * y[2] + 2 * second[2] + 3 * third


def wanted(y: list[float], r: list[float], rate: float) -> float:
    """The derivative after those in y, for the decay at `rate` onto r: binomial coefficients, not our polynomial."""
    n = len(y)
    return r[n] - sum(comb(n, k) * rate ** (n - k) * (y[k] - r[k]) for k in range(n))


def inputs(rng: np.random.Generator, count: int, degree: int) -> tuple[dict[str, Any], list[float]]:
    names = ["r", "r_dot", "r_ddot", *(f"r_d{k}" for k in range(3, degree + 1))]
    r = rng.normal(size=degree + 1).tolist()
    return {"q": rng.normal(size=count), "u": rng.normal(size=count)} | dict(zip(names, r, strict=True)), r


def test_two_cars_are_driven_by_the_closed_form() -> None:
    twin, rng = sg.build(cars_scene(2, 4)).load(flags=["-O0"]), np.random.default_rng(1)
    for _ in range(5):
        at, r = inputs(rng, 2, 4)
        (x1, x2), (v1, v2) = at["q"], at["u"]
        y = [x1, v1, PULL * (x2 - x1), PULL * (v2 - v1)]
        force = force_on_two({2: y[2], 4: wanted(y, r, 2.0)}, (1.0, 2.0))
        assert twin.control(**at).value == pytest.approx([force], rel=1e-12)
        assert twin.S(**at) == pytest.approx(np.array([[PULL / 2]]))


def test_three_cars_are_driven_by_the_closed_form() -> None:
    scene, rng = cars_scene(3, 6), np.random.default_rng(2)
    twin, textbook = sg.build(scene).load(flags=["-O0"]), sg.reference(scene)
    for _ in range(5):
        at, r = inputs(rng, 3, 6)
        x, v = at["q"], at["u"]
        y = [x[0], v[0], PULL * (x[1] - x[0]), PULL * (v[1] - v[0])]
        for ends in (x, v):  # the second car's acceleration less the first one's, and the rate of that
            second = PULL * (ends[2] - 2 * ends[1] + ends[0]) / 2
            y.append(PULL * (second - PULL * (ends[1] - ends[0])))
        force = force_on_three({2: y[2], 4: y[4], 6: wanted(y, r, 2.0)})
        assert twin.control(**at).value == pytest.approx([force], rel=1e-11)
        assert textbook.control(**at).value == pytest.approx([force], rel=1e-11)


def test_cars_joined_by_a_rod_are_one() -> None:
    """A passive constraint between the second and the third: two cars, the other of 5 kg."""
    scene = cars_scene(3, 4, passive=(lambda q: sg.PassiveHolonomic("rod", q[2] - q[1] - 0.3),))
    x, v, r = [0.2, -0.1, 0.2], [0.4, 0.7, 0.7], [0.1, -0.2, 0.3, 0.5, -0.7]
    at = {"q": x, "u": v, "r": r[0], "r_dot": r[1], "r_ddot": r[2], "r_d3": r[3], "r_d4": r[4]}
    y = [x[0], v[0], PULL * (x[1] - x[0]), PULL * (v[1] - v[0])]
    force = force_on_two({2: y[2], 4: wanted(y, r, 2.0)}, (1.0, 5.0))
    for twin in (sg.build(scene).load(flags=["-O0"]), sg.reference(scene)):
        assert twin.control(**at).value == pytest.approx([force], rel=1e-12)


def test_the_loop_of_two_cars_decays_as_prescribed() -> None:
    """From a start off the path: (1 + ...) exp(-2 t), the answer of psi^(4) = Theta (psi, ..., psi''')."""
    scene = cars_scene(2, 4)
    references = {"r": lambda t: 0.5 * ca.sin(t)}
    at = {"q": [0.2, -0.1], "u": [0.0, 0.3]}
    domain = {"q": (-5.0, 5.0), "u": (-5.0, 5.0)}
    run = simulate(scene, sg.Simulation(start=at, duration=4.0, step=2e-3, references=references, domain=domain))
    assert run.verdict.word == "held"
    y = [0.2, 0.0, PULL * -0.3, PULL * 0.3]
    psi = [a - b for a, b in zip(y, [0.0, 0.5, 0.0, -0.5], strict=True)]
    c = [sum(2.0 ** (k - j) / factorial(j) / factorial(k - j) * psi[j] for j in range(k + 1)) for k in range(4)]
    expected = np.exp(-2 * run.t) * sum(c[k] * run.t**k for k in range(4))
    np.testing.assert_allclose(run.constraint[:, 0], expected, atol=1e-9)


def test_the_flexible_joint_arm_along_a_motion_known_beforehand() -> None:
    """The rods' angles as functions of time give rotors and torques by differentiation in time alone.

    With the end's path as reference the controller must ask for these torques: no Lie derivative is in this truth.
    """
    scene = flexible_joint_arm()
    par, t = scene.parameters, ca.SX.sym("t")
    angle = ca.vertcat(0.3 * ca.sin(2 * t), 1.2 + 0.4 * ca.cos(3 * t))

    def rate(x: Any) -> Any:
        return ca.jacobian(x, t)

    M, h, end = rod_dynamics(angle, rate(angle), par)
    pull = ca.mtimes(M, rate(rate(angle))) + h
    rotors = angle + pull / par.k
    torque = par.B * rate(rate(rotors)) + pull
    path = [end]
    for _ in range(4):
        path.append(rate(path[-1]))
    state = [ca.vertcat(angle, rotors), rate(ca.vertcat(angle, rotors))]
    truth = ca.Function("truth", [t, *(f.symbol for f in par)], [torque, *state, *path])
    twin, textbook = sg.build(scene).load(flags=["-O0"]), sg.reference(scene)
    for time in (0.0, 0.31, 0.77):
        tau, q, u, *r = (np.array(v).ravel() for v in truth(time, *(f.default for f in par)))
        names = ("r", "r_dot", "r_ddot", "r_d3", "r_d4")
        at = {"q": q, "u": u} | dict(zip(names, r, strict=True))
        np.testing.assert_allclose(twin.control(**at).value, tau, rtol=1e-9)
        np.testing.assert_allclose(textbook.control(**at).value, tau, rtol=1e-9)


@pytest.mark.parametrize("degree", [1, 2])
def test_the_first_degrees_are_what_they_always_were(degree: int) -> None:
    """Instruction for instruction the program of a Nonholonomic or a Holonomic."""
    model, T = random_model(3, 3, 2), [[-3.0, 0.5], [0.0, -2.0]]
    psi = ca.vertcat(ca.sin(model.q[0]) * model.q[1], model.q[2] ** 2 - model.mechanism.t)
    psi = psi if degree == 2 else psi + ca.vertcat(model.u[0], model.u[1] * model.q[0])
    old = sg.Nonholonomic("c", psi, T) if degree == 1 else sg.Holonomic("c", psi, T, -2.0)
    new = sg.Output("c", psi, [T] if degree == 1 else [-2.0, T])
    programs = [
        derived_scene(sg.Scene("same", model.mechanism, [c], model.parameters, model.references))[1] for c in (old, new)
    ]
    assert str(programs[0]) == str(programs[1])


def test_a_speed_that_no_control_reaches_at_once() -> None:
    """A psi of u with degree 3: the first car's speed, whose integral has degree 4."""
    mech, ref = cars(2), sg.References(r=sg.Ref(0.0, order=3))
    scene = sg.Scene("speed", mech, [sg.Output("v", mech.u[0] - ref.r, thetas(3, 2.0))], references=ref)
    at, r = inputs(np.random.default_rng(4), 2, 3)
    (x1, x2), (v1, v2) = at["q"], at["u"]
    y = [v1, PULL * (x2 - x1), PULL * (v2 - v1)]
    force = force_on_two({2: y[1], 4: wanted(y, r, 2.0)}, (1.0, 2.0))
    assert sg.reference(scene).control(**at).value == pytest.approx([force], rel=1e-12)
    assert sg.build(scene).load(flags=["-O0"]).control(**at).value == pytest.approx([force], rel=1e-12)
