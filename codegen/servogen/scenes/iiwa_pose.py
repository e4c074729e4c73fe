"""KUKA LBR iiwa whose end effector holds a position and an orientation: six constraints for seven joints.

The orientation's psi is sin(angle) times the axis of the turn from the reference to the end effector; it vanishes half
a turn away as well, where the constraint loses rank. The reference is a unit quaternion and stands still. The one joint
that is left free follows the posture, as in iiwa_position.
"""

import casadi as ca
import numpy as np

import servogen as sg
from servogen.scenes.iiwa_position import (
    DAMPING,
    EFFORT,
    END_EFFECTOR,
    Q_RANGE,
    STIFFNESS,
    margins,
    minimum_jerk,
    robot,
)

CENTRE = [-0.1, 0.3, 0.2, -1.8, 1.5, 1.5, -0.5]

ref = sg.References(
    r=sg.Ref([0.5, 0.0, 0.6], order=2, unit="m", text="where the end effector ought to be"),
    o=sg.Ref([1.0, 0.0, 0.0, 0.0], text="how it ought to be turned: unit quaternion w, x, y, z, end effector to world"),
)


def _state(generator: np.random.Generator) -> dict[str, object]:
    o = generator.normal(size=4)
    return {
        "q": generator.uniform(*Q_RANGE),
        "u": generator.uniform(-2.0, 2.0, 7),
        "r": generator.uniform((-0.8, -0.8, 0.2), (0.8, 0.8, 1.0)),
        "r_dot": generator.uniform(-1.0, 1.0, 3),
        "r_ddot": generator.uniform(-5.0, 5.0, 3),
        "o": o / np.linalg.norm(o),
    }


scene = sg.Scene(
    "iiwa_pose",
    robot.mechanism,
    [
        sg.Holonomic("position", robot.position(END_EFFECTOR) - ref.r, Theta1=-20.0, Theta2=-100.0),
        sg.Holonomic(
            "orientation",
            robot.orientation_error(END_EFFECTOR, sg.urdf.quaternion_rotation(ref.o)),
            Theta1=-20.0,
            Theta2=-100.0,
        ),
    ],
    references=ref,
    weight="inverse_mass",
    y=robot.posture(DAMPING, STIFFNESS, CENTRE),
    domain=_state,
)

# From rest, 4 cm and 8 degrees off the reference, which moves 0.2 m in three seconds; more than a quarter of a turn
# off it would lead to the other zero of the orientation's psi, half a turn away.
simulation = sg.Simulation(
    start={"q": [-0.1, 0.25, 0.2, -1.85, 1.5, 1.5, -0.4], "u": [0.0] * 7, "o": [0.0, 0.0, 0.5**0.5, 0.5**0.5]},
    references={"r": lambda t: minimum_jerk(t, [0.45, 0.1, 0.6], [0.5, -0.05, 0.5], 3.0)},
    duration=8.0,
    step=1e-3,
    outputs={"fastest joint": ca.norm_inf(robot.u)},
    stop=margins(robot),
    sigma_min=0.01,
    tau_max=EFFORT,
    units={"q": "rad", "u": "rad/s", "tau": "N m", "fastest joint": "rad/s"},
)
