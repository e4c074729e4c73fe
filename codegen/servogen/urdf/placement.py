"""Rotations, positions, geometric Jacobians and bias accelerations of frames, in the root's axes."""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from servogen.urdf.exact import ZERO, add, apply
from servogen.urdf.motion import Link, Motion
from servogen.urdf.tree import Frame
from servogen.urdf.vectors import NOWHERE, Mat, Vec, cross, number_rows, numbers, plus, times


def rotations(links: list[Link]) -> list[Mat]:
    """Columns of each body's rotation, the root's first: its axes in the root's frame."""
    found: list[Mat] = [((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
    for here in links:
        parent = found[here.body.parent]
        at_zero = here.fixed_rotation
        x, y, z = (combine(parent, (at_zero[0][j], at_zero[1][j], at_zero[2][j])) for j in range(3))
        if not here.body.prismatic:
            c, s = here.cosine, here.sine
            x, y = plus(times(c, x), times(s, y)), plus(times(c, y), times(-s, x))
        found.append((x, y, z))
    return found


def combine(columns: Mat, a: Vec) -> Vec:
    """The vector with the entries a along the columns."""
    return plus(plus(times(a[0], columns[0]), times(a[1], columns[1])), times(a[2], columns[2]))


@dataclass(frozen=True, eq=False)
class Point:
    """A point of a frame: its position from the root's origin, and per body of its path (body, linear, angular column)
    of the Jacobian; for the base, `arm` is the position itself."""

    arm: Vec
    columns: tuple[tuple[int, Vec, Vec], ...]


def point(links: list[Link], axes: list[Mat], frame: Frame) -> Point:
    """Walks from the frame to the root; what lies along a joint's own axis gives its column nothing and stays out."""
    columns = []
    arm, step, k = NOWHERE, numbers(frame.origin), frame.body
    while k > 0:
        here, z = links[k - 1], axes[k][2]
        if here.body.prismatic:
            columns.append((k, z, NOWHERE))
        else:
            across = plus(arm, combine(axes[k], (step[0], step[1], 0.0)))
            columns.append((k, cross(z, across), z))
        arm = plus(arm, combine(axes[k], step))
        step, k = here.offset, here.body.parent
    return Point(plus(arm, step), tuple(columns))


def carried_by(links: list[Link], frame: Frame) -> Frame:
    """The same point on the first body that moves it: a point on a revolute axis belongs to the parent, too.

    The rotation is not kept.
    """
    origin, k = frame.origin, frame.body
    while k > 0 and not links[k - 1].body.prismatic and origin[0] == ZERO and origin[1] == ZERO:
        body = links[k - 1].body
        origin, k = add(body.origin, apply(body.rotation, origin)), body.parent
    return Frame(k, frame.rotation, origin)


def in_root_axes(links: list[Link], axes: list[Mat], k: int, a: Vec, needed_besides: list[Any]) -> Vec:
    """A vector of body k's frame in the root's: some joints inwards one by one, then by the axes, whichever is least.

    needed_besides: what is computed anyway, so that axes it holds are free.
    """
    ways = []
    while k > 0:
        ways.append(combine(axes[k], a))
        a, k = links[k - 1].inwards(a), links[k - 1].body.parent
    ways.append(a)
    return min(ways, key=lambda way: _operations([*needed_besides, *way]))


def _operations(entries: list[Any]) -> int:
    everything = ca.vertcat(*(ca.SX(e) for e in entries))
    return int(ca.Function("count", [ca.vertcat(*ca.symvar(everything))], [everything]).n_instructions())


def bias(links: list[Link], axes: list[Mat], motion: list[Motion], frame: Frame, besides: list[Any]) -> Vec:
    """Acceleration of a frame's origin at zero u', gravity's reaction in it, in the root's axes, m/s^2."""
    held = carried_by(links, frame)
    return in_root_axes(links, axes, held.body, motion[held.body].acceleration(numbers(held.origin)), besides)


def frame_axes(axes: list[Mat], frame: Frame) -> Mat:
    """Columns: the frame's axes in the root's."""
    rows = number_rows(frame.rotation)
    columns = [combine(axes[frame.body], (rows[0][j], rows[1][j], rows[2][j])) for j in range(3)]
    return columns[0], columns[1], columns[2]
