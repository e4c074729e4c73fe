"""Constants as they were meant: products folded in double precision, cosines of quarter turns that are not zero."""

import math
from fractions import Fraction

import casadi as ca
import pytest
from servogen.ir.lower import lower_expressions
from servogen.ir.program import Input, Program
from servogen.optimise.decimals import clean_constants

x = ca.SX.sym("x")
URDF_NOISE = math.cos(1.57079632679)


def lowered(*coefficients: float) -> Program:
    return lower_expressions("f", [(Input("x", 1), x)], [("o", ca.vertcat(*(c + x for c in coefficients)))])


def constants(program: Program) -> list[Fraction]:
    return [i.const for i in program.instrs if isinstance(i.const, Fraction)]


@pytest.mark.parametrize(
    ("written", "meant"),
    [(9.81 * 0.168, "1.64808"), (0.1 + 0.2, "0.3"), (-0.0117 * (1 + 2**-52), "-0.0117"), (3e-12 * 1.1, "3.3e-12")],
)
def test_folded_products_are_the_decimals_next_to_them(written: float, meant: str) -> None:
    program, remarks = clean_constants(lowered(written))
    assert constants(program) == [Fraction(meant)]
    assert (remarks != ()) == (Fraction(repr(written)) != Fraction(meant))


@pytest.mark.parametrize("number", [1 / 3, math.pi, 0.1 * (1 + 2**-48), 6.6743e-11, 1e-300, 1.23456789012e-10])
def test_other_numbers_stay(number: float) -> None:
    program = lowered(number)
    assert clean_constants(program) == (program, ())


@pytest.mark.parametrize(
    "noise", [math.cos(math.pi / 2), math.sin(math.pi), math.cos(3 * math.pi / 2), URDF_NOISE, math.sin(3.14159265359)]
)
def test_noise_of_a_quarter_turn_is_zero_and_told(noise: float) -> None:
    program, remarks = clean_constants(lowered(noise, 0.5))
    assert set(constants(program)) == {Fraction(0), Fraction(1, 2)}
    assert repr(noise) in remarks[0]


def test_multiples_and_powers_of_the_noise_go_with_it() -> None:
    folded = [URDF_NOISE * 0.2025, URDF_NOISE * 9.81 * 0.236, 0.3 * URDF_NOISE**2, URDF_NOISE * math.cos(math.pi / 2)]
    kept = [6.6743e-11, 1 / 3 * 1e-10, 4.32e-7]
    program, _ = clean_constants(lowered(URDF_NOISE, math.cos(math.pi / 2), *folded, *kept))
    assert sorted(set(constants(program))) == [0, *sorted(Fraction(repr(k)) for k in kept)]


def test_without_the_noise_itself_its_multiples_are_numbers_like_any_other() -> None:
    program = lowered(URDF_NOISE * (1 / 3), URDF_NOISE / 7)
    assert clean_constants(program) == (program, ())
