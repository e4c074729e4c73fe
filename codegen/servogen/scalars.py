"""The two number types of generated C, and how their bits lie."""

from typing import Literal, NamedTuple

Scalar = Literal["float64", "float32"]

EPSILON: dict[Scalar, float] = {"float64": 2.0**-52, "float32": 2.0**-23}
"""eps, the distance from 1 to the next number (numerics.md: Notation)."""


class Bits(NamedTuple):
    """The layout of a scalar type, as C text where C needs text; templates read it by name."""

    uint: str  # unsigned integer of the same size
    mantissa: int  # bits of the fraction
    bias: int
    magnitude: str  # mask of everything but the sign
    infinity: str  # bits of +infinity: magnitudes at or above it are not finite
    smallest_normal: str  # bits of the smallest normal number
    highest: int  # largest k for which 2^k is finite
    lowest: int  # smallest k for which 2^k is normal
    lift: int  # 2^lift makes every subnormal normal
    none: int  # stands for the exponent of zero: below all exponents and sums of two


BITS: dict[Scalar, Bits] = {
    "float64": Bits(
        "uint64_t",
        52,
        1023,
        "UINT64_C(0x7fffffffffffffff)",
        "UINT64_C(0x7ff0000000000000)",
        "UINT64_C(0x0010000000000000)",
        1023,
        -1022,
        64,
        -16384,
    ),
    "float32": Bits(
        "uint32_t",
        23,
        127,
        "UINT32_C(0x7fffffff)",
        "UINT32_C(0x7f800000)",
        "UINT32_C(0x00800000)",
        127,
        -126,
        32,
        -16384,
    ),
}
