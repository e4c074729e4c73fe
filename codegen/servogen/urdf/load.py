"""From a URDF file and what the caller asks for to a robot."""

import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from servogen.errors import SceneError
from servogen.scene.convert import column
from servogen.urdf.description import Description, from_floating_root, read
from servogen.urdf.frames import align, slide
from servogen.urdf.limits import joint_limits
from servogen.urdf.payload import Payload
from servogen.urdf.regular import check_bodies, check_mass_matrix
from servogen.urdf.robot import FRICTION_WIDTH, Joints, Robot
from servogen.urdf.tree import Body, build
from servogen.urdf.vectors import Vec

_said: set[str] = set()
"""Notes that were printed already: a command may load a file more than once."""


def load(
    path: str | Path,
    base: Literal["fixed", "floating"] = "fixed",
    gravity: Sequence[float] = (0, 0, -9.81),
    joints: Sequence[str] | None = None,
    quiet: bool = False,
    damping: Literal["urdf"] | None = "urdf",
    friction: Literal["tanh"] | None = None,
    armature: Mapping[str, Any] | None = None,
    payload: Payload | Sequence[Payload] | None = None,
    quarter_turns: bool = True,
) -> Robot:
    """The robot in a URDF file.

    base: "fixed" (the root link is the world) or "floating". gravity: in the world, m/s^2.
    joints: the actuated joints to keep, in the order of q; all others are locked at zero. None: all, in tree order. A
        joint that mimics another moves with that and has no coordinate of its own.
    quiet: do not print (to stderr) the `notes`; they are printed once.
    damping: "urdf" takes the joints' <dynamics damping> into P; None leaves it out. friction: "tanh" takes <dynamics
        friction> as friction tanh(rate / 0.01), rates in rad/s or m/s; None leaves it out, and a note says so.
    armature: joint -> inertia of what turns with it, a rotor through its gear, kg m^2 (kg where prismatic).
    payload: sg.urdf.Payload(frame, mass, centre, inertia), or several; SX of parameters is welcome, in armature, too.
    quarter_turns: angles within 5e-6 of a quarter turn are exactly that; False takes them as written.
    Raises SceneError for a file that cannot be read, unsupported joints, loops, joints that move no mass.
    """
    if base not in ("fixed", "floating"):
        raise SceneError(f"base={base!r}; choose 'fixed' or 'floating'")
    for word, value, choices in (("damping", damping, ("urdf", None)), ("friction", friction, ("tanh", None))):
        if value not in choices:
            raise SceneError(f"{word}={value!r}; choose {choices[0]!r} or None")
    down, floating = _gravity(gravity), base == "floating"
    description = read(path, quarter_turns)
    if floating:
        description = from_floating_root(description)
    tree = build(description, joints, floating)
    payloads = _payloads(payload)
    bodies = tree.bodies[1:]
    weighing = _armature(description, armature, bodies)
    sound = check_bodies(description, tree, floating, {*weighing, *(load.frame for load in payloads)})
    moving = [body.joint for body in bodies if body.drive.joint == body.joint] if joints is None else list(joints)
    known = {joint.name: joint for joint in description.joints}
    resisting = Joints(
        damping=[known[body.joint].damping if damping else 0.0 for body in bodies],
        friction=[known[body.joint].friction if friction else 0.0 for body in bodies],
        armature=[weighing.get(body.joint, 0.0) for body in bodies],
    )
    notes = (*description.notes, *_friction_notes(description, bodies, friction))
    limits = joint_limits(known, bodies, moving)
    robot = Robot(slide(align(tree)), moving, floating, down, notes, resisting, payloads, limits)
    if not sound:
        check_mass_matrix(description, tree, robot.q, robot.mechanism.Q, robot.joints)
    for note in notes if not quiet else ():
        line = f"{description.source}: {note}"
        if line not in _said:
            _said.add(line)
            print(line, file=sys.stderr)
    return robot


def _gravity(given: Any) -> Vec:
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
