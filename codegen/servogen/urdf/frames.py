"""Where a body's frame sits: its third axis along the joint's, its origin slid along that axis to where it costs least.

A frame may be turned at will and its origin moved along the joint's axis: neither changes the motion.
"""

from dataclasses import replace
from fractions import Fraction
from itertools import product

from servogen.urdf.exact import (
    IDENTITY,
    ORIGIN,
    ZERO,
    Matrix,
    Vector,
    add,
    apply,
    cross,
    dot,
    multiply,
    scale,
    transpose,
    turning_z_to,
)
from servogen.urdf.tree import Body, Frame, Tree

_UP: Vector = IDENTITY[2]
_ROUNDS = 3


def align(tree: Tree) -> Tree:
    """Every joint's axis becomes the third axis of its body's frame."""
    turns = [IDENTITY, *(turning_z_to(body.axis) for body in tree.bodies[1:])]
    return _reframe(tree, [(turn, ORIGIN) for turn in turns])


def slide(tree: Tree) -> Tree:
    """Origins of revolute bodies move along their axes, for offsets between bodies with the fewest entries."""
    slides = _choose(tree.bodies)
    return _reframe(tree, [(IDENTITY, scale(t, _UP)) for t in slides])


def _reframe(tree: Tree, moves: list[tuple[Matrix, Vector]]) -> Tree:
    """Each body's new frame has the given rotation and origin in its old one."""
    bodies = []
    for body, (turn, origin) in zip(tree.bodies, moves, strict=True):
        at = Frame(body.parent, body.rotation, body.origin) if body.parent >= 0 else Frame(-1, IDENTITY, ORIGIN)
        at = Frame(at.body, multiply(at.rotation, turn), add(at.origin, apply(at.rotation, origin)))
        if body.parent >= 0:
            at = _seen_from_new(at, moves[body.parent])
        back = transpose(turn)
        inertia = body.inertia.seen_from(back, scale(Fraction(-1), apply(back, origin)))
        axis = apply(back, body.axis)
        bodies.append(replace(body, rotation=at.rotation, origin=at.origin, axis=axis, inertia=inertia))
    frames = {link: _seen_from_new(frame, moves[frame.body]) for link, frame in tree.frames.items()}
    return Tree(tuple(bodies), frames, tree.above)


def _seen_from_new(frame: Frame, move: tuple[Matrix, Vector]) -> Frame:
    turn, origin = move
    back = transpose(turn)
    shifted = add(frame.origin, scale(Fraction(-1), origin))
    return Frame(frame.body, multiply(back, frame.rotation), apply(back, shifted))


def _offset(body: Body, parent_slide: Fraction, slide: Fraction) -> Vector:
    """From the parent's origin to the body's, in the parent's axes, after both have slid."""
    along = apply(body.rotation, _UP)
    return add(add(body.origin, scale(-parent_slide, _UP)), scale(slide, along))


Cost = tuple[int, int]
"""Nonzero entries of the offsets, then the same weighted by depth and negated: equal ones rather far from the root."""


def _choose(bodies: tuple[Body, ...]) -> list[Fraction]:
    """The slide of each body, by dynamic programming over the tree."""
    candidates = _candidates(bodies)
    depth = [0] * len(bodies)
    for k, body in enumerate(bodies[1:], start=1):
        depth[k] = depth[body.parent] + 1
    below: list[dict[Fraction, Cost]] = [dict.fromkeys(slides, (0, 0)) for slides in candidates]
    choice: dict[tuple[int, Fraction], Fraction] = {}  # (body, its parent's slide) -> its slide
    for k in range(len(bodies) - 1, 0, -1):
        parent = bodies[k].parent
        for s in candidates[parent]:
            costs = {t: _cost(_offset(bodies[k], s, t), depth[k], below[k][t]) for t in candidates[k]}
            best = min(candidates[k], key=costs.__getitem__)
            choice[k, s] = best
            below[parent][s] = below[parent][s][0] + costs[best][0], below[parent][s][1] + costs[best][1]
    slides = [ZERO] * len(bodies)
    for k in range(1, len(bodies)):
        slides[k] = choice[k, slides[bodies[k].parent]]
    return slides


def _cost(offset: Vector, depth: int, below: Cost) -> Cost:
    entries = sum(x != 0 for x in offset)
    return below[0] + entries, below[1] - depth * entries


def _candidates(bodies: tuple[Body, ...]) -> list[list[Fraction]]:
    """Slides worth trying: none, and those that clear an entry of an offset, grown over a few rounds."""
    found: list[set[Fraction]] = [{ZERO} for _ in bodies]
    for _ in range(_ROUNDS):
        for k, body in enumerate(bodies[1:], start=1):
            parent = body.parent
            along = apply(body.rotation, _UP)
            if not body.prismatic:
                for s, i in product(list(found[parent]), range(3)):
                    start = _offset(body, s, ZERO)
                    if along[i] != 0 and start[i] != 0:
                        found[k].add(-start[i] / along[i])
                found[k] |= _foot(body.origin, _UP, along)
            if parent > 0 and not bodies[parent].prismatic:
                found[parent] |= {_offset(body, ZERO, t)[2] for t in found[k]}
                found[parent] |= _foot(scale(Fraction(-1), body.origin), along, _UP)
    return [sorted(slides, key=lambda t: (abs(t), t)) for slides in found]


def _foot(origin: Vector, other: Vector, along: Vector) -> set[Fraction]:
    """Where the line origin + t along is nearest the line s other; none if parallel."""
    normal = cross(along, other)
    square = dot(normal, normal)
    return {-dot(cross(origin, other), normal) / square} if square else set()
