"""KUKA LBR iiwa with seven joints whose end effector follows a moving point in space.

psi'' + 20 psi' + 100 psi = 0 with psi the distance vector from the reference (Bajodah et al. 2004, Eqs. 11-12). The
model is robots/kuka_iiwa.urdf; its last link's frame is the end effector.
"""

from pathlib import Path
from typing import Any

import servogen as sg

END_EFFECTOR = "lbr_iiwa_link_7"
ROBOT_FILE = Path(__file__).parent / "robots" / "kuka_iiwa.urdf"
Q_RANGE = ((-2.9, -2.0, -2.9, -2.0, -2.9, -2.0, -3.0), (2.9, 2.0, 2.9, 2.0, 2.9, 2.0, 3.0))
"""The joints' limits, rad, as the URDF has them, rounded inwards."""


def scene_of(robot: Any, name: str = "iiwa_position", order: int = 2) -> sg.Scene:
    """robot: this one as any library models it, with `mechanism` and `position(frame)`. order: of the rates of r."""
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


scene = scene_of(sg.urdf.load(ROBOT_FILE, quiet=True))

# From rest, half a metre from the reference. The null space is left to itself (y = 0): the arm drifts there.
simulation = sg.Simulation(
    start={"q": [0.0, 0.6, 0.0, -1.2, 0.0, 0.9, 0.0], "u": [0.0] * 7, "r": [0.4, 0.3, 0.7]},
    duration=1.5,
    step=1e-3,
    units={"q": "rad", "u": "rad/s", "tau": "N m", "psi": "m"},
)
