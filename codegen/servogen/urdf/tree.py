"""From links and joints to a tree of moving bodies: fixed and locked joints weld their links together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

from servogen.errors import SceneError
from servogen.urdf.description import MOVING, Description, Joint
from servogen.urdf.exact import IDENTITY, ONE, ORIGIN, ZERO, Matrix, Vector, about, add, apply, multiply, scale
from servogen.urdf.inertia import Inertia


@dataclass(frozen=True)
class Drive:
    """The coordinate that moves a body: factor q_joint + offset, with q_joint that of a joint that mimics none."""

    joint: str
    factor: Fraction = ONE
    offset: Fraction = ZERO

    @property
    def is_plain(self) -> bool:
        """Whether it is the coordinate itself."""
        return self.factor == ONE and self.offset == ZERO


@dataclass(frozen=True)
class Body:
    """One moving body. Its frame at zero has `rotation` and `origin` in the parent body's frame.

    parent: index of the parent body, always smaller than the own; -1 for the root. prismatic: along `axis`, else
    revolute about it. The axis passes through the frame's origin. inertia: about the frame.
    """

    joint: str
    drive: Drive
    parent: int
    prismatic: bool
    rotation: Matrix
    origin: Vector
    axis: Vector
    inertia: Inertia


@dataclass(frozen=True)
class Frame:
    """A link's frame, fixed to a body."""

    body: int
    rotation: Matrix
    origin: Vector


@dataclass(frozen=True)
class Tree:
    """bodies[0] is the root: the world for a fixed base, the floating base otherwise. frames: by link name.

    above: link -> the link that its joint hangs on.
    """

    bodies: tuple[Body, ...]
    frames: dict[str, Frame]
    above: dict[str, str]


def build(description: Description, joints: Sequence[str] | None, floating: bool) -> Tree:
    """Bodies in the order of the file, depth first. joints: those that move; None: all that can."""
    drives = {joint.name: _drive(description, joint) for joint in description.joints if joint.kind in MOVING}
    moving = _moving(description, joints, floating)
    children: dict[str, list[Joint]] = {}
    for joint in description.joints:
        children.setdefault(joint.parent, []).append(joint)
    nothing = Inertia()
    root = description.links[description.root] or nothing
    bodies = [Body("", Drive(""), -1, False, IDENTITY, ORIGIN, IDENTITY[2], root)]
    frames = {description.root: Frame(0, IDENTITY, ORIGIN)}
    waiting = list(reversed(children.get(description.root, [])))
    while waiting:
        joint = waiting.pop()
        at = frames[joint.parent]
        turn = multiply(at.rotation, joint.rotation)
        origin = add(at.origin, apply(at.rotation, joint.origin))
        inertia = description.links[joint.child] or nothing
        drive = drives.get(joint.name)
        if drive is not None and drive.joint in moving:
            frames[joint.child] = Frame(len(bodies), IDENTITY, ORIGIN)
            prismatic = joint.kind == "prismatic"
            bodies.append(Body(joint.name, drive, at.body, prismatic, turn, origin, joint.axis, inertia))
        else:
            if drive is not None and drive.offset != 0:  # it mimics a locked joint
                turn, origin = _moved(joint, drive.offset, turn, origin)
            frames[joint.child] = Frame(at.body, turn, origin)
            carrier = bodies[at.body]
            bodies[at.body] = replace(carrier, inertia=carrier.inertia + inertia.seen_from(turn, origin))
        waiting += reversed(children.get(joint.child, []))
    return Tree(tuple(bodies), frames, {joint.child: joint.parent for joint in description.joints})


def links_of(tree: Tree, body: int) -> list[str]:
    """The links welded to a body."""
    return [link for link, frame in tree.frames.items() if frame.body == body]


def _moved(joint: Joint, by: Fraction, turn: Matrix, origin: Vector) -> tuple[Matrix, Vector]:
    """The child's frame where the joint stands at that angle or length."""
    if joint.kind == "prismatic":
        return turn, add(origin, apply(turn, scale(by, joint.axis)))
    return multiply(turn, about(joint.axis, float(by))), origin


def _drive(description: Description, joint: Joint) -> Drive:
    """The joint's own coordinate, or that of the one it mimics, perhaps by way of others."""
    known = {other.name: other for other in description.joints}
    factor, offset, seen = ONE, ZERO, [joint.name]
    while joint.mimic is not None:
        offset, factor = offset + factor * joint.mimic.offset, factor * joint.mimic.factor
        leader = known.get(joint.mimic.leader)
        what = f"{description.source}: joint {joint.name!r} mimics {joint.mimic.leader!r}"
        if leader is None:
            raise SceneError(f"{what}, no such joint; correct the <mimic>")
        if leader.name in seen:
            raise SceneError(f"{what}, which mimics it in turn; let one of {', '.join(seen)} mimic none")
        if leader.kind not in MOVING:
            raise SceneError(f"{what}, which is {leader.kind}; name a joint that moves")
        seen.append(leader.name)
        joint = leader
    return Drive(joint.name, factor, offset)


def _moving(description: Description, joints: Sequence[str] | None, floating: bool) -> set[str]:
    source = description.source
    known = {joint.name: joint for joint in description.joints}
    if isinstance(joints, str):
        raise SceneError(f"joints={joints!r}: give a list of joint names")
    free = [joint.name for joint in description.joints if joint.kind != "fixed" and joint.mimic is None]
    try:
        chosen = free if joints is None else list(joints)
    except TypeError:
        raise SceneError(f"joints={joints!r}: give a list of joint names") from None
    for name in chosen:
        if name not in known:
            movable = ", ".join(name for name in free if known[name].kind in MOVING)
            raise SceneError(f"{source} has no joint {name!r}; it can move {movable or 'none'}")
        if chosen.count(name) > 1:
            raise SceneError(f"joints: {name!r} is named twice; name it once")
        joint = known[name]
        if joint.kind == "fixed":
            raise SceneError(f"{source}: joint {name!r} is fixed and cannot move; leave it out of joints=[...]")
        if joint.kind == "floating":
            raise SceneError(
                f"{source}: joint {name!r} is of type 'floating', from {joint.parent!r}; " + _remedy(joint)
            )
        if joint.kind not in MOVING:
            raise SceneError(
                f"{source}: joint {name!r} is of type {joint.kind!r}, which is not supported ({', '.join(MOVING)} and "
                "fixed are); lock it by leaving it out of joints=[...], or make it of supported ones"
            )
        if joint.mimic is not None:
            raise SceneError(
                f"{source}: joint {name!r} mimics {joint.mimic.leader!r} and moves with that; name "
                f"{joint.mimic.leader!r} in joints=[...], or remove the <mimic>"
            )
    if not chosen and not floating:
        has = (
            "no joint is left to move; name one in joints=[...]" if free else "it has no joint that moves; give it one"
        )
        raise SceneError(f"{source}: {has}, or load it with base='floating'")
    return set(chosen)


def _remedy(joint: Joint) -> str:
    return (
        "only the base can float: load the robot with base='floating', and let this joint be the only one of a root "
        f"without inertia, or make {joint.child!r} the root; or lock the joint by leaving it out of joints=[...]"
    )
