"""What parameters alone decide is simplified by itself, to the same values."""

import casadi as ca
import numpy as np
from servogen.compiler import optimised_scene
from servogen.ir.evaluate import evaluate
from servogen.ir.lower import lower_expressions
from servogen.ir.program import Input
from servogen.loading import load_scene
from servogen.optimise.early import early_part
from servogen.optimise.search import search
from servogen.plan.stage import stage


def test_terms_that_cancel_in_prepare_are_gone():
    """Spacecraft: each coefficient of Euler's equations is one difference of inertias."""
    prepare = stage(optimised_scene(load_scene("spacecraft"))[1].program).prepare
    assert prepare.operations() == {"total": 3, "sub": 3}


def test_values_of_parameters_stay_what_they_were():
    a, b, x = ca.SX.sym("a"), ca.SX.sym("b"), ca.SX.sym("x")
    coefficient = a - b - 2 * a * b / b + 2 * b * a / b + ca.sin(a) * b + ca.sin(a) * a
    inputs = [(Input("a", 1, "parameter"), a), (Input("b", 1, "parameter"), b), (Input("x", 1), x)]
    program = lower_expressions("test", inputs, [("f", coefficient * x), ("g", a * b + a)])
    found = search(program).program
    part = early_part(found)
    assert part is not None
    assert part.operations()["total"] <= 7 < early_part(program).operations()["total"]
    states = {name: np.random.default_rng(1).uniform(0.5, 2, (50, 1)) for name in "abx"}
    for name in "fg":
        np.testing.assert_allclose(evaluate(found, states)[name], evaluate(program, states)[name], rtol=1e-13)


def test_a_program_without_parameters_has_no_such_part():
    x = ca.SX.sym("x")
    assert early_part(lower_expressions("test", [(Input("x", 1), x)], [("f", x * x)])) is None
