"""Five-bar linkage: two motors on the ground carry the end effector along a circle, with no motor on the moving arms.

q: angles of the left crank, the left arm, the right crank and the right arm against the ground. Each crank is driven;
the arms meet at the end effector, a passive constraint. Parallel arms have their motors where nothing moves.
"""

from typing import Any

import casadi as ca
import numpy as np
import servogen as sg

par = sg.Parameters(
    m_crank=sg.Parameter(0.4, "kg", "mass of each crank"),
    m_arm=sg.Parameter(0.3, "kg", "mass of each arm"),
    m_tool=sg.Parameter(0.2, "kg", "at the end effector"),
    base=sg.Parameter(0.2, "m", "between the motors"),
    crank=sg.Parameter(0.25, "m", "length of each crank"),
    arm=sg.Parameter(0.35, "m", "length of each arm"),
    g=sg.Parameter(9.81, "m/s^2", "gravity"),
)
ref = sg.References(place=sg.Ref([0.1, 0.45], order=2, unit="m", text="of the end effector"))
q, u = ca.SX.sym("angle", 4), ca.SX.sym("rate", 4)
motors = ca.SX.sym("torque", 2)


def along(angle: Any) -> Any:
    """The unit vector at an angle."""
    return ca.vertcat(ca.cos(angle), ca.sin(angle))


feet = ca.vertcat(0, 0), ca.vertcat(par.base, 0)
elbows = [foot + par.crank * along(q[2 * side]) for side, foot in enumerate(feet)]
tips = [elbow + par.arm * along(q[2 * side + 1]) for side, elbow in enumerate(elbows)]

# Slender bars: a moment of inertia of m L^2 / 12 about the centre; the tool is on the left arm.
bodies = [(par.m_tool, tips[0], 0, 0.0)]
for side, foot in enumerate(feet):
    bodies.append((par.m_crank, (foot + elbows[side]) / 2, par.crank, u[2 * side]))
    bodies.append((par.m_arm, (elbows[side] + tips[side]) / 2, par.arm, u[2 * side + 1]))
T = sum(m * ca.sumsqr(ca.jtimes(c, q, u)) / 2 + m * L**2 / 24 * rate**2 for m, c, L, rate in bodies)
V = sum(m * par.g * c[1] for m, c, _, _ in bodies)
Q = ca.hessian(T, u)[0]
P = ca.gradient(T, q) - ca.jtimes(ca.gradient(T, u), q, u) - ca.gradient(V, q)

mechanism = sg.Mechanism(
    q=q, u=u, tau=motors, Q=Q, P=P, G=[[1, 0], [0, 0], [0, 1], [0, 0]],
    passive=[sg.PassiveHolonomic("arms_meet", tips[0] - tips[1], stabilise=20.0)],
)  # fmt: skip


def states(generator: np.random.Generator) -> dict[str, Any]:
    """The end effector near the middle of its room, elbows outwards."""
    return {
        "q": np.array([2.3, 0.95, 0.85, 2.2]) + generator.uniform(-0.25, 0.25, 4),
        "u": generator.uniform(-2, 2, 4),
        "place": np.array([0.1, 0.45]) + generator.uniform(-0.05, 0.05, 2),
        "place_dot": generator.uniform(-0.5, 0.5, 2),
        "place_ddot": generator.uniform(-2, 2, 2),
    }


scene = sg.Scene(
    "five_bar",
    mechanism,
    [sg.Holonomic("path", tips[0] - ref.place, Theta1=-20.0, Theta2=-100.0)],
    parameters=par,
    references=ref,
    domain=states,
)
simulation = sg.Simulation(
    start={"q": [2.3, 0.95, 0.85, 2.2], "u": [0.0] * 4},
    duration=3.0,
    step=1e-3,
    references={"place": lambda t: ca.vertcat(0.1 + 0.06 * ca.sin(4 * t), 0.45 + 0.06 * ca.cos(4 * t))},
    domain={"q": (-np.inf, np.inf), "u": (-20.0, 20.0)},
    drawing=[ca.horzcat(feet[0], elbows[0], tips[0], elbows[1], feet[1]), ca.SX(ref.place)],
    units={"q": "rad", "u": "rad/s", "tau": "N m", "psi": "m"},
)
