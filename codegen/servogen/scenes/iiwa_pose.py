"""KUKA LBR iiwa whose end effector holds a position and an orientation: six constraints for seven joints.

The orientation's psi is sin(angle) times the axis of the turn from the reference to the end effector; it vanishes half
a turn away as well, where the constraint loses rank. The reference is a unit quaternion and stands still.
"""

import numpy as np

import servogen as sg
from servogen.scenes.iiwa_position import END_EFFECTOR, Q_RANGE, ROBOT_FILE

robot = sg.urdf.load(ROBOT_FILE, quiet=True)
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
    domain=_state,
)

# From rest, a quarter of a metre and a seventh of a turn from the reference; more than a quarter of a turn would lead
# to the other zero of the orientation's psi, half a turn away. Not in a plane: there the constraints lose a rank.
simulation = sg.Simulation(
    start={
        "q": [0.3, 0.6, 0.5, -1.2, 0.4, 0.9, 0.2],
        "u": [0.0] * 7,
        "r": [0.45, 0.1, 0.6],
        "o": [0.0, 0.0, 0.5**0.5, 0.5**0.5],
    },
    duration=1.5,
    step=1e-3,
    sigma_min=0.01,
    units={"q": "rad", "u": "rad/s", "tau": "N m"},
)
