"""A wheeled robot that follows a circle: three coordinates, two velocity parameters, C rectangular (3 x 2).

q = (x, y, heading), u = (speed, turn rate), controls are the torques of the two wheels. A point ahead of the axle runs
towards the circle (holonomic, second order), and the speed towards its set-point.
"""

import math

import casadi as ca
import numpy as np

import servogen as sg

par = sg.Parameters(
    mass=sg.Parameter(12.0, "kg", "mass of the robot"),
    inertia=sg.Parameter(0.9, "kg m^2", "inertia about the vertical through the axle's middle"),
    wheel=sg.Parameter(0.1, "m", "radius of the wheels"),
    track=sg.Parameter(0.25, "m", "half the distance between the wheels"),
    ahead=sg.Parameter(0.2, "m", "distance of the guided point from the axle"),
)
ref = sg.References(
    speed=sg.Ref(0.8, order=1, unit="m/s", text="speed to hold"),
    radius=sg.Ref(2.0, order=2, unit="m", text="radius of the circle"),
)

q, u, tau = ca.SX.sym("q", 3), ca.SX.sym("u", 2), ca.SX.sym("tau", 2)
c, s = ca.cos(q[2]), ca.sin(q[2])
C = ca.vertcat(ca.horzcat(c, 0), ca.horzcat(s, 0), ca.horzcat(0, 1))
point = ca.vertcat(q[0] + par.ahead * c, q[1] + par.ahead * s)
distance = ca.norm_2(point) - ref.radius

scene = sg.Scene(
    "unicycle_path",
    sg.Mechanism(
        q=q, u=u, tau=tau, C=C,
        Q=ca.diag(ca.vertcat(par.mass, par.inertia)),
        P=ca.vertcat(-0.5 * u[0], -0.1 * u[1]),
        G=ca.vertcat(ca.horzcat(1, 1), ca.horzcat(par.track, -par.track)) / par.wheel,
    ),
    [
        sg.Holonomic("circle", distance, Theta1=-3.0, Theta2=-2.0),
        sg.Nonholonomic("speed", u[0] - ref.speed, Theta=-1.5),
    ],
    parameters=par,
    references=ref,
    domain={"q": ([1.0, -1.0, 1.0], [3.0, 1.0, 2.0]), "u": ([0.2, -1.0], [1.5, 1.0])},
)  # fmt: skip

left = par.track * ca.vertcat(-s, c)
turn = ca.linspace(0.0, 2 * math.pi, 61).T
circle = ref.radius * ca.vertcat(ca.cos(turn), ca.sin(turn))

simulation = sg.Simulation(
    start={"q": [2.6, 0.0, 1.2], "u": [0.3, 0.0]},
    duration=10.0,
    step=2e-3,
    domain={"q": ([-3.0, -3.0, -np.inf], [3.0, 3.0, np.inf]), "u": ([0.0, -2.0], [1.5, 2.0])},  # all round the circle
    outputs={"x": q[0], "y": q[1], "distance to the circle": distance},
    units={"u": "m/s, rad/s", "tau": "N m", "x": "m", "y": "m", "distance to the circle": "m", "drawing": "m"},
    drawing=[circle, [point, q[:2] + left, q[:2] - left, point]],
)
