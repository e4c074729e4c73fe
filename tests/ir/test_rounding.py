"""The rounding bounds are bounds, and not absurdly loose."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from servogen.ir.balls import ball
from servogen.ir.evaluate import evaluate, evaluate_exactly
from servogen.ir.program import Input, Instr, Output, Program
from servogen.ir.rounding import rounding_bounds
from support.programs import examples, programs

ARITHMETIC = ("add", "sub", "mul", "neg", "fabs", "fmin", "fmax")
SMOOTH = ("add", "sub", "mul", "neg", "sin", "cos", "atan", "tanh", "exp")


def states_in(scalar: str, seed: int) -> dict[str, Any]:
    """Inputs that are numbers of the scalar type."""
    rng = np.random.default_rng(seed)
    sizes = {"p": 2, "x": 3, "k": 1}
    return {name: rng.uniform(-1.5, 1.5, (3, size)).astype(scalar).astype(float) for name, size in sizes.items()}


def errors(program: Program, states: dict[str, Any], scalar: str) -> dict[str, np.ndarray]:
    """|value in the scalar type - 50-digit value| of every output: arrays (N, size)."""
    values = evaluate(program, states, np.dtype(scalar).type)
    found: dict[str, list[list[float]]] = {o.name: [] for o in program.outputs}
    for n, exact in enumerate(evaluate_exactly(program, states)):
        for name, entries in exact.items():
            got = values[name][n].ravel()
            found[name].append([float(abs(ball(g) - t)) for g, t in zip(got, entries, strict=True)])
    return {name: np.array(rows) for name, rows in found.items()}


@pytest.mark.parametrize("scalar", ["float64", "float32"])
@examples(60)
@given(programs(ops=ARITHMETIC, most=12), st.integers(0, 2**32 - 1))
def test_arithmetic_keeps_to_its_bound(scalar: str, program: Program, seed: int) -> None:
    states = states_in(scalar, seed)
    bounds = rounding_bounds(program, states, scalar)
    tiny = 1e-15 if scalar == "float32" else 1e-30  # second order: products of errors
    for name, error in errors(program, states, scalar).items():
        scale = 1 + np.abs(evaluate(program, states)[name].reshape(error.shape))
        assert np.all(error <= 1.01 * bounds[name] + tiny * scale**2), (name, error, bounds[name])


@pytest.mark.parametrize("scalar", ["float64", "float32"])
@examples(50)
@given(programs(ops=SMOOTH, most=8), st.integers(0, 2**32 - 1))
def test_functions_keep_to_their_bound(scalar: str, program: Program, seed: int) -> None:
    """numpy's functions claim less than the C library's: up to four units of a function's value are allowed each."""
    states = states_in(scalar, seed)
    values = evaluate(program, states)
    assume(all(np.all(np.abs(v) <= 1e3) for v in values.values()))
    bounds = rounding_bounds(program, states, scalar)
    for name, error in errors(program, states, scalar).items():
        assert np.all(error <= 4.04 * bounds[name] + 1e-5 * bounds[name].max() + 1e-18), (name, error, bounds[name])


@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_the_bound_is_not_absurdly_loose(scalar: str) -> None:
    """The largest error of many states comes near the bound: within 3 for one product, 20 for a sum of 8."""
    rng = np.random.default_rng(0)
    states = {"x": rng.uniform(1, 2, (400, 16)).astype(scalar).astype(float)}
    leaves = tuple(Instr("input", (), ("x", k)) for k in range(16))
    product = Program("f", (Input("x", 16),), (*leaves, Instr("mul", (0, 1))), (Output("o", 1, 1, (16,)),))
    instrs = list(leaves) + [Instr("mul", (2 * k, 2 * k + 1)) for k in range(8)]
    total = 16
    for k in range(17, 24):
        instrs.append(Instr("add", (total, k)))
        total = len(instrs) - 1
    dot = Program("f", (Input("x", 16),), tuple(instrs), (Output("o", 1, 1, (total,)),))
    for program, factor in ((product, 3.0), (dot, 20.0)):
        error = errors(program, states, scalar)["o"]
        bound = rounding_bounds(program, states, scalar)["o"]
        assert np.all(error <= 1.0001 * bound)
        assert error.max() >= bound.max() / factor


def test_cancellation_shows_in_the_bound() -> None:
    """(x + 1e8) - 1e8: the answer is x, the bound is that of 1e8."""
    instrs = (
        Instr("input", (), ("x", 0)), Instr("const", (), Fraction(10**8)), Instr("add", (0, 1)), Instr("sub", (2, 1))
    )  # fmt: skip
    program = Program("f", (Input("x", 1),), instrs, (Output("o", 1, 1, (3,)),))
    bound = rounding_bounds(program, {"x": [[0.1]]}, "float64")["o"][0, 0]
    assert 0.5e8 * 2.0**-53 < bound < 4e8 * 2.0**-52


def test_exact_things_have_no_error() -> None:
    instrs = (
        Instr("input", (), ("x", 0)),
        Instr("const", (), Fraction(1, 2)),
        Instr("neg", (0,)),
        Instr("fmax", (1, 2)),
    )
    program = Program("f", (Input("x", 1),), instrs, (Output("o", 4, 1, (0, 1, 2, 3)),))
    assert np.all(rounding_bounds(program, {"x": [[0.3], [-7.0]]}, "float32")["o"] == 0)


def test_powers_of_two_are_exact_but_among_subnormals() -> None:
    instrs = (
        Instr("input", (), ("x", 0)),
        Instr("const", (), Fraction(-1, 4)),
        Instr("const", (), Fraction(3, 4)),
        Instr("mul", (0, 1)),
        Instr("div", (0, 1)),
        Instr("add", (0, 0)),
        Instr("mul", (0, 2)),
        Instr("div", (1, 0)),
    )
    program = Program("f", (Input("x", 1),), instrs, (Output("o", 5, 1, (3, 4, 5, 6, 7)),))
    bounds = rounding_bounds(program, {"x": [[0.3]]}, "float32")["o"][0]
    assert np.all(bounds[:3] <= float(np.finfo("float32").smallest_subnormal))
    assert np.all(bounds[3:] >= 1e-9)


def test_constants_are_rounded_to_the_scalar() -> None:
    program = Program("f", (), (Instr("const", (), Fraction(1, 10)),), (Output("o", 1, 1, (0,)),))
    for scalar, dtype in (("float64", np.float64), ("float32", np.float32)):
        error = abs(Fraction(float(dtype(0.1))) - Fraction(1, 10))
        assert rounding_bounds(program, {}, scalar)["o"][0, 0] == pytest.approx(float(error))
    huge = Program("f", (), (Instr("const", (), Fraction(10) ** 400),), (Output("o", 1, 1, (0,)),))
    assert rounding_bounds(huge, {}, "float32")["o"][0, 0] == np.inf


def test_a_branch_that_is_not_taken_adds_nothing() -> None:
    """if_else_zero(x > 0, sqrt(x)): at x < 0 the root is NaN and not used."""
    instrs = (
        Instr("input", (), ("x", 0)), Instr("const", (), Fraction(0)), Instr("lt", (1, 0)), Instr("sqrt", (0,)),
        Instr("if_else_zero", (2, 3)),
    )  # fmt: skip
    program = Program("f", (Input("x", 1),), instrs, (Output("o", 1, 1, (4,)),))
    bound = rounding_bounds(program, {"x": [[-1.0], [2.0]]}, "float64")["o"].ravel()
    assert bound[0] == 0
    assert 0 < bound[1] < 1e-15
