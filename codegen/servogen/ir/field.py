"""A prime field to evaluate programs in: equal values at random points mean equal expressions (Schwartz 1980)."""

import hashlib
from functools import lru_cache

PRIME = 2**127 - 1
"""-1 is no square modulo this prime, so the circle x^2 + y^2 = 1 has no point at infinity."""

POINTS = 2
"""Random points at which every value is known."""

Residue = tuple[int, ...]
"""The value of an expression at each of the points."""


def inverse(a: int) -> int:
    """1 / a; ZeroDivisionError for zero."""
    if a == 0:
        raise ZeroDivisionError("zero has no inverse")
    return pow(a, -1, PRIME)


@lru_cache(maxsize=1 << 14)  # every program asks for the same inputs and constants
def random_residue(*label: object) -> Residue:
    """A value that looks random and depends on the label alone: the same on every machine and in every run."""
    digest = hashlib.blake2b(repr(label).encode(), digest_size=24 * POINTS).digest()
    return tuple(int.from_bytes(digest[24 * k : 24 * (k + 1)], "little") % PRIME for k in range(POINTS))


def negative(value: Residue) -> Residue:
    return tuple(-v % PRIME for v in value)


def unsigned(value: Residue) -> tuple[Residue, bool]:
    """One of value and -value, the same for both, and whether it is the other sign."""
    first = next(filter(None, value), 0)
    return (negative(value), True) if first > PRIME // 2 else (value, False)


@lru_cache(maxsize=1 << 14)
def rational(numerator: int, denominator: int) -> Residue | None:
    """A rational number's value, the same at all points; None where the prime divides the denominator."""
    if denominator % PRIME == 0:
        return None
    return (numerator * inverse(denominator % PRIME) % PRIME,) * POINTS


def as_rational(value: Residue, limit: int = 2**32) -> tuple[int, int] | None:
    """The one fraction with numerator and denominator up to `limit` that has this value, or None."""
    if value.count(value[0]) != POINTS:
        return None
    a, b, x, y = PRIME, value[0], 0, 1
    while b > limit:
        quotient = a // b
        a, b, x, y = b, a - quotient * b, y, x - quotient * y
    if y == 0 or abs(y) > limit:
        return None
    return (b, y) if y > 0 else (-b, -y)
