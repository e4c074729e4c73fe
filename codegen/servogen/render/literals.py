"""Number literals: the shortest decimal that reads back as the nearest number of the target type."""

from fractions import Fraction

import numpy as np

from servogen.errors import SceneError
from servogen.ir.numbers import nearest


def literal(value: Fraction | float, scalar: str) -> str:
    """A C literal, with the suffix f in float32. SceneError where the number does not fit the type."""
    number = nearest(value, scalar)
    if not np.isfinite(number):
        raise SceneError(f"the constant {_shown(value)} is too large for {scalar}; rescale what it belongs to")
    if number == 0 and value != 0:
        raise SceneError(f"the constant {float(value)!r} vanishes in {scalar}; rescale the quantity it belongs to")
    if scalar == "float64":
        return repr(number)
    text = np.format_float_positional(np.float32(number), trim="0")
    if len(text) > 14:
        text = np.format_float_scientific(np.float32(number), trim="0", exp_digits=1)
    return f"{text}f"


def _shown(value: Fraction | float) -> str:
    try:
        return repr(float(value))
    except OverflowError:
        return "beyond 1.8e308"
