"""From links and joints to a tree of moving bodies: fixed and locked joints weld their links together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from servogen.errors import SceneError
from servogen.urdf.description import MOVING, Description, Joint
from servogen.urdf.exact import IDENTITY, ORIGIN, Matrix, Vector, add, apply, multiply
from servogen.urdf.inertia import Inertia


@dataclass(frozen=True)
class Body:
    """One moving body. Its frame at q = 0 has `rotation` and `origin` in the parent body's frame.

    parent: index of the parent body, always smaller than the own; -1 for the root. prismatic: along `axis`, else
    revolute about it. The axis passes through the frame's origin. inertia: about the frame.
    """

    joint: str
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


def build(description: Description, joints: Sequence[str] | None) -> Tree:
    """Bodies in the order of the file, depth first. joints: those that move; None: all that can."""
    moving = _moving(description, joints)
    children: dict[str, list[Joint]] = {}
    for joint in description.joints:
        children.setdefault(joint.parent, []).append(joint)
    nothing = Inertia()
    bodies = [Body("", -1, False, IDENTITY, ORIGIN, IDENTITY[2], description.links[description.root] or nothing)]
    frames = {description.root: Frame(0, IDENTITY, ORIGIN)}
    waiting = list(reversed(children.get(description.root, [])))
    while waiting:
        joint = waiting.pop()
        at = frames[joint.parent]
        turn = multiply(at.rotation, joint.rotation)
        origin = add(at.origin, apply(at.rotation, joint.origin))
        inertia = description.links[joint.child] or nothing
        if joint.name in moving:
            frames[joint.child] = Frame(len(bodies), IDENTITY, ORIGIN)
            prismatic = joint.kind == "prismatic"
            bodies.append(Body(joint.name, at.body, prismatic, turn, origin, joint.axis, inertia))
        else:
            frames[joint.child] = Frame(at.body, turn, origin)
            carrier = bodies[at.body]
            bodies[at.body] = replace(carrier, inertia=carrier.inertia + inertia.seen_from(turn, origin))
        waiting += reversed(children.get(joint.child, []))
    tree = Tree(tuple(bodies), frames, {joint.child: joint.parent for joint in description.joints})
    _check_inertia(description, tree)
    return tree


def _moving(description: Description, joints: Sequence[str] | None) -> set[str]:
    source = description.source
    known = {joint.name: joint for joint in description.joints}
    if isinstance(joints, str):
        raise SceneError(f"joints={joints!r}: give a list of joint names")
    chosen = [joint.name for joint in description.joints if joint.kind != "fixed"] if joints is None else list(joints)
    for name in chosen:
        if name not in known:
            movable = ", ".join(joint.name for joint in description.joints if joint.kind in MOVING)
            raise SceneError(f"{source} has no joint {name!r}; it can move {movable or 'none'}")
        if chosen.count(name) > 1:
            raise SceneError(f"joints: {name!r} is named twice; name it once")
        joint = known[name]
        if joint.kind not in MOVING:
            raise SceneError(
                f"{source}: joint {name!r} is of type {joint.kind!r}, which is not supported ({', '.join(MOVING)} and "
                "fixed are); lock it by leaving it out of joints=[...], or make it of supported ones"
            )
        if joint.mimics is not None:
            raise SceneError(
                f"{source}: joint {name!r} mimics {joint.mimics!r}, which is not supported; lock it by leaving it out "
                "of joints=[...], or remove <mimic> and tie the two by a constraint"
            )
    if not chosen:
        raise SceneError(f"{source}: no joint is left to move; name at least one in joints=[...]")
    return set(chosen)


def _check_inertia(description: Description, tree: Tree) -> None:
    """Every joint must move some mass: nothing it carries, or all of it without <inertial>, makes Q singular."""
    carries = [_links_of(tree, k) for k in range(len(tree.bodies))]
    for k in range(len(tree.bodies) - 1, 0, -1):
        body = tree.bodies[k]
        if all(description.links[link] in (None, Inertia()) for link in carries[k]):
            first = carries[k][0]
            raise SceneError(
                f"{description.source}: link {first!r} has no <inertial>, and joint {body.joint!r} moves nothing else; "
                f"give the link mass and inertia, or lock the joint by leaving it out of joints=[...]"
            )
        carries[body.parent] += carries[k]


def _links_of(tree: Tree, body: int) -> list[str]:
    return [link for link, frame in tree.frames.items() if frame.body == body]
