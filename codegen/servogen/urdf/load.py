"""From a URDF file and what the caller asks for to a robot."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from servogen.urdf.assemble import Wanted, assemble, choose, gravity_of
from servogen.urdf.description import from_floating_root, read
from servogen.urdf.payload import Payload
from servogen.urdf.robot import Robot


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
    choose(base=(base, ("fixed", "floating")), damping=(damping, ("urdf", None)), friction=(friction, ("tanh", None)))
    down, floating = gravity_of(gravity), base == "floating"
    description = read(path, quarter_turns)
    if floating:
        description = from_floating_root(description)
    return assemble(
        description,
        Wanted(floating, down, joints, quiet, damping is not None, False, friction, armature, payload),
    )
