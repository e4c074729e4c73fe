"""Four-bar linkage, a loop of three moving bars with one motor, whose crank keeps a given speed.

q: angles of crank, coupler and rocker against the ground, which joins the two fixed pivots. The loop is a passive
constraint: the crank's and coupler's ends meet the rocker's. A Grashof linkage, so that the crank turns all round.
"""

from typing import Any

import casadi as ca
import numpy as np

import servogen as sg

par = sg.Parameters(
    m_1=sg.Parameter(0.3, "kg", "mass of the crank"),
    m_2=sg.Parameter(0.6, "kg", "mass of the coupler"),
    m_3=sg.Parameter(0.5, "kg", "mass of the rocker"),
    L_0=sg.Parameter(0.5, "m", "between the fixed pivots"),
    L_1=sg.Parameter(0.2, "m", "length of the crank"),
    L_2=sg.Parameter(0.5, "m", "length of the coupler"),
    L_3=sg.Parameter(0.4, "m", "length of the rocker"),
    g=sg.Parameter(9.81, "m/s^2", "gravity"),
)
ref = sg.References(speed=sg.Ref(3.0, order=1, unit="rad/s", text="of the crank"))
q, u, tau = ca.SX.sym("angle", 3), ca.SX.sym("speed", 3), ca.SX.sym("torque")


def along(angle: Any) -> Any:
    """The unit vector at an angle."""
    return ca.vertcat(ca.cos(angle), ca.sin(angle))


masses, lengths = (par.m_1, par.m_2, par.m_3), (par.L_1, par.L_2, par.L_3)
joint = par.L_1 * along(q[0])  # of crank and coupler
pivot = ca.vertcat(par.L_0, 0)
tip = pivot + par.L_3 * along(q[2])  # of coupler and rocker
centres = (joint / 2, joint + par.L_2 / 2 * along(q[1]), pivot + par.L_3 / 2 * along(q[2]))

# Slender bars: a moment of inertia of m L^2 / 12 about the centre.
T = sum(
    m * ca.sumsqr(ca.jtimes(c, q, u)) / 2 + m * L**2 / 24 * u[k] ** 2
    for k, (m, L, c) in enumerate(zip(masses, lengths, centres, strict=True))
)
V = sum(m * par.g * c[1] for m, c in zip(masses, centres, strict=True))
Q = ca.hessian(T, u)[0]
P = ca.gradient(T, q) - ca.jtimes(ca.gradient(T, u), q, u) - ca.gradient(V, q)

loop = joint + par.L_2 * along(q[1]) - tip
mechanism = sg.Mechanism(
    q=q, u=u, tau=tau, Q=Q, P=P, G=[[1], [0], [0]],
    passive=[sg.PassiveHolonomic("loop", loop, stabilise=20.0)],
)  # fmt: skip
scene = sg.Scene(
    "four_bar",
    mechanism,
    [sg.Nonholonomic("speed", u[0] - ref.speed, Theta=-5.0)],
    parameters=par,
    references=ref,
    domain={"q": ((-np.pi, 0.0, 0.5), (np.pi, 1.6, 2.8)), "u": (-4.0, 4.0), "speed": (-4.0, 4.0)},
)

simulation = sg.Simulation(
    start={"q": [0.5, 0.8, 1.7], "u": [0.0, 0.0, 0.0]},
    duration=6.0,
    step=1e-3,
    domain={"q": (-np.inf, np.inf)},
    drawing=[ca.horzcat(ca.SX([0, 0]), joint, tip, pivot)],
    units={"q": "rad", "u": "rad/s", "tau": "N m", "psi": "rad/s"},
)
