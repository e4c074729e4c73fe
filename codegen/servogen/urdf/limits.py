"""What a URDF file says of its joints' ranges."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from servogen.results import FloatArray
from servogen.urdf.description import Joint
from servogen.urdf.tree import Body


@dataclass(frozen=True, eq=False)
class JointLimits:
    """position: n x 2, lowest and highest (rad, m). velocity: n (rad/s, m/s). effort: n (N m, N).

    In the order of the robot's joints; infinite where the file has none. A joint that others mimic keeps within theirs,
    too, in position and velocity; effort is the joint's own.
    """

    position: FloatArray
    velocity: FloatArray
    effort: FloatArray


def joint_limits(joints: dict[str, Joint], bodies: Sequence[Body], names: Sequence[str]) -> JointLimits:
    """Of the coordinates by name; bodies: those that move."""
    position = np.array([[-np.inf, np.inf]] * len(names)).reshape(-1, 2)
    velocity = np.full(len(names), np.inf)
    for body in bodies:
        at, factor = names.index(body.drive.joint), float(body.drive.factor)
        if factor == 0:
            continue
        joint, offset = joints[body.joint], float(body.drive.offset)
        ends = sorted(((joint.lower - offset) / factor, (joint.upper - offset) / factor))
        position[at] = max(position[at, 0], ends[0]), min(position[at, 1], ends[1])
        velocity[at] = min(velocity[at], joint.velocity / abs(factor))
    return JointLimits(position, velocity, np.array([joints[name].effort for name in names]))
