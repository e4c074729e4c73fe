"""What is told of inputs that are NaN or infinite: never too much."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from servogen.ir.evaluate import evaluate
from servogen.ir.ops import OPS, Op
from servogen.ir.program import Input, Instr, Output, Program
from servogen.ir.telling import told_inputs, watched_outputs
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


@settings(max_examples=200, deadline=None)
@given(
    program=programs(ops=ANY, most=25), seed=st.integers(0, 2**32 - 1), reach=st.sampled_from([1.0, 1e160, 1e308, *BAD])
)
def test_where_the_watched_outputs_are_finite_all_are(program: Program, seed: int, reach: float) -> None:
    """Whatever overflows on the way."""
    watched = watched_outputs(program)
    with np.errstate(all="ignore"):
        values = evaluate(program, {name: value * reach for name, value in random_states(seed).items()})
    entries = {(o.name, k): values[o.name].reshape(-1, o.size)[:, k] for o in program.outputs for k in range(o.size)}
    shapes = np.broadcast_arrays(*entries.values())
    finite = dict(zip(entries, map(np.isfinite, shapes), strict=True))
    looked_at = [f for (name, _), f in finite.items() if name in watched]
    good = np.all([np.ones_like(shapes[0], bool), *looked_at], axis=0)
    assert all(f[good].all() for f in finite.values())


def test_an_output_that_another_shows_is_not_watched() -> None:
    """b = x0 x1 a shows a = x0 + x1; c = atan(a) hides it; a value of two names is watched once, a constant never."""
    instrs = [Instr("input", (), ("x", k)) for k in range(2)]
    instrs += [Instr("add", (0, 1)), Instr("mul", (0, 1)), Instr("mul", (3, 2)), Instr("atan", (2,))]
    instrs += [Instr("const", (), Fraction(1, 2))]

    def watched(**nodes: int) -> frozenset[str]:
        outputs = tuple(Output(name, 1, 1, (node,)) for name, node in nodes.items())
        return watched_outputs(Program("f", (Input("x", 2),), tuple(instrs), outputs))

    assert watched(a=2, b=4) == {"b"}
    assert watched(a=2, c=5) == {"a", "c"}
    assert len(watched(a=2, again=2)) == 1
    assert watched(a=2, half=6) == {"a"}
