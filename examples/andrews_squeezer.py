"""Andrews' squeezing mechanism: seven bodies, three loops, one motor whose speed is to follow a reference.

Hairer and Wanner, "Solving Ordinary Differential Equations II" (1996), Section VII.7; the numbers are those of the
test set for initial value problem solvers. q: beta, theta, gamma, phi, delta, omega, epsilon, rad.
"""

from typing import Any

import casadi as ca
import numpy as np
import servogen as sg

START = [
    -0.0617138900142764496358948458001, 0.0, 0.455279819163070380255912382449, 0.222668390165885884674473185609,
    0.487364979543842550225598953530, -0.222668390165885884674473185609, 1.23054744454982119249735015568,
]  # fmt: skip

m1, m2, m3, m4, m5, m6, m7 = 0.04325, 0.00365, 0.02373, 0.00706, 0.07050, 0.00706, 0.05498
i1, i2, i3, i4, i5, i6, i7 = 2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5
xa, ya, xb, yb, xc, yc, c0 = -0.06934, -0.00227, -0.03635, 0.03273, 0.014, 0.072, 4530.0
d, da, e, ea, rr, ra, l0 = 0.028, 0.0115, 0.02, 0.01421, 0.007, 0.00092, 0.07785
ss, sa, sb, sc, sd, ta, tb = 0.035, 0.01874, 0.01043, 0.018, 0.02, 0.02308, 0.00916
u_, ua, ub, zf, zt, fa = 0.04, 0.01228, 0.00449, 0.02, 0.04, 0.01421

q, u, tau = ca.SX.sym("q", 7), ca.SX.sym("u", 7), ca.SX.sym("tau")
be, th, ga, ph, de, om, ep = (q[k] for k in range(7))
bep, thp, _, php, dep, omp, epp = (u[k] for k in range(7))
s, c = ca.sin, ca.cos
Q = ca.SX.zeros(7, 7)
Q[0, 0] = m1 * ra**2 + m2 * (rr**2 - 2 * da * rr * c(th) + da**2) + i1 + i2
Q[0, 1] = Q[1, 0] = m2 * (da**2 - da * rr * c(th)) + i2
Q[1, 1] = m2 * da**2 + i2
Q[2, 2] = m3 * (sa**2 + sb**2) + i3
Q[3, 3] = m4 * (e - ea) ** 2 + i4
Q[3, 4] = Q[4, 3] = m4 * ((e - ea) ** 2 + zt * (e - ea) * s(ph)) + i4
Q[4, 4] = m4 * (zt**2 + 2 * zt * (e - ea) * s(ph) + (e - ea) ** 2) + m5 * (ta**2 + tb**2) + i4 + i5
Q[5, 5] = m6 * (zf - fa) ** 2 + i6
Q[5, 6] = Q[6, 5] = m6 * ((zf - fa) ** 2 - u_ * (zf - fa) * s(om)) + i6
Q[6, 6] = m6 * ((zf - fa) ** 2 - 2 * u_ * (zf - fa) * s(om) + u_**2) + m7 * (ua**2 + ub**2) + i6 + i7
xd, yd = sd * c(ga) + sc * s(ga) + xb, sd * s(ga) - sc * c(ga) + yb
length = ca.sqrt((xd - xc) ** 2 + (yd - yc) ** 2)
force = -c0 * (length - l0) / length
P = ca.vertcat(
    -m2 * da * rr * thp * (thp + 2 * bep) * s(th),
    m2 * da * rr * bep**2 * s(th),
    force * (xd - xc) * (sc * c(ga) - sd * s(ga)) + force * (yd - yc) * (sd * c(ga) + sc * s(ga)),
    m4 * zt * (e - ea) * dep**2 * c(ph),
    -m4 * zt * (e - ea) * php * (php + 2 * dep) * c(ph),
    -m6 * u_ * (zf - fa) * epp**2 * c(om),
    m6 * u_ * (zf - fa) * omp * (omp + 2 * epp) * c(om),
)
left = rr * c(be) - d * c(be + th), rr * s(be) - d * s(be + th)
chi = ca.vertcat(
    left[0] - ss * s(ga) - xb,
    left[1] + ss * c(ga) - yb,
    left[0] - e * s(ph + de) - zt * c(de) - xa,
    left[1] + e * c(ph + de) - zt * s(de) - ya,
    left[0] - zf * c(om + ep) - u_ * s(ep) - xa,
    left[1] - zf * s(om + ep) + u_ * c(ep) - ya,
)
G = ca.vertcat(1, ca.SX(6, 1))
mechanism = sg.Mechanism(
    q=q, u=u, tau=tau, Q=Q, P=P, G=G, passive=[sg.PassiveHolonomic("loops", chi, stabilise=1000.0)]
)
ref = sg.References(speed=sg.Ref(50.0, order=1, unit="rad/s", text="of the motor"))


def states(generator: np.random.Generator) -> dict[str, Any]:
    """Near the start of the published motion."""
    return {"q": START + generator.uniform(-0.02, 0.02, 7), "u": generator.uniform(-5, 5, 7)}


scene = sg.Scene(
    "andrews_squeezer",
    mechanism,
    [sg.Nonholonomic("speed", u[0] - ref.speed, Theta=-1000.0)],
    references=ref,
    domain=states,
)

ground_a, ground_b, spring = (ca.SX([x, y]) for x, y in ((xa, ya), (xb, yb), (xc, yc)))
crank = ca.vertcat(rr * c(be), rr * s(be))
knot = crank - d * ca.vertcat(c(be + th), s(be + th))  # where the three loops meet
simulation = sg.Simulation(
    start={"q": START, "u": [0.0] * 7},
    duration=0.03,
    step=1e-5,
    domain={"q": (-np.inf, np.inf), "u": (-np.inf, np.inf)},
    drawing=[
        ca.horzcat(ca.SX([0, 0]), crank, knot, ground_b),
        ca.horzcat(knot, knot - e * ca.vertcat(s(ph + de), -c(ph + de)), ground_a),
        ca.horzcat(knot, knot - zf * ca.vertcat(c(om + ep), s(om + ep)), ground_a),
        ca.horzcat(ca.vertcat(xd, yd), spring),
    ],
    units={"q": "rad", "u": "rad/s", "tau": "N m", "psi": "rad/s"},
)
