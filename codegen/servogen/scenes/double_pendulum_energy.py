"""Double pendulum whose energy E follows E' = -(E - E_0): Bajodah et al. (2004), Section 4, Eqs. (18)-(24).

The paper prints no numbers for the pendulum; these are of a laboratory's size.
"""

import casadi as ca

import servogen as sg

par = sg.Parameters(
    m_B=sg.Parameter(1.0, "kg", "mass of the bar"),
    R=sg.Parameter(0.5, "m", "radius of the disc, from its axis to the bar's hinge"),
    L=sg.Parameter(1.2, "m", "length of the bar"),
    I_D=sg.Parameter(0.2, "kg m^2", "inertia of the disc about its axis"),
    I_B=sg.Parameter(0.12, "kg m^2", "inertia of the bar about its centre of mass"),
    g=sg.Parameter(9.81, "m/s^2", "gravity"),
)
ref = sg.References(E_0=sg.Ref(0.0, unit="J", text="energy to hold; zero hanging at rest"))

q, u, tau = ca.SX.sym("theta", 2), ca.SX.sym("omega", 2), ca.SX.sym("tau", 2)
m, R, h, g = par.m_B, par.R, par.L / 2, par.g
s, c = ca.sin(q[0] - q[1]), ca.cos(q[0] - q[1])

Q = ca.vertcat(
    ca.horzcat(m * R**2 + par.I_D, m * h * R * c),
    ca.horzcat(m * h * R * c, m * h**2 + par.I_B),
)
P = ca.vertcat(
    -m * g * R * ca.sin(q[0]) - m * h * R * u[1] ** 2 * s,
    -m * g * h * ca.sin(q[1]) + m * h * R * u[0] ** 2 * s,
)
G = ca.DM([[1, -1], [0, 1]])

K = ca.bilin(Q, u, u) / 2
V = m * g * (R * (1 - ca.cos(q[0])) + h * (1 - ca.cos(q[1])))
E = K + V

hinge = R * ca.vertcat(ca.sin(q[0]), -ca.cos(q[0]))
drawing = [[[0, 0], hinge, hinge + par.L * ca.vertcat(ca.sin(q[1]), -ca.cos(q[1]))]]

scene = sg.Scene(
    "double_pendulum_energy",
    sg.Mechanism(q=q, u=u, tau=tau, Q=Q, P=P, G=G),
    [sg.Nonholonomic("energy", E - ref.E_0, Theta=-1.0)],
    parameters=par,
    references=ref,
    domain={"q": (-3.2, 3.2), "u": (-4.0, 4.0), "E_0": (0.0, 10.0)},
)

# The paper gives no start. From this one, chosen among random ones, E follows E(0) exp(-t) for long before the
# mechanism comes to rest with potential energy left, where no torque has power: the run ends there.
simulation = sg.Simulation(
    start={"q": [1.6, -1.8], "u": [-1.6, 0.8]},
    duration=5.0,
    step=2.5e-4,
    outputs={"E": E, "K/E": K / E},
    decay={"E": (-1.0, ref.E_0)},
    stop={"K/E < 1e-3": K - 1e-3 * E},
    units={"q": "rad", "u": "rad/s", "tau": "N m", "psi": "J", "E": "J", "drawing": "m"},
    drawing=drawing,
)
