"""From a description of links and joints, whatever file it was read from, to a robot."""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from servogen.errors import SceneError
from servogen.scene.convert import column
from servogen.urdf.description import Description
from servogen.urdf.frames import align, slide
from servogen.urdf.limits import joint_limits
from servogen.urdf.payload import Payload
from servogen.urdf.regular import check_bodies, check_mass_matrix
from servogen.urdf.robot import FRICTION_WIDTH, Joints, Robot
from servogen.urdf.tree import Body, build
from servogen.urdf.vectors import Vec

_said: set[str] = set()
"""Notes that were printed already: a command may load a file more than once."""


@dataclass(frozen=True, eq=False)
class Wanted:
    """What the caller asks for, as `sg.urdf.load` describes it."""

    floating: bool
    gravity: Vec
    joints: Sequence[str] | None
    quiet: bool
    damping: bool
    springs: bool
    friction: Literal["tanh"] | None
    armature: Mapping[str, Any] | None
    payload: Payload | Sequence[Payload] | None


def assemble(description: Description, wanted: Wanted) -> Robot:
    """The robot; its notes are printed unless it is to be quiet. SceneError for what does not fit the description."""
    floating, joints = wanted.floating, wanted.joints
    tree = build(description, joints, floating)
    payloads = _payloads(wanted.payload)
    bodies = tree.bodies[1:]
    known = {joint.name: joint for joint in description.joints}
    weighing = {body.joint: known[body.joint].armature for body in bodies if known[body.joint].armature}
    weighing |= _armature(description, wanted.armature, bodies)
    sound = check_bodies(description, tree, floating, {*weighing, *(load.frame for load in payloads)})
    moving = [body.joint for body in bodies if body.drive.joint == body.joint] if joints is None else list(joints)
    resisting = Joints(
        damping=[known[body.joint].damping if wanted.damping else 0.0 for body in bodies],
        friction=[known[body.joint].friction if wanted.friction else 0.0 for body in bodies],
        armature=[weighing.get(body.joint, 0.0) for body in bodies],
        stiffness=[known[body.joint].stiffness if wanted.springs else 0.0 for body in bodies],
        rest=[known[body.joint].rest for body in bodies],
    )
    notes = (*description.notes, *_friction_notes(description, bodies, wanted.friction))
    limits = joint_limits(known, bodies, moving)
    robot = Robot(slide(align(tree)), moving, floating, wanted.gravity, notes, resisting, payloads, limits)
    if not sound:
        check_mass_matrix(description, tree, robot.q, robot.mechanism.Q, robot.joints)
    for note in notes if not wanted.quiet else ():
        line = f"{description.source}: {note}"
        if line not in _said:
            _said.add(line)
            print(line, file=sys.stderr)
    return robot


def choose(**options: tuple[Any, Sequence[Any]]) -> None:
    """SceneError for an option (name = (value, choices)) that is none of its choices."""
    for word, (value, choices) in options.items():
        if value not in choices:
            raise SceneError(f"{word}={value!r}; choose {' or '.join(map(repr, choices))}")


def gravity_of(given: Any) -> Vec:
    """Three numbers, m/s^2. SceneError for anything else."""
    remedy = "give three numbers, in the world's axes, m/s^2: (0, 0, -9.81)"
    if isinstance(given, str):
        raise SceneError(f"gravity={given!r}; {remedy}")
    try:
        down = [float(g) for g in given]
    except (TypeError, ValueError, RuntimeError, NotImplementedError):
        raise SceneError(f"gravity is {given!r}; {remedy}") from None
    if len(down) != 3:
        raise SceneError(f"gravity has {len(down)} entries; {remedy}")
    if not all(math.isfinite(g) for g in down):
        raise SceneError(f"gravity={tuple(down)}; {remedy}")
    return down[0], down[1], down[2]


def _payloads(given: Payload | Sequence[Payload] | None) -> tuple[Payload, ...]:
    listed = () if given is None else (given,) if isinstance(given, Payload) else given
    if not isinstance(listed, list | tuple) or not all(isinstance(one, Payload) for one in listed):
        raise SceneError("payload: give sg.urdf.Payload(frame, mass, centre, inertia), or a list of them")
    return tuple(listed)


def _armature(description: Description, given: Mapping[str, Any] | None, bodies: Sequence[Body]) -> dict[str, Any]:
    if not isinstance(given, Mapping | None):
        raise SceneError(f"armature is a {type(given).__name__}; give {{joint: kg m^2}}")
    names = [body.joint for body in bodies]
    found = {}
    for name, value in (given or {}).items():
        if name not in names:
            raise SceneError(f"armature: {description.source} moves no joint {name!r}; it moves {', '.join(names)}")
        found[name] = column(value, f"armature of joint {name!r}", 1)
        if found[name].is_constant() and float(found[name]) < 0:
            raise SceneError(f"armature of joint {name!r} is {float(found[name])}; give one that is not negative")
    return found


def _friction_notes(description: Description, bodies: Sequence[Body], friction: str | None) -> tuple[str, ...]:
    moved = {body.joint for body in bodies}
    rubbing = [joint.name for joint in description.joints if joint.name in moved and joint.friction > 0]
    if not rubbing:
        return ()
    which = f"friction of joint{'s' * (len(rubbing) > 1)} {', '.join(rubbing)}"
    if friction is None:
        return (f"{which} is left out; friction='tanh' takes it in, smoothed",)
    return (f"{which} is taken as friction tanh(rate / {FRICTION_WIDTH})",)
