"""Real numbers of 60 digits as balls: a midpoint, and a radius that bounds how far the value may be from it (Arb)."""

from collections.abc import Iterable
from contextlib import AbstractContextManager
from fractions import Fraction
from typing import Any

import flint
import numpy as np

BITS = 200
"""Of a midpoint, 60 digits."""

Ball = Any
"""flint.arb."""

NAN: Ball = flint.arb("nan")
ZERO: Ball = flint.arb(0)


def working(bits: int = BITS) -> AbstractContextManager[Any]:
    """A context in which arithmetic on balls keeps so many bits."""
    return flint.ctx.workprec(bits)  # type: ignore[no-any-return]


def ball(value: Any) -> Ball:
    """The number as a ball: exact, but for a fraction, which is rounded; a ball is returned as it is.

    value: a float, a number of numpy, a Fraction or flint's; TypeError for anything else."""
    if isinstance(value, flint.arb):
        return value
    if isinstance(value, Fraction):
        return flint.arb(flint.fmpq(value.numerator, value.denominator))
    if isinstance(value, float | np.floating):
        return flint.arb(float(value))
    if isinstance(value, int | np.integer):
        return flint.arb(int(value))
    return flint.arb(value)


def balls(values: Iterable[Any]) -> list[Ball]:
    return [ball(v) for v in values]


def all_finite(*groups: Iterable[Ball]) -> bool:
    return all(v.is_finite() for group in groups for v in group)


def middle(value: Ball) -> Fraction:
    """The midpoint, exactly; ValueError where it is not finite."""
    quotient = value.mid().fmpq()
    return Fraction(int(quotient.p), int(quotient.q))


def total(values: Iterable[Ball]) -> Ball:
    return sum(values, ZERO)
