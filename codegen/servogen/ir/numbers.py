"""Between exact values, numbers of many digits and numbers of the target type."""

from fractions import Fraction

import mpmath as mp
import numpy as np

DIGITS = 50
"""Of what mpmath computes."""


def as_fraction(number: mp.mpf) -> Fraction:
    """The exact value of a finite mpf, all its bits kept."""
    sign, mantissa, exponent, _ = number._mpf_
    magnitude = Fraction(int(mantissa)) * Fraction(2) ** int(exponent)
    return -magnitude if sign else magnitude


def nearest(value: Fraction | float, scalar: str) -> float:
    """The number of the target type nearest to an exact value; ties to even, infinity beyond the largest.

    Rounded once, not through float64.
    """
    exact = Fraction(value)
    try:
        wide = float(exact)
    except OverflowError:
        return float("inf") if exact > 0 else float("-inf")
    if scalar == "float64":
        return wide
    guess = np.float32(np.clip(wide, -_LARGEST, _LARGEST))
    if abs(exact) >= Fraction(_LARGEST) + Fraction(2) ** 103:  # half a unit above: the tie goes up
        return float("inf") if exact > 0 else float("-inf")
    with np.errstate(all="ignore"):
        candidates = [guess, np.nextafter(guess, np.float32(-np.inf)), np.nextafter(guess, np.float32(np.inf))]
    finite = [c for c in candidates if np.isfinite(c)]
    return float(min(finite, key=lambda c: (abs(Fraction(float(c)) - exact), int(c.view(np.uint32)) & 1)))


_LARGEST = float(np.finfo(np.float32).max)
