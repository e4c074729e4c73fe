"""Random mechanisms and scenes with everything in them: C, D, t, parameters, references with rates."""

import warnings
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import servogen as sg
from servogen.compiler import derived_scene
from servogen.derive.formulation import Formulation
from servogen.ir.evaluate import evaluate
from servogen.optimise.passes import optimise

MASSES = ("spd", "diagonal", "identity", "nonsymmetric", "indefinite", "exchange")


def mass_matrix(kind: str, q: Any, t: Any, rng: np.random.Generator) -> Any:
    """An n x n Q of q and t: regular everywhere, and of the kind that asks for one of the ways to solve."""
    n = q.size1()
    if kind == "identity":
        return ca.SX.eye(n)
    if kind == "diagonal":
        return ca.diag(ca.vertcat(*(2 + ca.sin(q[k] + k) for k in range(n))))
    R = ca.DM(rng.uniform(-0.5, 0.5, (n, n)))
    bend = ca.sin(R @ q + ca.DM(rng.uniform(-1, 1, n)) + 0.3 * t)
    low = ca.tril(ca.mtimes(bend, bend.T), False) * 0.4 + ca.SX.eye(n) * 1.5
    if kind == "spd":
        return ca.mtimes(low, low.T)
    if kind == "nonsymmetric":
        return ca.mtimes(low, low.T) + 0.2 * (R - R.T)
    if kind == "indefinite":
        signs = ca.diag([1.0 if k % 2 else -1.0 for k in range(n)])
        return ca.mtimes([low, signs, low.T])
    assert kind == "exchange"  # zeros on the diagonal: elimination has to exchange rows
    return ca.mtimes(low, low.T)[[*range(1, n), 0], :]


@dataclass(frozen=True, eq=False)
class Model:
    """A random mechanism with t, C, D, parameters and references, and the symbols to write constraints with."""

    mechanism: sg.Mechanism
    parameters: sg.Parameters
    references: sg.References

    @property
    def q(self) -> Any:
        return self.mechanism.q

    @property
    def u(self) -> Any:
        return self.mechanism.u


def random_model(seed: int, n: int, l: int, mass: str = "spd") -> Model:
    """n velocity parameters, n + 1 configuration parameters where n is even, l controls."""
    rng = np.random.default_rng(seed)
    n_q = n + 1 - n % 2
    q, u, tau, t = ca.SX.sym("q", n_q), ca.SX.sym("u", n), ca.SX.sym("tau", l), ca.SX.sym("t")
    par = sg.Parameters(m=1.3, k=[0.4, -0.7], spare=2.0)
    ref = sg.References(hold=0.2, r=sg.Ref([0.1, -0.2], order=2), s=sg.Ref(0.3, order=1))

    def numbers(*shape: int) -> Any:
        return ca.DM(rng.uniform(-1, 1, shape))

    C = numbers(n_q, n) + 0.3 * ca.mtimes(ca.sin(numbers(n_q, n_q) @ q + t), ca.SX.ones(1, n))
    D = numbers(n_q) * ca.cos(t) + 0.2 * q
    Q = mass_matrix(mass, q[:n], t, rng)
    P = (
        numbers(n) * ca.sin(q[0])
        - par.m * u * ca.fabs(par.k[0])
        + numbers(n, n) @ (u * u[0]) * 0.2
        + par.k[1] * ca.sin(t)
    )
    G = numbers(n, l) + 0.2 * ca.mtimes(numbers(n), ca.cos(q[:1] + u[:1])) @ ca.SX.ones(1, l)
    return Model(sg.Mechanism(q=q, u=u, tau=tau, Q=Q, P=P, G=G, C=C, D=D, t=t), par, ref)


def random_scene(
    seed: int, kind: str, m: int = 2, l: int = 3, n: int = 3, mass: str = "spd", y: Any = None
) -> sg.Scene:
    """kind: "nonholonomic", "holonomic", "mixed" or "controls"."""
    model = random_model(seed, n, l, mass)
    rng = np.random.default_rng(seed + 1000)
    q, u, t, tau = model.q, model.u, model.mechanism.t, model.mechanism.tau
    par, ref = model.parameters, model.references

    def numbers(*shape: int) -> Any:
        return ca.DM(rng.uniform(-1, 1, shape))

    def of_q(rows: int) -> Any:
        follow = numbers(rows, 2) @ ref.r + numbers(rows) * ref.hold
        return ca.sin(numbers(rows, q.size1()) @ q + numbers(rows) * t) + 0.5 * numbers(rows, q.size1()) @ q - follow

    def of_u(rows: int) -> Any:
        bent = numbers(rows, n) @ u + 0.3 * numbers(rows, n) @ (u * ca.cos(q[:n])) * par.m
        return bent + 0.2 * u[0] ** 2 - numbers(rows) * ref.s * ref.r[0] + of_q(rows)

    Theta = -np.diag(rng.uniform(0.5, 2, m)) + np.triu(rng.uniform(-1, 1, (m, m)), 1)
    if kind == "nonholonomic":
        constraints: list[Any] = [sg.Nonholonomic("task", of_u(m), Theta)]
    elif kind == "holonomic":
        constraints = [sg.Holonomic("path", of_q(m), -3.0, [-2.0] * m)]
    elif kind == "mixed":
        constraints = [sg.Holonomic("path", of_q(1), -3.0, -par.m), sg.Nonholonomic("task", of_u(m - 1), -1.0)]
    else:
        assert kind == "controls"
        phi = of_u(m) + numbers(m, l) @ (tau + 0.1 * tau**2) + 0.2 * ca.mtimes(numbers(m, l) * ca.sin(q[0]), tau)
        constraints = [sg.ControlsInvolved("task", phi, Theta)]
    return sg.Scene(f"random_{kind}", model.mechanism, constraints, par, ref, y=y(model) if callable(y) else y)


def defaults(scene: sg.Scene) -> dict[str, Any]:
    """The parameters' defaults as inputs of a program."""
    return {f.name: list(f.default) for f in scene.parameters or ()}


def derived(scene: sg.Scene) -> tuple[Formulation, Any]:
    """The formulation of a scene, and a function of its inputs (name -> array) to its quantities."""
    formulation, lowered = derived_scene(scene)
    program = optimise(lowered)

    def quantities(**inputs: Any) -> dict[str, Any]:
        return {name: value[0] for name, value in evaluate(program, defaults(scene) | inputs).items()}

    return formulation, quantities


def awkward_scenes() -> dict[str, sg.Scene]:
    """Small scenes, each odd in its own way, by what is odd about them."""

    def mech(n: int, l: int, **more: Any) -> sg.Mechanism:
        q, u, tau = ca.SX.sym("q", n), ca.SX.sym("u", n), ca.SX.sym("tau", l)
        given = {"Q": ca.DM.eye(n), "P": -0.3 * u, "G": ca.DM.ones(n, l) + ca.DM.eye(max(n, l))[:n, :l]}
        return sg.Mechanism(q=q, u=u, tau=tau, **(given | more))

    def scene(name: str, m: sg.Mechanism, *constraints: Any, **more: Any) -> sg.Scene:
        return sg.Scene(name, m, list(constraints), **more)

    scenes = []
    plain = mech(2, 2)
    speed = sg.Nonholonomic("speed", plain.u[0] + plain.q[1], -1.0)
    scenes.append(scene("plain", plain, speed))
    scenes.append(scene("y_given", plain, speed, y="input"))
    scenes.append(scene("y_formula", plain, speed, y=-plain.u * ca.sin(plain.q)))
    scenes.append(scene("y_constant", plain, speed, y=[0.5, -0.25]))
    still = sg.Nonholonomic("still", plain.u[0], -1.0)
    scenes.append(scene("constant_S", plain, still))
    one = mech(1, 1)
    scenes.append(scene("one", one, sg.Nonholonomic("speed", one.u * (2 + ca.sin(one.q)), -1.0), y="input"))
    law = sg.ControlsInvolved("law", one.tau + one.u * one.q, -1.0)
    scenes.append(scene("one_control", one, law))
    cubic = sg.ControlsInvolved("law", one.tau + 0.2 * one.tau**3 - one.u, -1.0)
    scenes.append(scene("one_cubic", one, cubic, y="input"))
    square = mech(3, 3, Q=ca.diag([1.0, 2.0, 3.0]))
    scenes.append(scene("square", square, sg.Nonholonomic("all", square.u * ca.cos(square.q), -1.0)))
    tall = mech(2, 1)
    par = sg.Parameters(k=[2.0, -1.0, 0.5], spare=1.0, c0=3.0)
    ref = sg.References(c0_r=1.0, c1=sg.Ref([0.0, 1.0], order=1))
    timed = mech(2, 2, t=ca.SX.sym("t"))
    follow = timed.u * par.k[0] ** 2 * ca.exp(par.k[1] * par.c0) - ref.c1 * ca.sin(timed.t) - ref.c0_r
    scenes.append(scene("columns", timed, sg.Nonholonomic("follow", follow, -1.0), parameters=par, references=ref))
    scenes.append(
        scene("unused", plain, speed, parameters=sg.Parameters(a=1.0, b=[1.0, 2.0]), references=sg.References(r=0.0))
    )
    model_only = sg.Parameters(a=2.0)
    fixed = mech(2, 2, Q=ca.diag(ca.vertcat(model_only.a, 1 + model_only.a**2)), P=[0.0, 0.0])
    scenes.append(scene("constant_of_parameters", fixed, sg.Nonholonomic("x", fixed.u[0], -1.0), parameters=model_only))
    clash_par, clash_ref = sg.Parameters(c1=2.0, c3=3.0), sg.References(c0=1.0, c2=0.5)
    clash = (
        plain.u[0] * ca.sin(clash_par.c1) * plain.q[0]
        - clash_ref.c0 * ca.cos(clash_par.c1 * clash_par.c3)
        - clash_ref.c2
    )
    scenes.append(
        scene("names_c", plain, sg.Nonholonomic("x", clash, -1.0), parameters=clash_par, references=clash_ref)
    )
    full = random_scene(3, "mixed", y="input")
    scenes.append(scene("everything", full.mechanism, *full.constraints, parameters=full.parameters,
                        references=full.references, y="input"))  # fmt: skip
    lu = random_scene(3, "controls", mass="exchange")
    scenes.append(scene("everything_tau", lu.mechanism, *lu.constraints, parameters=lu.parameters,
                        references=lu.references, y=-lu.mechanism.tau))  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scenes.append(scene("tall", tall, sg.Nonholonomic("both", tall.u, -1.0)))
    steps = ca.if_else(plain.q[0] > 0.5, ca.sqrt(ca.fabs(plain.q[0])), ca.floor(plain.q[1]) + ca.sign(plain.u[0]))
    odd = (
        steps
        + ca.fmod(plain.q[0], 2.5)
        + ca.atan2(plain.q[0], 3)
        + ca.fmin(plain.q[1], -plain.q[0]) * (plain.q[0] <= 1)
    )
    odd += ca.logic_and(plain.q[0] > 0, ca.logic_not(plain.q[1] > 0)) + ca.logic_or(plain.q[0] != 1, plain.q[1] == 2)
    odd += (2 + ca.sin(plain.q[0])) ** 1.5 + ca.hypot(plain.q[0], 1) + ca.copysign(1.5, plain.q[1])
    scenes.append(scene("every_operation", plain, sg.Nonholonomic("odd", plain.u[0] + odd, -1.0)))
    return {s.name: s for s in scenes}
