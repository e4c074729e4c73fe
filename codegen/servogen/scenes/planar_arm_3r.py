"""A planar arm of three joints whose end follows a moving point: m = 2 rows for l = 3 torques, one joint to spare.

The point r(t) comes with its rates: psi = p(q) - r, psi'' = Theta1 psi' + Theta2 psi, so that the error decays as the
Thetas say however the point moves. What the spare joint does is the choice of y and of the weight: y = 0 here;
planar_arm_3r_damped has a y that damps the joints, planar_arm_3r_weighted the inverse mass matrix as its weight, which
is the operational-space solution tau = J^T Lambda (...).
"""

import math
from typing import Any

import casadi as ca

import servogen as sg
from servogen.scene.constraints import expression_of


def arm(name: str, damping: float = 0.0, inverse_mass_weight: bool = False) -> sg.Scene:
    """damping: of the joints, N m s, as y = -damping omega; inverse_mass_weight: W = Q^-1 instead of I."""
    par = sg.Parameters(
        m=sg.Parameter([3.0, 2.0, 1.0], "kg", "masses of the links"),
        a=sg.Parameter([0.5, 0.4, 0.3], "m", "lengths of the links"),
        g=sg.Parameter(9.81, "m/s^2", "gravity, along -y"),
    )
    ref = sg.References(r=sg.Ref([0.6, 0.4], order=2, unit="m", text="where the end shall be"))
    q, u, tau = ca.SX.sym("theta", 3), ca.SX.sym("omega", 3), ca.SX.sym("tau", 3)
    centres, joints = _points(q, par)
    spin = ca.cumsum(u)
    kinetic = sum(
        (par.m[k] * ca.sumsqr(ca.jacobian(centres[k], q) @ u) + par.m[k] * par.a[k] ** 2 / 12 * spin[k] ** 2) / 2
        for k in range(3)
    )
    potential = sum(par.m[k] * par.g * centres[k][1] for k in range(3))
    Q, _ = ca.hessian(kinetic, u)
    Q = ca.triu2symm(ca.triu(Q))
    momentum = Q @ u
    bias = ca.jtimes(momentum, q, u) - ca.gradient(kinetic, q) + ca.gradient(potential, q)  # Lagrange's equations
    return sg.Scene(
        name,
        sg.Mechanism(q=q, u=u, tau=tau, Q=Q, P=-bias, G=ca.DM.eye(3)),
        [sg.Holonomic("end", joints[-1] - ref.r, Theta1=-6.0, Theta2=-8.0)],
        parameters=par,
        references=ref,
        y=-damping * u if damping else None,
        weight="inverse_mass" if inverse_mass_weight else None,
        domain={"q": ([-0.5, 0.4, 0.4], [1.5, 2.2, 2.2]), "u": (-1.5, 1.5)},
    )


def _points(q: Any, par: Any) -> tuple[list[Any], list[Any]]:
    """The links' centres of mass; and the joints, the arm's end last."""
    angle, centres, joints = ca.cumsum(q), [], [ca.SX.zeros(2)]
    for k in range(3):
        along = ca.vertcat(ca.cos(angle[k]), ca.sin(angle[k]))
        centres.append(joints[-1] + par.a[k] / 2 * along)
        joints.append(joints[-1] + par.a[k] * along)
    return centres, joints


def circle(t: Any) -> Any:
    """Where the end shall be at t, m: once round in two seconds."""
    return ca.vertcat(0.5 + 0.15 * ca.cos(math.pi * t), 0.4 + 0.15 * ca.sin(math.pi * t))


def arm_run(scene: sg.Scene) -> sg.Simulation:
    """A circle of 0.15 m in two seconds, from a start 0.37 m off it."""
    assert scene.references is not None
    _, joints = _points(scene.mechanism.q, scene.parameters)
    error = expression_of(scene.constraints[0])
    return sg.Simulation(
        start={"q": [0.2, 1.0, 0.8], "u": [0.0, 0.0, 0.0]},
        references={"r": circle},
        duration=6.0,
        step=1e-3,
        outputs={
            "tracking error": ca.norm_2(error),
            "kinetic energy": ca.bilin(scene.mechanism.Q, scene.mechanism.u, scene.mechanism.u) / 2,
        },
        domain={"q": ([-1.2, 0.4, -1.2], [1.5, 2.8, 2.2]), "u": (-15.0, 15.0)},  # the spare joint goes its own way
        units={"q": "rad", "u": "rad/s", "tau": "N m", "psi": "m", "tracking error": "m", "kinetic energy": "J",
               "drawing": "m"},
        drawing=[joints, [scene.references.r]],
    )  # fmt: skip


scene = arm("planar_arm_3r")
simulation = arm_run(scene)
