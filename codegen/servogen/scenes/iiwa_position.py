"""KUKA LBR iiwa with seven joints whose end effector follows a moving point in space.

psi'' + 20 psi' + 100 psi = 0 with psi the distance vector from the reference (Bajodah et al. 2004, Eqs. 11-12). The
model is robots/kuka_iiwa.urdf; its last link's frame is the end effector. Three constraints leave four of
seven joints free: the posture carries the arm's weight and draws it to a middle of its range, and the inverse mass
matrix as weight sees to it that no light joint is torn along (docs/singularity.md has the figures).
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca

import servogen as sg

END_EFFECTOR = "lbr_iiwa_link_7"
ROBOT_FILE = Path(__file__).parent / "robots" / "kuka_iiwa.urdf"
Q_RANGE = ((-2.9, -2.0, -2.9, -2.0, -2.9, -2.0, -3.0), (2.9, 2.0, 2.9, 2.0, 2.9, 2.0, 3.0))
"""The joints' limits, rad, as the URDF has them, rounded inwards."""

JOINT_SPEED, EFFORT = 10.0, 300.0
"""The joints' limits in rad/s and N m, as the URDF has them: nothing enforces them yet, a simulation stops there."""

CENTRE = [0.0, 0.6, 0.0, -1.3, 0.0, 1.2, 0.0]
DAMPING, STIFFNESS = 6.0, 9.0
"""What the constraints leave free is drawn to the centre (rad) with the double rate -3 per second: 1/s, 1/s^2."""


def scene_of(robot: Any, name: str = "iiwa_position", order: int = 2) -> sg.Scene:
    """The constraint alone, without weight and posture: what other libraries can be asked for, too.

    robot: this one as any library models it, with `mechanism` and `position(frame)`. order: of the rates of r.
    """
    ref = sg.References(r=sg.Ref([0.5, 0.0, 0.6], order=order, unit="m", text="where the end effector ought to be"))
    domain = {"q": Q_RANGE, "u": (-2.0, 2.0), "r": ((-0.8, -0.8, 0.2), (0.8, 0.8, 1.0))}
    rates = {"r_dot": (-1.0, 1.0), "r_ddot": (-5.0, 5.0)}
    return sg.Scene(
        name,
        robot.mechanism,
        [sg.Holonomic("position", robot.position(END_EFFECTOR) - ref.r, Theta1=-20.0, Theta2=-100.0)],
        references=ref,
        domain=domain | dict(list(rates.items())[:order]),
    )


def minimum_jerk(t: Any, start: list[float], end: list[float], duration: float) -> Any:
    """SX of t: from rest to rest on a straight line (Flash and Hogan, 1985), and at the end from then on."""
    s = ca.fmin(t / duration, 1)
    return ca.DM(start) + (ca.DM(end) - ca.DM(start)) * (s**3 * (10 + s * (6 * s - 15)))


def margins(robot: sg.urdf.Robot) -> dict[str, Any]:
    """What ends a run of the arm: a joint at a limit of the URDF."""
    lower, upper = (ca.DM(limit) for limit in Q_RANGE)
    return {
        "limit of a joint's angle": ca.mmin(ca.vertcat(robot.q - lower, upper - robot.q)),
        "limit of a joint's speed": JOINT_SPEED - ca.norm_inf(robot.u),
    }


# The file's joint damping is left out: it steadies simulators; the arm's torque sensors lie behind the drives' losses.
robot = sg.urdf.load(ROBOT_FILE, quiet=True, damping=None)
scene = replace(scene_of(robot), weight="inverse_mass", y=robot.posture(DAMPING, STIFFNESS, CENTRE))

# From rest and 35 mm off the reference, which moves 0.3 m in three seconds and then stands; so does the arm.
simulation = sg.Simulation(
    start={"q": CENTRE, "u": [0.0] * 7},
    references={"r": lambda t: minimum_jerk(t, [0.6, 0.02, 0.52], [0.5, 0.3, 0.5], 3.0)},
    duration=8.0,
    step=1e-3,
    outputs={"fastest joint": ca.norm_inf(robot.u)},
    stop=margins(robot),
    tau_max=EFFORT,
    units={"q": "rad", "u": "rad/s", "tau": "N m", "psi": "m", "fastest joint": "rad/s"},
)
