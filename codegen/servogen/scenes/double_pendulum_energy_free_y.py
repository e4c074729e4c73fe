"""The energy scene with a free vector y that keeps the mechanism moving, so that E follows E(0) exp(-t) for good.

With y = 0 the mechanism comes to rest with potential energy left, where no torque has power. Here y is the torque that
would steer the angles along the spiral omega = A theta, A = [[-1/2, w], [-w, -1/2]]: on it |theta| falls as exp(-t/2),
potential and kinetic energy both as exp(-t), and the two angles are a quarter of a turn apart, so that one moves while
the other turns round. The servo-constraint changes this y as little as it takes for E' = -(E - E_0).
"""

import casadi as ca

import servogen as sg
from servogen.scenes.double_pendulum_energy import E, G, K, P, Q, par, q, ref, tau, u

w, k = 4.0, 4.0  # rad/s of the spiral; 1/s at which omega approaches it
A = ca.DM([[-0.5, w], [-w, -0.5]])
spiral = A @ q
u_dot = A @ u - k * (u - spiral)

scene = sg.Scene(
    "double_pendulum_energy_free_y",
    sg.Mechanism(q=q, u=u, tau=tau, Q=Q, P=P, G=G),
    [sg.Nonholonomic("energy", E - ref.E_0, Theta=-1.0)],
    parameters=par,
    references=ref,
    y=ca.solve(G, Q @ u_dot - P),
    domain={"q": (-3.2, 3.2), "u": (-4.0, 4.0), "E_0": (0.0, 10.0)},
)

simulation = sg.Simulation(
    start={"q": [0.6, 0.0], "u": [-0.3, -2.4]},  # on the spiral
    duration=10.0,
    step=1e-3,
    outputs={"E": E, "K/E": K / E},
    decay={"E": (-1.0, ref.E_0)},
    stop={"K/E < 1e-3": K - 1e-3 * E},
    units={"q": "rad", "u": "rad/s", "tau": "N m", "psi": "J", "E": "J"},
)
