"""A craft held by eight skewed thrusters: three velocities, three rates, S constant up to the parameters, l > n.

Each thruster pushes along a fixed direction from a fixed place, so G is numbers; with the craft's velocities and rates
in its own axes, S = Q^-1 G depends on the mass and the inertia alone. Its pseudo-inverse is made by prepare: at each
tick tau is two products of matrices, and the free vector pulls the thrusters towards their middle.
"""

import casadi as ca
import numpy as np

import servogen as sg

par = sg.Parameters(
    mass=sg.Parameter(80.0, "kg", "mass of the craft"),
    inertia=sg.Parameter([6.0, 7.0, 5.0], "kg m^2", "principal moments of inertia"),
)
ref = sg.References(
    velocity=sg.Ref([0.0, 0.0, 0.0], order=1, unit="m/s", text="velocity to hold, in the craft's axes"),
    rate=sg.Ref([0.0, 0.0, 0.0], order=1, unit="rad/s", text="rate of turn to hold"),
)

places = 0.5 * np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
directions = np.array([[0.6 * b * c, 0.8 * a, 0.0] if c > 0 else [0.0, 0.6 * b, 0.8 * c * a] for a, b, c in 2 * places])
directions[::3] = directions[::3, [2, 0, 1]]  # skewed: no two rows of G alike
wrenches = np.hstack([directions, np.cross(places, directions)])  # a row per thruster

position, u, tau = ca.SX.sym("position", 6), ca.SX.sym("u", 6), ca.SX.sym("tau", 8)
v, omega = u[:3], u[3:]
inertia = ca.diag(par.inertia)

scene = sg.Scene(
    "skewed_thrusters",
    sg.Mechanism(
        q=position, u=u, tau=tau,
        Q=ca.diagcat(par.mass * ca.DM.eye(3), inertia),
        P=ca.vertcat(-par.mass * ca.cross(omega, v), -ca.cross(omega, inertia @ omega)),
        G=np.round(wrenches.T, 12),
    ),
    [
        sg.Nonholonomic("velocity", v - ref.velocity, Theta=-0.8),
        sg.Nonholonomic("rate", omega - ref.rate, Theta=-1.2),
    ],
    parameters=par,
    references=ref,
    y=ca.SX(ca.DM([0.5] * 8)),
    domain={"q": (-1.0, 1.0), "u": (-0.5, 0.5), "velocity": (-1.0, 1.0), "rate": (-0.5, 0.5)},
)  # fmt: skip

simulation = sg.Simulation(
    start={"q": [0.0] * 6, "u": [0.3, -0.2, 0.1, 0.2, -0.1, 0.15], "velocity": [0.5, 0.0, 0.0]},
    duration=8.0,
    step=1e-2,
    domain={"q": (-5.0, 5.0)},  # its velocity is held, so it flies on
    outputs={"speed": ca.norm_2(v)},
    units={"u": ["m/s"] * 3 + ["rad/s"] * 3, "tau": "N", "speed": "m/s"},
)
