"""Bias forces and mass matrix by tree recursions in body frames."""

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import casadi as ca

from servogen.urdf.exact import ZERO
from servogen.urdf.inertia import Inertia
from servogen.urdf.motion import Link, Motion
from servogen.urdf.vectors import (
    NOWHERE,
    Mat,
    Vec,
    cross,
    inner,
    number_rows,
    numbers,
    plus,
    symmetric,
    times,
    turned,
)


def forces(
    links: list[Link], motion: list[Motion], bodies: "list[Composite]", rotors: dict[int, Fraction]
) -> tuple[Vec, Vec, list[Any]]:
    """What a motion takes: force and moment at the root, then one entry per joint.

    Recursive Newton-Euler, Featherstone (2008), Table 5.1. bodies: each alone; they and rotors by body,
    as regrouped. N, N m in the root's frame; N m or N per joint.
    """
    wrenches = [_inertial_wrench(m, i) for m, i in zip(motion, bodies, strict=True)]
    joint: list[Any] = [0.0] * len(links)
    for k in range(len(links), 0, -1):
        here, parent = links[k - 1], links[k - 1].body.parent
        if k in rotors:
            spin = float(rotors[k])
            joint[k - 1] = spin * motion[k].alpha[2]
            carried = cross(motion[parent].omega, times(spin * motion[k].omega[2], here.axis))
            f, n = NOWHERE, plus(carried, times(joint[k - 1], here.axis))
        else:
            f, n = wrenches[k]
            joint[k - 1] = f[2] if here.body.prismatic else n[2]
            f, n = here.inwards(f), here.inwards(n)
            n = plus(n, cross(here.offset, f))
        wrenches[parent] = plus(wrenches[parent][0], f), plus(wrenches[parent][1], n)
    return *wrenches[0], joint


def _inertial_wrench(motion: Motion, body: "Composite") -> tuple[Vec, Vec]:
    """m a + U h, and sum of r x (a + U r) m over the body."""
    mass, h, s = body.mass, body.first, body.second
    U, (xx, yy, zz) = motion.U, motion.squares
    f = plus(times(mass, motion.a), tuple(inner(row, h) for row in U))  # type: ignore[arg-type]
    n = (
        (s[1][1] * U[2][1] - s[2][2] * U[1][2]) + s[1][2] * (zz - yy) + (s[0][1] * U[2][0] - s[0][2] * U[1][0]),
        (s[2][2] * U[0][2] - s[0][0] * U[2][0]) + s[0][2] * (xx - zz) + (s[1][2] * U[0][1] - s[0][1] * U[2][1]),
        (s[0][0] * U[1][0] - s[1][1] * U[0][1]) + s[0][1] * (yy - xx) + (s[0][2] * U[1][2] - s[1][2] * U[0][2]),
    )
    return f, plus(n, cross(h, motion.a))


@dataclass(frozen=True, eq=False)
class Composite:
    """A body with all it carries, in its frame: mass (kg), first (kg m) and second moments (kg m^2), SX or numbers."""

    mass: Any
    first: Vec
    second: Mat

    def __add__(self, other: "Composite") -> "Composite":
        second = tuple(plus(a, b) for a, b in zip(self.second, other.second, strict=True))
        return Composite(self.mass + other.mass, plus(self.first, other.first), second)  # type: ignore[arg-type]

    def inertia(self) -> Mat:
        """tr(second) I - second."""
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = self.second
        return symmetric(yy + zz, xx + zz, xx + yy, -xy, -xz, -yz)

    def momentum(self, prismatic: bool) -> tuple[Vec, Vec]:
        """Linear and angular momentum at the origin for unit rate about or along the third axis."""
        hx, hy, _ = self.first
        if prismatic:
            return (0.0, 0.0, self.mass), (hy, -hx, 0.0)
        s = self.second
        return (-hy, hx, 0.0), (-s[0][2], -s[1][2], s[0][0] + s[1][1])


def alone(inertia: Inertia, load: Composite | None = None) -> Composite:
    """One body by itself, with what is fixed to it."""
    own = Composite(float(inertia.mass), numbers(inertia.first), number_rows(inertia.second))
    return own if load is None else own + load


def composites(links: list[Link], inertias: list[Inertia], loads: dict[int, Composite]) -> list[Composite]:
    """Composite rigid bodies, Featherstone (2008), Table 6.2, from the tips to the root. loads: by body.

    Masses add up exactly, so that those which regrouping has moved away leave no trace.
    """
    masses = [i.mass for i in inertias]
    loaded = [loads[k].mass if k in loads else 0.0 for k in range(len(inertias))]
    found = [alone(replace(i, mass=ZERO), loads.get(k)) for k, i in enumerate(inertias)]
    for k in range(len(links), -1, -1):
        own = Composite(float(masses[k]) + loaded[k], found[k].first, found[k].second)
        found[k] = own
        if k == 0:
            break
        here, parent = links[k - 1], links[k - 1].body.parent
        found[parent] = found[parent] + _seen_from_parent(here, own)
        masses[parent] += masses[k]
        loaded[parent] = loaded[parent] + loaded[k]
    return found


def _seen_from_parent(here: Link, carried: Composite) -> Composite:
    p, h = here.offset, here.inwards(carried.first)
    s = turned(here.fixed_rotation, _turned_about_axis(here, carried.second))
    mp = times(carried.mass, p)

    def moved(i: int, j: int) -> Any:
        mixed = 2 * (p[i] * h[i]) if i == j else p[i] * h[j] + p[j] * h[i]
        return s[i][j] + mixed + mp[i] * p[j]

    second = symmetric(moved(0, 0), moved(1, 1), moved(2, 2), moved(0, 1), moved(0, 2), moved(1, 2))
    return Composite(0.0, plus(h, mp), second)


def _turned_about_axis(here: Link, s: Mat) -> Mat:
    """Rz(q) s Rz(q)^T with one shared term: ten operations for the upper block."""
    if here.body.prismatic:
        return s
    c, sn = here.cosine, here.sine
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = s
    shared = c * (xx - yy) - sn * (2 * xy)
    return symmetric(yy + c * shared, xx - c * shared, zz, xy + sn * shared, c * xz - sn * yz, sn * xz + c * yz)


def mass_matrix(
    links: list[Link], bodies: list[Composite], rotors: dict[int, Fraction], floating: bool
) -> list[list[Any]]:
    """Rows of the symmetric mass matrix: the floating base's linear and angular rates first, then the joints'.

    bodies: composites without the rotors' spin. A rotor about axis a adds J a a^T, the first pivot when it is
    eliminated first.
    """
    base = 6 if floating else 0
    n = base + len(links)
    rows: list[list[Any]] = [[0.0] * n for _ in range(n)]

    def put(i: int, j: int, value: Any) -> None:
        rows[i][j] = rows[j][i] = value

    if floating:
        _put_base(bodies[0], put)
    for k in range(1, len(links) + 1):
        if k in rotors:
            continue
        f, n_ = bodies[k].momentum(links[k - 1].body.prismatic)
        for i, value in _along_the_path(links, k, f, n_, base):
            put(base + k - 1, i, value)
    for k, spin in rotors.items():
        rates = dict(_spin_rates(links, k, base))
        for i, a in rates.items():
            for j in [j for j in rates if j <= i]:
                put(i, j, rows[i][j] + (float(spin) * a) * rates[j])
    return rows


def _put_base(whole: Composite, put: Any) -> None:
    for i in range(3):
        put(i, i, whole.mass)
        for j in range(3):
            put(3 + i, 3 + j, whole.inertia()[i][j])
    hx, hy, hz = whole.first
    for i, j, value in ((0, 4, hz), (0, 5, -hy), (1, 3, -hz), (1, 5, hx), (2, 3, hy), (2, 4, -hx)):
        put(i, j, value)


def _along_the_path(links: list[Link], k: int, f: Vec, n: Vec, base: int) -> list[tuple[int, Any]]:
    """(row, entry) of a wrench in body k's frame on every joint from there to the root."""
    entries = []
    while k > 0:
        here = links[k - 1]
        entries.append((base + k - 1, f[2] if here.body.prismatic else n[2]))
        f, n = here.inwards(f), here.inwards(n)
        n = plus(n, cross(here.offset, f))
        k = here.body.parent
    return entries + list(enumerate((*f, *n))) if base else entries


def _spin_rates(links: list[Link], k: int, base: int) -> list[tuple[int, Any]]:
    """(row, factor): the rotor's spin is the sum of the factors times the rates."""
    here = links[k - 1]
    entries = _along_the_path(links, here.body.parent, NOWHERE, here.axis, base)
    return [(base + k - 1, 1.0), *((i, a) for i, a in entries if not ca.SX(a).is_zero())]
