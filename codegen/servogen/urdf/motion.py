"""Velocities and accelerations of all bodies at given joint accelerations, in body frames, from the root outwards.

Featherstone (2008), Table 5.1, in the three-dimensional form of Luh, Walker and Paul (1980).
The acceleration of the points of a body is a + U r, with U = alpha x + omega x omega x.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca

from servogen.urdf.tree import Body
from servogen.urdf.vectors import NOWHERE, Mat, Vec, number_rows, numbers, plus, product, product_transposed


@dataclass(frozen=True, eq=False)
class Link:
    """A body with its coordinate: q, u and the sine and cosine of a revolute joint's angle, SX scalars."""

    body: Body
    q: Any
    u: Any
    cosine: Any
    sine: Any

    @cached_property
    def fixed_rotation(self) -> Mat:
        """At q = 0, in the parent's frame."""
        return number_rows(self.body.rotation)

    @cached_property
    def axis(self) -> Vec:
        """The joint's axis in the parent's frame."""
        rows = self.fixed_rotation
        return rows[0][2], rows[1][2], rows[2][2]

    @cached_property
    def offset(self) -> Vec:
        """From the parent's origin to the own, in the parent's frame, m."""
        origin = numbers(self.body.origin)
        if not self.body.prismatic:
            return origin
        return tuple(p + self.q * z for p, z in zip(origin, self.axis, strict=True))  # type: ignore[return-value]

    def outwards(self, a: Vec) -> Vec:
        """A vector of the parent's frame in the own."""
        x, y, z = product_transposed(self.fixed_rotation, a)
        if self.body.prismatic:
            return x, y, z
        return self.cosine * x + self.sine * y, self.cosine * y - self.sine * x, z

    def inwards(self, a: Vec) -> Vec:
        """A vector of the own frame in the parent's."""
        x, y, z = a
        if not self.body.prismatic:
            x, y = self.cosine * x - self.sine * y, self.sine * x + self.cosine * y
        return product(self.fixed_rotation, (x, y, z))


def link(body: Body, q: Any, u: Any) -> Link:
    """A moving body with its coordinate and rate."""
    return Link(body, q, u, *((1.0, 0.0) if body.prismatic else (ca.cos(q), ca.sin(q))))


@dataclass(frozen=True, eq=False)
class Motion:
    """One body's state in its own frame: angular velocity (rad/s), angular acceleration (rad/s^2), its origin's
    acceleration (m/s^2), which holds that of gravity's reaction."""

    omega: Vec
    alpha: Vec
    a: Vec

    @cached_property
    def squares(self) -> Vec:
        return self.omega[0] * self.omega[0], self.omega[1] * self.omega[1], self.omega[2] * self.omega[2]

    @cached_property
    def U(self) -> Mat:
        """alpha x + omega x omega x, 1/s^2."""
        (x, y, z), (ax, ay, az), (xx, yy, zz) = self.omega, self.alpha, self.squares
        xy, xz, yz = x * y, x * z, y * z
        return (-(yy + zz), xy - az, xz + ay), (xy + az, -(xx + zz), yz - ax), (xz - ay, yz + ax, -(xx + yy))

    def acceleration(self, r: Vec) -> Vec:
        """Of the body's point r."""
        return plus(self.a, product(self.U, r))


@dataclass(frozen=True, eq=False)
class Motions:
    """of: the root's motion first, then each body's. joints: the joints' accelerations, rad/s^2 or m/s^2."""

    of: list[Motion]
    joints: list[Any]


def motions(links: list[Link], root: Motion, at_ease: bool = False) -> Motions:
    """Each body's motion from its parent's; links[k] is body k + 1.

    Joint accelerations are zero, or, at ease, those at which no body accelerates about its joint's axis (along it, if
    prismatic): a zero in every acceleration makes the recursion cheaper.
    """
    found, accelerations = [root], []
    for k in links:
        parent = found[k.body.parent]
        a = k.outwards(parent.acceleration(k.offset))
        x, y, z = k.outwards(parent.omega)
        alpha = k.outwards(parent.alpha)
        if k.body.prismatic:
            a = plus(a, (2 * (y * k.u), -2 * (x * k.u), 0.0))  # Coriolis: 2 omega x z u
            own, a = _eased(a) if at_ease else (0.0, a)
        else:
            z, alpha = z + k.u, plus(alpha, (y * k.u, -(x * k.u), 0.0))  # omega x z u
            own, alpha = _eased(alpha) if at_ease else (0.0, alpha)
        accelerations.append(own)
        found.append(Motion((x, y, z), alpha, a))
    return Motions(found, accelerations)


def _eased(a: Vec) -> tuple[Any, Vec]:
    """What takes the third entry away, and what is left."""
    return 0.0 - a[2], (a[0], a[1], 0.0)


def at_rest(gravity: Vec) -> Motion:
    """The root of a fixed base: it accelerates against gravity."""
    return Motion(NOWHERE, NOWHERE, (-gravity[0], -gravity[1], -gravity[2]))
