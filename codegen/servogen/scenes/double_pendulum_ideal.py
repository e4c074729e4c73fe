"""The energy scene with ideal control forces G tau = R: Bajodah et al. (2004), Eqs. (13)-(17), (26)-(29).

R = Theta (E - E_0) Q u / (2 K) in closed form: it vanishes with E only while K does not vanish faster.
"""

import servogen as sg
from servogen.scenes.double_pendulum_energy import E, G, K, P, Q, drawing, par, q, ref, tau, u

scene = sg.Scene(
    "double_pendulum_ideal",
    sg.Mechanism(q=q, u=u, tau=tau, Q=Q, P=P, G=G),
    [sg.Nonholonomic("energy", E - ref.E_0, Theta=-1.0)],
    parameters=par,
    references=ref,
    mode="ideal",
    domain={"q": (-3.2, 3.2), "u": (-4.0, 4.0), "E_0": (0.0, 10.0)},
)

simulation = sg.Simulation(
    start={"q": [1.6, -1.8], "u": [-1.6, 0.8]},
    duration=5.0,
    step=2.5e-4,
    outputs={"E": E, "K/E": K / E},
    decay={"E": (-1.0, ref.E_0)},
    stop={"K/E < 1e-3": K - 1e-3 * E},
    domain={"u": (-8.0, 8.0)},  # as the energy goes, what is left of it is all motion for a while
    units={"q": "rad", "u": "rad/s", "tau": "N m", "psi": "J", "E": "J", "drawing": "m"},
    drawing=drawing,
)
