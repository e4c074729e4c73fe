"""Balls hold the number they are made of, and nothing is lost on the way in or out."""

from fractions import Fraction

import flint
import numpy as np
import pytest
from servogen.ir.balls import NAN, all_finite, ball, balls, middle, total, working


@pytest.mark.parametrize("value", [10**30 + 1, np.int64(2**62 + 1), 0.1, np.float32(0.1), -(2.0**-1074), True])
def test_numbers_of_finitely_many_bits_are_exact(value: float) -> None:
    made = ball(value)
    assert made.is_exact()
    assert middle(made) == Fraction(int(value) if isinstance(value, int | np.integer) else float(value))
    assert ball(made) is made


def test_a_fraction_lies_within_its_ball() -> None:
    with working():
        third = ball(Fraction(1, 3))
        assert not third.is_exact()
        assert third.overlaps(flint.arb(flint.fmpq(1, 3)))
        assert abs(middle(third) - Fraction(1, 3)) < Fraction(1, 2**199)
        assert middle(total(balls([0.25, Fraction(1, 2), 2]))) == Fraction(11, 4)


def test_what_is_no_number() -> None:
    assert not all_finite([ball(1.0)], [NAN])
    with pytest.raises(ValueError, match=r"finite|infinity|nan"):
        middle(NAN)
    with pytest.raises(TypeError):
        ball(1j)
