"""Every number in the templates of math/: own sine, cosine and square root (numerics.md: Bit for bit).

Constants of pi are derived here; the polynomials' coefficients are derived by `minimax.py`, and a test repeats it.
The angle is x = k pi/2 + hi + lo. Up to `near` the multiple of pi/2 is taken off in parts (Cody and Waite 1980): the
first parts are so short that their products with k are exact. Beyond, the fraction of 2/pi x is computed with integers
(Payne and Hanek 1983), in bounded work for every finite number.
"""

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from typing import Any

import mpmath as mp

from servogen.ir.numbers import as_fraction, nearest
from servogen.render.literals import literal

SCALARS = ("float64", "float32")
TERMS = {"float64": 6, "float32": 3}
"""Coefficients of each polynomial."""

SINE = {
    "float64": (
        -0.1666666666666663,
        0.008333333333321931,
        -0.00019841269829472141,
        2.7557313587657125e-06,
        -2.505074322341839e-08,
        1.5895998096090317e-10,
    ),
    "float32": (-0.16666655242443085, 0.008332189172506332, -0.0001951829035533592),
}
COSINE = {
    "float64": (
        0.041666666666666595,
        -0.0013888888888873342,
        2.4801587289002096e-05,
        -2.7557314217049263e-07,
        2.08757053981268e-09,
        -1.1358749379075819e-11,
    ),
    "float32": (0.04166664555668831, -0.0013887311797589064, 2.443276571284514e-05),
}
POLYNOMIAL_ERROR = {"float64": (2.0**-57.8, 2.0**-63.8), "float32": (2.0**-27.8, 2.0**-32.9)}
"""Largest relative error that the polynomials leave in (sine, cosine) on [-pi/4, pi/4]."""

LARGEST_ERROR = 1.0
"""ulps: the claim for sine and cosine at every finite argument, in both scalars. The tests hold the C to it."""

NEAR = {"float64": 2.0**20, "float32": 2.0**8}
"""Arguments up to here are reduced by parts of pi/2, those beyond by integers."""


@dataclass(frozen=True)
class _Shape:
    """How wide things are in one scalar."""

    digits: int  # of the significand
    part: int  # bits of each short part of pi/2: its product with any k is exact
    words: int  # 32-bit words of the window of 2/pi
    lead: int  # zero words before 2/pi in the table
    split: int  # low bits cleared to halve a significand


_SHAPES = {"float64": _Shape(53, 33, 6, 2, 27), "float32": _Shape(24, 16, 3, 1, 12)}


def pi_parts(scalar: str, count: int) -> tuple[Fraction, ...]:
    """pi/2 as `count` numbers that sum to it: all but the last with few bits, the last a full one."""
    shape = _SHAPES[scalar]
    rest = _half_pi()
    parts = []
    for k in range(count - 1):
        unit = Fraction(2) ** (1 - shape.part * (k + 1))  # pi/2 lies between 1 and 2
        parts.append(Fraction(rest // unit) * unit)
        rest -= parts[-1]
    return (*parts, Fraction(nearest(rest, scalar)))


def two_over_pi_words(scalar: str) -> tuple[int, ...]:
    """2/pi as 32-bit words, most significant first, behind words of zero: as many as the largest number needs."""
    shape = _SHAPES[scalar]
    largest_exponent = {"float64": 971, "float32": 104}[scalar]  # of the last bit of the largest number
    count = (largest_exponent - 2 + 32 * shape.lead) // 32 + shape.words + 1 - shape.lead
    scaled = int(1 / _half_pi() * 2 ** (32 * count))
    words = [(scaled >> 32 * (count - 1 - k)) & 0xFFFFFFFF for k in range(count)]
    return (0,) * shape.lead + tuple(words)


@cache
def math_context(scalar: str) -> dict[str, Any]:
    """What the templates math/*.c.j2 name."""
    shape = _SHAPES[scalar]
    lit: Callable[[Any], str] = lambda value: literal(value, scalar)  # noqa: E731
    half_pi = nearest(_half_pi(), scalar)
    clear = (1 << shape.split) - 1
    top = _number(_bits(half_pi, scalar) & ~clear, scalar)
    words = two_over_pi_words(scalar)
    width = 64 if scalar == "float64" else 32
    return {
        "bits": width,
        "sine": [lit(-c) for c in SINE[scalar]],  # of r - sin(r)
        "cosine": [lit(c) for c in COSINE[scalar]],
        "short": [lit(c) for c in pi_parts(scalar, 2 if scalar == "float64" else 3)],
        "long": [lit(c) for c in pi_parts(scalar, 4)],
        "two_over_pi": lit(1 / _half_pi()),
        "round": lit(1.5 * 2.0 ** (shape.digits - 1)),
        "quarter": _hex(nearest(_half_pi() / 2, scalar), scalar),
        "near": _hex(NEAR[scalar], scalar),
        "near_text": f"2^{int(mp.log(NEAR[scalar], 2))}",
        "words": words,
        "word_lines": [", ".join(f"0x{w:08x}u" for w in words[k : k + 8]) for k in range(0, len(words), 8)],
        "count": shape.words,
        "first": 32 * shape.lead - 2,
        "half_pi": lit(half_pi),
        "half_pi_top": lit(top),
        "half_pi_rest": lit(half_pi - top),
        "half_pi_low": lit(_half_pi() - Fraction(half_pi)),
        "halve": _unsigned(~clear & ((1 << width) - 1), scalar),
        "polynomial_error": " and ".join(f"2^{math.log2(e):.1f}" for e in POLYNOMIAL_ERROR[scalar]),
        "one": lit(1.0),
        "half": lit(0.5),
        "zero": lit(0.0),
        "power": lambda k: lit(Fraction(2) ** k),
    }


@cache
def _half_pi() -> Fraction:
    """pi/2 to 1500 bits."""
    with mp.workprec(1500):
        return as_fraction(mp.pi / 2)


def _bits(value: float, scalar: str) -> int:
    pattern, whole = ("<d", "<Q") if scalar == "float64" else ("<f", "<I")
    return int(struct.unpack(whole, struct.pack(pattern, value))[0])


def _number(bits: int, scalar: str) -> float:
    pattern, whole = ("<d", "<Q") if scalar == "float64" else ("<f", "<I")
    return float(struct.unpack(pattern, struct.pack(whole, bits))[0])


def _hex(value: float, scalar: str) -> str:
    """The bits of a number as an unsigned C constant."""
    return _unsigned(_bits(value, scalar), scalar)


def _unsigned(bits: int, scalar: str) -> str:
    return f"UINT64_C(0x{bits:016x})" if scalar == "float64" else f"UINT32_C(0x{bits:08x})"
