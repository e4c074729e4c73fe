"""The two number types of generated C."""

from typing import Literal

Scalar = Literal["float64", "float32"]

EPSILON: dict[Scalar, float] = {"float64": 2.0**-52, "float32": 2.0**-23}
"""eps, the distance from 1 to the next number (numerics.md: Notation)."""
