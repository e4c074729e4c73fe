"""Exact 3-vectors and rotations: rationals, so that structural zeros and ones of a robot are found, not guessed.

A quarter turn is exact; any other angle is computed to 50 digits and then kept as a rational.
"""

import math
from collections.abc import Sequence
from fractions import Fraction

import mpmath as mp

from servogen.ir.lower import decimal_value
from servogen.ir.numbers import as_fraction

Vector = tuple[Fraction, Fraction, Fraction]
Matrix = tuple[Vector, Vector, Vector]

ZERO, ONE = Fraction(0), Fraction(1)
ORIGIN: Vector = (ZERO, ZERO, ZERO)
IDENTITY: Matrix = ((ONE, ZERO, ZERO), (ZERO, ONE, ZERO), (ZERO, ZERO, ONE))
QUARTER_TURN_TOLERANCE = 5e-6
"""Radians; 1.5708 and anything closer is meant as pi/2."""

_DIGITS = 50
_QUARTER_TURNS = ((ONE, ZERO), (ZERO, ONE), (-ONE, ZERO), (ZERO, -ONE))


def vector(numbers: Sequence[float]) -> Vector:
    """Three floats as the decimals they print as."""
    x, y, z = (decimal_value(float(number)) for number in numbers)
    return x, y, z


def add(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def scale(factor: Fraction, a: Vector) -> Vector:
    return factor * a[0], factor * a[1], factor * a[2]


def dot(a: Vector, b: Vector) -> Fraction:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def outer(a: Vector, b: Vector) -> Matrix:
    return scale(a[0], b), scale(a[1], b), scale(a[2], b)


def transpose(m: Matrix) -> Matrix:
    return (m[0][0], m[1][0], m[2][0]), (m[0][1], m[1][1], m[2][1]), (m[0][2], m[1][2], m[2][2])


def apply(m: Matrix, a: Vector) -> Vector:
    return dot(m[0], a), dot(m[1], a), dot(m[2], a)


def multiply(m: Matrix, n: Matrix) -> Matrix:
    columns = transpose(n)
    return transpose((apply(m, columns[0]), apply(m, columns[1]), apply(m, columns[2])))


def add_matrices(m: Matrix, n: Matrix) -> Matrix:
    return add(m[0], n[0]), add(m[1], n[1]), add(m[2], n[2])


def scale_matrix(factor: Fraction, m: Matrix) -> Matrix:
    return scale(factor, m[0]), scale(factor, m[1]), scale(factor, m[2])


def snapped_turns(angle: float) -> int | None:
    """How many quarter turns an angle in radians is meant to be; None if it is no multiple of one."""
    with mp.workdps(_digits(angle)):
        turns = round(angle / (mp.pi / 2))
        return int(turns) if abs(angle - turns * mp.pi / 2) <= QUARTER_TURN_TOLERANCE else None


def _digits(angle: float) -> int:
    """As many as leave 50 of what is less than a turn."""
    return _DIGITS + max(0, math.frexp(angle)[1] // 3)


def cosine_sine(angle: float, quarter_turns: bool = True) -> tuple[Fraction, Fraction]:
    """cos and sin of an angle in radians: exact near quarter turns, where these are asked for, else to 50 digits."""
    turns = snapped_turns(angle) if quarter_turns else None
    if turns is not None:
        return _QUARTER_TURNS[turns % 4]
    with mp.workdps(_digits(angle)):
        number = decimal_value(angle)
        exact = mp.mpf(number.numerator) / number.denominator
        return as_fraction(mp.cos(exact)), as_fraction(mp.sin(exact))


def rotation(rpy: Sequence[float], quarter_turns: bool = True) -> Matrix:
    """The rotation of URDF's roll, pitch, yaw: Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, sr), (cp, sp), (cy, sy) = (cosine_sine(float(angle), quarter_turns) for angle in rpy)
    roll: Matrix = ((ONE, ZERO, ZERO), (ZERO, cr, -sr), (ZERO, sr, cr))
    pitch: Matrix = ((cp, ZERO, sp), (ZERO, ONE, ZERO), (-sp, ZERO, cp))
    yaw: Matrix = ((cy, -sy, ZERO), (sy, cy, ZERO), (ZERO, ZERO, ONE))
    return multiply(yaw, multiply(pitch, roll))


def about(axis: Vector, angle: float) -> Matrix:
    """The rotation about a unit axis by an angle in radians (Rodrigues)."""
    c, s = cosine_sine(angle)
    cross_rows: Matrix = ((ZERO, -axis[2], axis[1]), (axis[2], ZERO, -axis[0]), (-axis[1], axis[0], ZERO))
    turned = add_matrices(scale_matrix(c, IDENTITY), scale_matrix(s, cross_rows))
    return add_matrices(turned, scale_matrix(1 - c, outer(axis, axis)))


def unit(a: Vector) -> Vector:
    """a / |a|, exact where a lies along a coordinate axis."""
    if sum(x != 0 for x in a) == 1:
        return tuple(Fraction((x > 0) - (x < 0)) for x in a)  # type: ignore[return-value]
    with mp.workdps(_DIGITS):
        square = dot(a, a)
        length = as_fraction(mp.sqrt(mp.mpf(square.numerator) / square.denominator))
    return scale(1 / length, a)


def turning_z_to(axis: Vector) -> Matrix:
    """A rotation whose third column is the unit vector `axis`; a signed permutation where that is a coordinate axis."""
    k = max(range(3), key=lambda i: abs(axis[i]))
    helper: Vector = IDENTITY[(k + 1) % 3]
    x = unit(add(helper, scale(-dot(helper, axis), axis)))
    return transpose((x, cross(axis, x), axis))
