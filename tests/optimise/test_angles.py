"""Quarter turns written as decimals are read as what they mean, and said; nothing else is."""

import math
from fractions import Fraction
from typing import Any

import casadi as ca
import pytest
from servogen.ir.lower import lower_expressions
from servogen.ir.program import Input, Program
from servogen.optimise.angles import quarter_turns, snap_quarter_turns
from servogen.optimise.passes import optimise
from support.programs import same_to_50_digits

x, y = ca.SX.sym("x"), ca.SX.sym("y")
LEAVES = [(Input("x", 1), x), (Input("y", 1), y)]


def lowered(expression: Any) -> Program:
    return optimise(lower_expressions("f", LEAVES, [("o", expression)]))


MEANT = {
    "sin(x + pi/2)": (ca.sin(x + math.pi / 2), ca.cos(x)),
    "cos(x + pi/2)": (ca.cos(x + math.pi / 2), -ca.sin(x)),
    "cos(pi/2 - x)": (ca.cos(math.pi / 2 - x), ca.sin(x)),
    "sin(x - pi)": (ca.sin(x - math.pi), -ca.sin(x)),
    "eleven digits": (ca.sin(x + 1.57079632679), ca.cos(x)),
    "twice": (ca.sin((x + math.pi / 2) + (y + math.pi / 2)), -ca.sin(x + y)),
    "three quarters": (ca.cos(x - 4.71238898038469), -ca.sin(x)),
}


@pytest.mark.parametrize("name", MEANT)
def test_a_quarter_turn_is_exact_and_noted(name: str) -> None:
    written, meant = MEANT[name]
    program, remarks = snap_quarter_turns(lowered(written))
    states = {"x": [[0.3], [1.7]], "y": [[-0.4], [0.9]]}
    same_to_50_digits(lowered(meant), optimise(program), states)
    assert remarks


@pytest.mark.parametrize("shift", [1e-9, 1.5707963, 1.571, 0.5, 100.0])
def test_other_angles_stay(shift: float) -> None:
    program = lowered(ca.sin(x + shift))
    assert snap_quarter_turns(program) == (program, ())


def test_turns() -> None:
    assert [quarter_turns(Fraction(math.pi / 2 * k)) for k in (-3, -1, 0, 1, 2, 7)] == [-3, -1, 0, 1, 2, 7]
