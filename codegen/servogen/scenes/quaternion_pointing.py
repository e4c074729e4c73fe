"""A rigid body that points an instrument: four coordinates (a unit quaternion), three velocity parameters.

q' = C(q) u / 2 keeps the quaternion's norm. The instrument's axis, fixed in the body, turns to a direction in
space, and the body does not spin about it: two holonomic rows and one nonholonomic one for three torques.
"""

import casadi as ca
import numpy as np

import servogen as sg

par = sg.Parameters(
    I_1=sg.Parameter(10.0, "kg m^2", "moment of inertia about the first principal axis"),
    I_2=sg.Parameter(6.3, "kg m^2", "moment of inertia about the second principal axis"),
    I_3=sg.Parameter(8.5, "kg m^2", "moment of inertia about the third principal axis, the instrument's"),
)

q, omega, tau = ca.SX.sym("q", 4), ca.SX.sym("omega", 3), ca.SX.sym("tau", 3)
w, x, y, z = ca.vertsplit(q)
C = ca.vertcat(
    ca.horzcat(-x, -y, -z),
    ca.horzcat(w, -z, y),
    ca.horzcat(z, w, -x),
    ca.horzcat(-y, x, w),
) / 2  # fmt: skip
inertia = ca.diag(ca.vertcat(par.I_1, par.I_2, par.I_3))
axis = ca.vertcat(2 * (x * z + w * y), 2 * (y * z - w * x), w**2 - x**2 - y**2 + z**2)  # the third axis, in space


def draw(random: np.random.Generator) -> dict[str, np.ndarray]:
    """One state of the domain: a unit quaternion whose axis is within 75 degrees of the target, and a rate."""
    turn, heading, roll = random.uniform(0.0, 1.3), random.uniform(-np.pi, np.pi), random.uniform(-np.pi, np.pi)
    a, b = np.cos(turn / 2), np.sin(turn / 2) * np.cos(heading)
    d = np.sin(turn / 2) * np.sin(heading)
    c, s = np.cos(roll / 2), np.sin(roll / 2)  # a tilt of the axis, then a roll about it
    return {"q": np.array([a * c, b * c + d * s, d * c - b * s, a * s]), "u": random.uniform(-0.5, 0.5, 3)}


scene = sg.Scene(
    "quaternion_pointing",
    sg.Mechanism(q=q, u=omega, tau=tau, C=C, Q=inertia, P=-ca.cross(omega, inertia @ omega), G=ca.DM.eye(3)),
    [
        sg.Holonomic("pointing", axis[:2], Theta1=-1.4, Theta2=-0.49),
        sg.Nonholonomic("spin", omega[2], Theta=-0.7),
    ],
    parameters=par,
    domain=draw,
)

first = ca.vertcat(w**2 + x**2 - y**2 - z**2, 2 * (x * y + w * z), 2 * (x * z - w * y))  # the first axis, in space

simulation = sg.Simulation(
    start={"q": [0.8, 0.4, -0.4, 0.2], "u": [0.05, -0.1, 0.2]},
    duration=15.0,
    step=5e-3,
    outputs={"|q| - 1": ca.norm_2(q) - 1, "angle to the target": ca.atan2(ca.norm_2(axis[:2]), axis[2])},
    units={"u": "rad/s", "tau": "N m", "angle to the target": "rad"},
    drawing=[[[0, 0, 0], axis], [-0.3 * first, 0.3 * first], [[0, 0, 1]]],  # the instrument, a panel, the target
)
