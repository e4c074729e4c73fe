"""3-vectors and symmetric matrices of SX scalars and numbers, none of whose zeros leaves a trace.

CasADi drops x + 0, 0 x and 1 x as it builds, so plain formulas suffice.
"""

from typing import Any

import casadi as ca

from servogen.urdf.exact import Matrix, Vector

Vec = tuple[Any, Any, Any]
Mat = tuple[Vec, Vec, Vec]
"""Rows."""

NOWHERE: Vec = (0.0, 0.0, 0.0)


def numbers(a: Vector) -> Vec:
    """A rational vector as the nearest floats."""
    return float(a[0]), float(a[1]), float(a[2])


def number_rows(m: Matrix) -> Mat:
    return numbers(m[0]), numbers(m[1]), numbers(m[2])


def plus(a: Vec, b: Vec) -> Vec:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def minus(a: Vec, b: Vec) -> Vec:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def times(factor: Any, a: Vec) -> Vec:
    return factor * a[0], factor * a[1], factor * a[2]


def inner(a: Vec, b: Vec) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vec, b: Vec) -> Vec:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def product(m: Mat, a: Vec) -> Vec:
    return inner(m[0], a), inner(m[1], a), inner(m[2], a)


def product_transposed(m: Mat, a: Vec) -> Vec:
    """m^T a."""
    return tuple(m[0][i] * a[0] + m[1][i] * a[1] + m[2][i] * a[2] for i in range(3))  # type: ignore[return-value]


def turned(m: Mat, s: Mat) -> Mat:
    """m s m^T for a symmetric s; the result holds each pair of equal entries once."""
    rows = [product(m, (s[0][j], s[1][j], s[2][j])) for j in range(3)]  # columns of m s
    entry = [
        [inner(m[j], (rows[0][i], rows[1][i], rows[2][i])) if i <= j else None for j in range(3)] for i in range(3)
    ]
    return symmetric(entry[0][0], entry[1][1], entry[2][2], entry[0][1], entry[0][2], entry[1][2])


def symmetric(xx: Any, yy: Any, zz: Any, xy: Any, xz: Any, yz: Any) -> Mat:
    return (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)


def column(entries: Vec | list[Any]) -> Any:
    """An SX column."""
    return ca.vertcat(*(ca.SX(e) for e in entries))


def unpack(sx: Any) -> Vec:
    return sx[0], sx[1], sx[2]
