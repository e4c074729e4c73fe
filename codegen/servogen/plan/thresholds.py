"""The numbers that a solver compares with: certificates, ranges in which nothing needs scaling, caps (numerics.md:
Certificates)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from servogen.scalars import BITS, Scalar

SWEEP_CAPS = ((2, 5), (3, 7), (6, 10), (12, 12))
"""(min(m, l) up to, sweeps): at least two above the worst ever measured; NOT_CONVERGED stands behind them."""

ROUNDING = 4
"""eps times ROUNDING times the vectors' length covers the rounding of a product or a Gram-Schmidt (numerics.md:
Certificates)."""

NORMAL_SHARE = 1.0
"""NORMAL holds up to bound = NORMAL_SHARE eps^(-2/3), kappa about 1e5 in float64 and 2e2 in float32."""

CONSISTENCY = 8
"""A row is met when its residual is below CONSISTENCY max(m, l) eps (|S_i| (|tau| + |y|) + |z_i|), a backward error."""


@dataclass(frozen=True)
class RowRange:
    """Where the unscaled closed form of a row is safe, and gives the same bits as the scaled one.

    Outside (and at NaN, infinity, zero, atol and damping, which all fall outside) the scaled form takes over. A square
    and a task in range lie 0 to span above their lowest, span a power of two less one: so one comparison does for both.
    """

    square_low: int  # of s s^T, twice the biased exponent: half as many binades
    square_floor: int | None  # the same, below which s may be zero or damped; None where square_low is above it
    task_low: int  # of z - s y, biased exponent
    task_high: int
    span: int
    tau_low: int  # of tau tau^T where noise may be all that tau is, biased exponent
    tau_high: int


def certificates(m: int, l: int, eps: float, rtol: float) -> dict[str, Any]:
    """Limits of the certificates (numerics.md: Certificates), with margins for the rounding of the bound itself."""
    total = 4 * m  # above the squared norm of S with the length of each row in [1, 2)
    rounding = ROUNDING * l * min(m, l) * eps
    # refined once, NORMAL's error is (eps bound)^2 + eps kappa: accepted where the first is the smaller
    accurate = NORMAL_SHARE * eps ** (-2 / 3)
    safe = 0.875 / (rounding + total * rtol**2)
    normal_limit = min(accurate, safe)
    qr_margin = rtol + ROUNDING * max(m, l) * eps
    return {
        "smallest_square": 2.0**-900 if eps < 2.0**-40 else 2.0**-110,
        "lift": 1.0 if eps < 2.0**-40 else 2.0**20,
        "normal_limit": normal_limit,
        "normal_floor": 1 / normal_limit,
        "normal_rounding": rounding,
        "rtol_square": rtol**2,
        "qr_rounding": ROUNDING * max(m, l) * eps,
        "qr_margin": qr_margin,
        "qr_limit": 0.875 / qr_margin**2,
        "least_rounding": (ROUNDING * max(m, l) + 0.51 * (min(m, l) - 2)) * eps,
        "least_share": 1 - min(m, l) * (min(m, l) + 4) * eps,
    }


def ranges(scalar: Scalar, l: int, atol: Sequence[float]) -> dict[str, Any]:
    """Biased exponents within which nothing needs scaling: products that underflow are far below half an ulp.

    Rows that may be within their atol are outside.
    """
    square, low, high = (470, -1000, 900) if scalar == "float64" else (40, -100, 110)
    bias = BITS[scalar].bias
    never = 2 * (bias + 1)
    lows = [max(-square, _square_above(math.sqrt(l) * a)) for a in atol]
    return {
        "square_ranges": tuple((bias + a, bias + square) if a <= square else (never, never) for a in lows),
        "answer_range": (bias + low, bias + high),
    }


def _square_above(bound: float) -> int:
    """The exponent from which on s s^T is above bound^2. As max|s|^2 >= s s^T / l, bound is sqrt(l) atol for a row."""
    return 2 * math.frexp(bound)[1] + 1 if bound > 0 else -(2**30)


def range_of_a_row(l: int, atol: float, damping: float | None, scalar: Scalar) -> RowRange | None:
    """Exponents chosen so that no product that matters underflows and no sum overflows.

    Squares from 2^-a to below 2^a, tasks from 2^-2a and steps of refinement to below 2^2a: then |tau - y| <= 2^(5a/2)
    is below half an ulp of the largest number, and products that underflow are below half an ulp of any sum they enter
    that matters: only a chain of ties, each 24 bits above the last, can carry such a rounding up to a float32 task, by
    half an ulp of it. Squares of tau in 2^+-c, times s s^T, neither overflow nor become subnormal.
    """
    a, c = (256, 760) if scalar == "float64" else (32, 90)
    # above these the row is neither zero nor damped
    floor = max(_square_above(math.sqrt(l) * atol), _square_above(damping or 0.0))
    if floor >= a:
        return None
    bias = BITS[scalar].bias
    return RowRange(
        square_low=2 * (bias - a),
        square_floor=2 * (bias + floor) if floor > -a else None,
        task_low=bias - 2 * a,
        task_high=bias + 2 * a - 1,
        span=4 * a - 1,
        tau_low=bias - c,
        tau_high=bias + c,
    )
