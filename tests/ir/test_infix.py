"""Formulas in comments say what the program computes."""

import casadi as ca
import numpy as np
import pytest
from servogen.ir.evaluate import evaluate
from servogen.ir.infix import infix
from servogen.ir.lower import lower_expressions
from servogen.ir.program import Input

a, b, c = ca.SX.sym("a"), ca.SX.sym("b"), ca.SX.sym("c", 2)
INPUTS = [(Input("a", 1), a), (Input("b", 1), b), (Input("c", 2), c)]


@pytest.mark.parametrize(
    "expression",
    [a - (b - a), (a - b) - a, a / (b / a), a * (a + b), -(a + b) * b, a**2 - b**2, ca.sin(a) / (2.5 * c[1]), -a / -b],
)
def test_a_formula_evaluates_to_the_value(expression):
    program = lower_expressions("f", INPUTS, [("f", expression)])
    values = {"a": [[1.7]], "b": [[-0.6]], "c": [[0.3, 2.2]]}
    text = infix(program, program.outputs[0].nodes[0])
    known = {"a": 1.7, "b": -0.6, "c": [0.3, 2.2], "sin": np.sin}
    assert eval(text.replace("^", "**"), {}, known) == pytest.approx(evaluate(program, values)["f"].item(), rel=1e-15)


def test_what_is_too_long_is_left_out():
    expression = a
    for _ in range(200):  # two to the 200 characters, were it written out
        expression = expression * expression + b
    program = lower_expressions("f", INPUTS, [("f", expression)])
    assert infix(program, program.outputs[0].nodes[0]) == ""
