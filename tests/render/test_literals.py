"""Number literals: the nearest number of the type, in the shortest decimal that reads back as it."""

from fractions import Fraction

import numpy as np
import pytest
import servogen as sg
from hypothesis import example, given
from hypothesis import strategies as st
from servogen.ir.numbers import nearest
from servogen.render.literals import literal
from support.programs import examples

TINY = {"float64": Fraction(1, 2**1074), "float32": Fraction(1, 2**149)}
DIGITS = {"float64": 17, "float32": 9}


def gap_below_and_above(number: float, scalar: str) -> tuple[Fraction, Fraction]:
    """Distances to the neighbours; beyond the largest number, the gap below it."""
    kind = np.dtype(scalar).type
    with np.errstate(all="ignore"):
        below, above = (np.nextafter(kind(number), kind(to)) for to in (-np.inf, np.inf))
    low = Fraction(number) - Fraction(float(below)) if np.isfinite(below) else None
    high = Fraction(float(above)) - Fraction(number) if np.isfinite(above) else None
    return low or high or Fraction(0), high or low or Fraction(0)


def check(value: Fraction, scalar: str) -> None:
    number = nearest(value, scalar)
    kind = np.dtype(scalar).type
    assert float(kind(number)) == number
    error = Fraction(number) - value
    low, high = gap_below_and_above(number, scalar)
    assert -high / 2 <= error <= low / 2
    if abs(error) in (low / 2, high / 2) and error != 0:  # a tie goes to the even one
        bits = kind(number).view(np.uint64 if scalar == "float64" else np.uint32)
        assert int(bits) % 2 == 0


REALS = st.fractions(min_value=Fraction(-(10**6)), max_value=Fraction(10**6), max_denominator=10**12)
POWERS = st.builds(lambda m, e: Fraction(m) * Fraction(10) ** e, st.integers(-(10**18), 10**18), st.integers(-55, 18))


@pytest.mark.parametrize("scalar", ["float64", "float32"])
@examples(150)
@given(REALS | POWERS)
@example(Fraction(0))
@example(1 + Fraction(1, 2**24))  # a tie in float32
@example(1 + Fraction(3, 2**24))
@example(1 + Fraction(1, 2**24) + Fraction(1, 2**80))  # a tie only if rounded to float64 first
@example(1 + Fraction(1, 2**24) - Fraction(1, 2**80))
@example(1 + Fraction(1, 2**53))
@example(Fraction(3, 2**150))
@example(Fraction(1, 2**149))
@example(Fraction(1, 2**126) - Fraction(1, 2**150))
@example((2 - Fraction(1, 2**23)) * 2**127)
@example((2 - Fraction(1, 2**24)) * 2**127 - Fraction(1, 2**40))  # just fits float32
def test_nearest(scalar: str, value: Fraction) -> None:
    check(value, scalar)
    assert nearest(-value, scalar) == -nearest(value, scalar)


@pytest.mark.parametrize("scalar", ["float64", "float32"])
@examples(200)
@given(st.data())
def test_literals_read_back(scalar: str, data: st.DataObject) -> None:
    """Every number of the type: its literal reads back as it, and no decimal with fewer digits does."""
    number = data.draw(st.floats(allow_nan=False, allow_infinity=False, width=64 if scalar == "float64" else 32))
    text = literal(Fraction(number), scalar)
    assert text.endswith("f") == (scalar == "float32")
    body = text.removesuffix("f")
    kind = np.dtype(scalar).type
    assert kind(body) == number
    assert "." in body or "e" in body  # no integer constant
    digits = body.lstrip("-").split("e")[0].replace(".", "").strip("0")
    assert len(digits) <= DIGITS[scalar]
    if len(digits) > 1:
        with np.errstate(all="ignore"):
            shorter = kind(f"{number:.{len(digits) - 2}e}")
        assert shorter != kind(number)


@pytest.mark.parametrize(
    ("value", "double", "single"),
    [
        (Fraction(0), "0.0", "0.0f"),
        (Fraction(1), "1.0", "1.0f"),
        (Fraction(-5, 2), "-2.5", "-2.5f"),
        (Fraction(1, 10), "0.1", "0.1f"),
        (Fraction(1, 3), "0.3333333333333333", "0.33333334f"),
        (Fraction(10) ** 20, "1e+20", "1.0e+20f"),
        (Fraction(1, 10**20), "1e-20", "1.0e-20f"),
        (Fraction(16777217), "16777217.0", "16777216.0f"),
        (Fraction(1, 2**149), "1.401298464324817e-45", "1.0e-45f"),
    ],
)
def test_how_they_look(value: Fraction, double: str, single: str) -> None:
    assert literal(value, "float64") == double
    assert literal(value, "float32") == single


@pytest.mark.parametrize(
    ("value", "scalar"),
    [
        (Fraction(10) ** 39, "float32"),
        (-(Fraction(10) ** 39), "float32"),
        ((2 - Fraction(1, 2**24)) * 2**127, "float32"),
        (Fraction(10) ** 309, "float64"),
        (Fraction(10) ** 4000, "float64"),
        (Fraction(10) ** 4000, "float32"),
    ],
)
def test_too_large(value: Fraction, scalar: str) -> None:
    with pytest.raises(sg.SceneError, match=rf"the constant .* is too large for {scalar}.*rescale"):
        literal(value, scalar)


@pytest.mark.parametrize(
    ("value", "scalar"),
    [(Fraction(1, 10**46), "float32"), (Fraction(1, 10**324), "float64"), (Fraction(-1, 10**4000), "float64")],
)
def test_vanishing(value: Fraction, scalar: str) -> None:
    with pytest.raises(sg.SceneError, match=rf"the constant .* vanishes in {scalar}.*rescale"):
        literal(value, scalar)


def test_the_smallest_do_not_vanish() -> None:
    for scalar, tiny in TINY.items():
        assert nearest(tiny, scalar) == float(tiny)
        assert nearest(tiny * Fraction(51, 100), scalar) == float(tiny)
        assert nearest(tiny / 2, scalar) == 0  # the tie goes to the even one
