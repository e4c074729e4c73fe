"""What is told of inputs that are NaN or infinite: never too much."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from servogen.ir.evaluate import evaluate
from servogen.ir.ops import OPS, Op
from servogen.ir.program import Input, Instr, Output, Program
from servogen.ir.telling import told_inputs
from support.programs import ANY, INPUTS, programs, random_states

BAD = (np.nan, np.inf, -np.inf)
BESIDE = (0.0, -0.0, 1.0, -2.5, 1e-320, 1e300, *BAD)


@pytest.mark.parametrize("row", OPS.values(), ids=OPS)
@pytest.mark.parametrize("scalar", [np.float64, np.float32])
def test_no_other_operand_hides_it(row: Op, scalar: type) -> None:
    with np.errstate(all="ignore"):
        for place, bad in itertools.product(row.telling, BAD):
            for others in itertools.product(BESIDE, repeat=row.arity - 1):
                operands = [*others[:place], bad, *others[place:]]
                value = row.numpy(*(np.array([x], dtype=scalar) for x in operands))
                assert not np.isfinite(value).any(), operands


@settings(max_examples=200, deadline=None)
@given(program=programs(ops=ANY, most=25), seed=st.integers(0, 2**32 - 1), bad=st.sampled_from(BAD))
def test_a_told_input_shows_in_an_output(program: Program, seed: int, bad: float) -> None:
    states = {name: value[:1] for name, value in random_states(seed).items()}
    for name, k in told_inputs(program):
        spoiled = {n: v.copy() for n, v in states.items()}
        spoiled[name][0, k] = bad
        with np.errstate(all="ignore"):
            outputs = evaluate(program, spoiled)
        assert not all(np.isfinite(value).all() for value in outputs.values()), (name, k)


def test_what_is_hidden_is_not_told() -> None:
    """x1 enters through atan and as a divisor alone; x0 leads to an output through a product; x2 to none."""
    instrs = [Instr("input", (), ("x", k)) for k in range(3)]
    instrs += [Instr("atan", (1,)), Instr("mul", (0, 3)), Instr("div", (4, 1))]
    program = Program("hiding", (Input("x", 3),), tuple(instrs), (Output("o", 1, 1, (5,)),))
    assert told_inputs(program) == {("x", 0)}
    assert ("x", 1) in told_inputs(Program("open", INPUTS[1:2], tuple(instrs), (Output("o", 1, 1, (1,)),)))
