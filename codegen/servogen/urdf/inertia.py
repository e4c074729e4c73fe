"""Inertial parameters of a rigid body about a frame, exact."""

from dataclasses import dataclass
from fractions import Fraction

from servogen.urdf.exact import (
    IDENTITY,
    ORIGIN,
    ZERO,
    Matrix,
    Vector,
    add,
    add_matrices,
    apply,
    multiply,
    outer,
    scale,
    scale_matrix,
    transpose,
)

NO_MATRIX: Matrix = (ORIGIN, ORIGIN, ORIGIN)


@dataclass(frozen=True)
class Inertia:
    """Moments of mass about a frame's origin, in its axes: linear in the mass, so that bodies add.

    mass: kg. first: sum of m r, kg m. second: sum of m r r^T, kg m^2; the inertia matrix is tr(second) I - second.
    Wensing, Kim and Slotine (2018), (8)-(10) there.
    """

    mass: Fraction = ZERO
    first: Vector = ORIGIN
    second: Matrix = NO_MATRIX

    def __add__(self, other: "Inertia") -> "Inertia":
        first = add(self.first, other.first)
        return Inertia(self.mass + other.mass, first, add_matrices(self.second, other.second))

    def __sub__(self, other: "Inertia") -> "Inertia":
        return self + Inertia(-other.mass, scale(-Fraction(1), other.first), scale_matrix(-Fraction(1), other.second))

    def seen_from(self, rotation: Matrix, translation: Vector) -> "Inertia":
        """About another frame, in which this one has the given rotation and origin."""
        turned = apply(rotation, self.first)
        mixed = outer(translation, turned)
        second = multiply(rotation, multiply(self.second, transpose(rotation)))
        for term in (mixed, transpose(mixed), scale_matrix(self.mass, outer(translation, translation))):
            second = add_matrices(second, term)
        return Inertia(self.mass, add(turned, scale(self.mass, translation)), second)


def second_moment(inertia: Matrix) -> Matrix:
    """sum of m r r^T from the inertia matrix: tr(I)/2 - I."""
    half_trace = (inertia[0][0] + inertia[1][1] + inertia[2][2]) / 2
    return add_matrices(scale_matrix(half_trace, IDENTITY), scale_matrix(-Fraction(1), inertia))
