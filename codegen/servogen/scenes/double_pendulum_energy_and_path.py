"""Energy and the path R cos theta_1 + L sin theta_2 = 0 at once: Bajodah et al. (2004), Section 5, Eqs. (30)-(35).

In the limit the two exclude one another (at E = 0 the mechanism hangs at rest, where the path asks R = 0), and S loses
rank on the way as the mechanism slows down: the run ends at a margin, and says which.
"""

import casadi as ca

import servogen as sg
from servogen.scenes.double_pendulum_energy import E, G, K, P, Q, drawing, par, q, ref, tau, u

scene = sg.Scene(
    "double_pendulum_energy_and_path",
    sg.Mechanism(q=q, u=u, tau=tau, Q=Q, P=P, G=G),
    [
        sg.Nonholonomic("energy", E - ref.E_0, Theta=-1.0),
        sg.Holonomic("path", par.R * ca.cos(q[0]) + par.L * ca.sin(q[1]), Theta1=-2.0, Theta2=-1.0),
    ],
    parameters=par,
    references=ref,
    domain={"q": (-3.2, 3.2), "u": (-4.0, 4.0), "E_0": (0.0, 10.0)},
)

simulation = sg.Simulation(
    start={"q": [1.6, -1.8], "u": [-1.6, 0.8]},
    duration=5.0,
    step=2.5e-5,
    outputs={"E": E, "K/E": K / E},
    decay={"E": (-1.0, ref.E_0)},
    stop={"K/E < 1e-3": K - 1e-3 * E},
    sigma_min=0.2,
    tau_max=100.0,
    units={"q": "rad", "u": "rad/s", "tau": "N m", "E": "J", "drawing": "m"},
    drawing=drawing,
)
