"""Semantic value numbering: hidden identities are found, near-identities are not."""

from fractions import Fraction
from typing import Any

import casadi as ca
import pytest
from hypothesis import given
from hypothesis import strategies as st
from servogen.ir.field import PRIME, as_rational, rational
from servogen.ir.lower import lower_expressions
from servogen.ir.program import Input, Instr, Output, Program, check_legal
from servogen.optimise.fingerprint import Fingerprints
from servogen.optimise.passes import optimise
from servogen.optimise.value_numbering import FALSE_EQUALITY, number_values
from support.programs import TAME, examples, programs, random_states, same_to_50_digits

x, y, z = (ca.SX.sym(name) for name in "xyz")
LEAVES = [(Input("x", 1), x), (Input("y", 1), y), (Input("z", 1), z)]


def numbered(*expressions: Any) -> Program:
    outputs = [(f"o{k}", ca.SX(e)) for k, e in enumerate(expressions)]
    return optimise(number_values(optimise(lower_expressions("f", LEAVES, outputs))))


def same(a: Any, b: Any) -> bool:
    """Whether two expressions become one value."""
    program = numbered(a, b)
    return program.output("o0").nodes == program.output("o1").nodes


EQUAL = {
    "associativity": ((x + y) + z, x + (y + z)),
    "distributivity": ((x + y) * z, x * z + y * z),
    "binomial": ((x + y) * (x - y), x * x - y * y),
    "cancelled": (x + y - x, y),
    "cancelled product": (x * y / x, y),
    "fraction": (x / y + z / y, (x + z) / y),
    "reciprocal": (x * (1 / y), x / y),
    "decimal": (0.1 * x + 0.2 * x, 0.3 * x),
    "pythagoras": (ca.sin(x) ** 2 + ca.cos(x) ** 2, 1),
    "pythagoras of a product": (ca.sin(x * y) ** 2 + ca.cos(y * x) ** 2, 1),
    "sine of a difference": (ca.sin(x - y), ca.sin(x) * ca.cos(y) - ca.cos(x) * ca.sin(y)),
    "cosine of a sum": (ca.cos(x + y), ca.cos(x) * ca.cos(y) - ca.sin(x) * ca.sin(y)),
    "double angle": (ca.sin(2 * x), 2 * ca.sin(x) * ca.cos(x)),
    "half angle": (ca.cos(x), 1 - 2 * ca.sin(x / 2) ** 2),
    "triple angle": (ca.sin(3 * x), 3 * ca.sin(x) - 4 * ca.sin(x) ** 3),
    "decimal multiples": (ca.sin(0.3 * x), ca.sin(0.1 * x) * ca.cos(0.2 * x) + ca.cos(0.1 * x) * ca.sin(0.2 * x)),
    "negative angle": (ca.cos(x - y), ca.cos(y - x)),
    "tangent": (ca.tan(x) * ca.cos(x), ca.sin(x)),
    "opaque, equal operands": (ca.exp((x + y) ** 2), ca.exp(x * x + 2 * x * y + y * y)),
    "absolute value is even": (ca.fabs(x - y), ca.fabs(y - x)),
    "odd function": (ca.atan(x - y) + ca.atan(y - x), 0),
    "power": (x**3, x * x * x),
}

DIFFERENT = {
    "root of a square": (ca.sqrt(x * x), x),
    "absolute value": (ca.fabs(x), x),
    "square of a root": (ca.sqrt(x) ** 2, ca.fabs(x)),
    "last digit": (x * 0.1, x * 0.100000000000001),
    "neighbouring doubles": (x + 0.3, x + 0.30000000000000004),
    "tiny shift of an angle": (ca.sin(x), ca.sin(x + 1e-9)),
    "tiny stretch of an angle": (ca.cos(x), ca.cos(x * (1 + 1e-12))),
    "arcsine": (ca.asin(ca.sin(x)), x),
    "arctangent": (ca.atan2(ca.sin(x), ca.cos(x)), x),
    "minimum": (ca.fmin(x, y), x),
    "minimum and maximum": (ca.fmin(x, y), ca.fmax(x, y)),
    "power of two variables": (ca.power(x, y), ca.power(y, x)),
    "real power": (ca.power(x, 2.0000001), x * x),
    "exponential": (ca.exp(x), 1 + x + x * x / 2),
    "sign": (ca.sign(x) * x, x),
    "branches": (ca.if_else(x > 0, y, z), ca.if_else(x > 0, z, y)),
    "conditions": (ca.if_else(x > 0, y, z), ca.if_else(x >= 0, y, z)),
    "difference of close decimals": (x * (0.1 + 1e-15) - x * 0.1, 0),
}


@pytest.mark.parametrize("name", EQUAL)
def test_equal_expressions_are_one(name: str) -> None:
    assert same(*EQUAL[name])


@pytest.mark.parametrize("name", DIFFERENT)
def test_different_expressions_stay_different(name: str) -> None:
    assert not same(*DIFFERENT[name])


def test_zero_and_constants_are_found() -> None:
    program = numbered((x + y) ** 2 - x**2 - 2 * x * y - y**2, (x + 1) ** 2 - x * (x + 2) + 0.5)
    constants = [program.instrs[o.nodes[0]].const for o in program.outputs]
    assert constants == [0, Fraction(3, 2)]


def test_the_negative_of_a_value_is_its_sign_flip() -> None:
    program = numbered((x - y) * z, y * z - x * z)
    assert program.operations()["total"] == 2


def test_a_solve_whose_answer_is_there_disappears() -> None:
    A = ca.vertcat(ca.horzcat(2 + x * x, y), ca.horzcat(y, 3 + z * z))
    given = ca.vertcat(x + 1, y - z)
    right = ca.mtimes(A, given)
    factor = A[1, 0] / A[0, 0]
    second = (right[1] - factor * right[0]) / (A[1, 1] - factor * A[0, 1])
    first = (right[0] - A[0, 1] * second) / A[0, 0]
    program = numbered(first, second)
    assert "div" not in program.operations()
    assert program.operations()["total"] == 2


def test_no_hazard_is_gained() -> None:
    """x y / x may become y, but y never becomes x y / x, and a guarded quotient stays guarded."""
    program = numbered(ca.if_else(ca.fabs(x) > 1e-9, ca.sin(x) / x, 0), ca.sin(x) / x * z)
    assert program.operations()["if_else_zero"] == 1
    instrs = (
        Instr("input", (), ("x", 0)),
        Instr("input", (), ("y", 0)),
        Instr("mul", (0, 1)),
        Instr("div", (2, 0)),  # y, but for x = 0
        Instr("sin", (3,)),
        Instr("sin", (1,)),
    )
    inputs = (Input("x", 1), Input("y", 1))
    whole = check_legal(Program("f", inputs, instrs, (Output("a", 1, 1, (4,)), Output("b", 1, 1, (5,)))))
    assert "div" not in number_values(whole).operations()
    costly = Program("f", inputs, instrs[:4], (Output("a", 1, 1, (3,)), Output("b", 1, 1, (1,))))
    assert number_values(costly).output("b").nodes == number_values(costly).output("a").nodes


def test_division_by_an_identical_zero_is_opaque() -> None:
    instrs = (
        Instr("input", (), ("x", 0)),
        Instr("sub", (0, 0)),
        Instr("div", (0, 1)),
        Instr("mul", (2, 1)),
    )
    program = Program("f", (Input("x", 1),), instrs, (Output("a", 1, 1, (3,)),))
    values = Fingerprints(program).values
    assert not any(values[1])
    assert any(values[2])


def test_the_bound_on_false_equality_holds_and_is_respected() -> None:
    square = x + y
    for _ in range(8):
        square = square * square + z
    good = Fingerprints(optimise(lower_expressions("f", LEAVES, [("o", square)])))
    assert good.false_equality(20_000) < FALSE_EQUALITY
    for _ in range(120):
        square = square * square
    program = optimise(lower_expressions("f", LEAVES, [("o", square), ("p", square * 1.0 + x - x)]))
    assert Fingerprints(program).false_equality(10) == 1.0
    assert number_values(program) == program


@given(st.integers(-(2**32), 2**32), st.integers(1, 2**32))
@examples(100)
def test_constants_come_back_from_their_residues(numerator: int, denominator: int) -> None:
    value = rational(numerator, denominator)
    assert value is not None
    found = as_rational(value)
    assert found is not None
    assert Fraction(*found) == Fraction(numerator, denominator)
    assert PRIME > 2 * 2**80


@given(programs(ops=TAME, most=20), st.integers(0, 5))
@examples(150)
def test_random_programs_keep_their_meaning(program: Program, seed: int) -> None:
    same_to_50_digits(program, check_legal(number_values(program)), random_states(seed))


@given(programs(ops=("add", "sub", "mul", "div", "sin", "cos", "sqrt"), most=25), st.integers(0, 5))
@examples(150)
def test_random_quotients_keep_their_meaning(program: Program, seed: int) -> None:
    same_to_50_digits(program, check_legal(number_values(optimise(program))), random_states(seed))
