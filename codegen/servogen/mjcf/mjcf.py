"""From an MJCF file and what the caller asks for to a robot."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from servogen.mjcf.bodies import Reader
from servogen.mjcf.equalities import hold, read_equalities
from servogen.mjcf.library import mujoco_module
from servogen.urdf.assemble import Wanted, assemble, choose, gravity_of
from servogen.urdf.payload import Payload
from servogen.urdf.robot import Robot


def load(
    path: str | Path,
    base: Literal["fixed", "floating"] | None = None,
    gravity: Sequence[float] | None = None,
    joints: Sequence[str] | None = None,
    quiet: bool = False,
    damping: Literal["mjcf"] | None = "mjcf",
    springs: Literal["mjcf"] | None = "mjcf",
    friction: Literal["tanh"] | None = None,
    armature: Mapping[str, Any] | None = None,
    payload: Payload | Sequence[Payload] | None = None,
    quarter_turns: bool = True,
    stabilise: Any = 0.0,
) -> Robot:
    """The robot in an MJCF file, read by MuJoCo's own parser (extra `mujoco`).

    Taken are bodies with their inertials (or, where they have none, the mass of their shapes), hinges and slides, a
    free joint as the floating base, sites, and the equalities connect, weld and joint as passive constraints. Contacts,
    actuators, tendons and sensors are not.

    base: "fixed" holds free bodies where the file places them, "floating" needs one free body, which is the base; None:
        as the file has it. gravity: in the world, m/s^2; None: the file's.
    joints: those that move, in the order of q; all others are locked at zero. None: all, in the order of the file.
    quiet: do not print (to stderr) the `notes`; they are printed once.
    damping, springs: "mjcf" takes them into P (of MuJoCo's polynomials the linear part); None leaves them out.
    friction: "tanh" takes frictionloss as friction tanh(rate / 0.01); None leaves it out, and a note says so.
    armature: joint -> kg m^2 (kg), in the place of the file's. payload: as in `sg.urdf.load`.
    quarter_turns: rotations within 5e-6 of quarter turns are exactly these; False takes them as written.
    stabilise: of the passive constraints, see sg.PassiveHolonomic.

    q are MuJoCo's qpos, joint by joint (a floating base's too); u its qvel, but that a floating base's linear velocity
    is in its own axes, where MuJoCo has the world's. Frames are bodies and sites by name (unnamed bodies are body_2 and
    so on), and <body>/<joint> where a body has several joints.
    Raises SceneError for a file that MuJoCo does not read, ball joints that move, other equalities, several free
    bodies; ToolMissing without the Python package mujoco.
    """
    choose(
        base=(base, ("fixed", "floating", None)),
        damping=(damping, ("mjcf", None)),
        springs=(springs, ("mjcf", None)),
        friction=(friction, ("tanh", None)),
    )
    down = None if gravity is None else gravity_of(gravity)
    reader = Reader(mujoco_module(), path, base, quarter_turns)
    equalities = read_equalities(reader)
    wanted = Wanted(
        reader.floating, reader.gravity() if down is None else down, joints, quiet,
        damping is not None, springs is not None, friction, armature, payload,
    )  # fmt: skip
    robot = assemble(reader.description(), wanted)
    for equality in equalities:
        hold(robot, equality, stabilise)
    return robot
