"""Random programs of the intermediate representation, for hypothesis and for numpy's generators."""

import os
from fractions import Fraction
from typing import Any

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from servogen.ir.evaluate import evaluate_exactly, node_values
from servogen.ir.ops import OPS
from servogen.ir.program import Input, Instr, Output, Program, check_legal

INPUTS = (Input("p", 2, "parameter"), Input("x", 3), Input("k", 1))

# Bounded, smooth and real on the whole line: what random programs can chain without leaving the numbers.
TAME = ("add", "sub", "mul", "neg", "fabs", "sin", "cos", "atan", "tanh", "fmin", "fmax", "lt", "le", "if_else_zero")
ANY = tuple(OPS)

TRUTHS = ("lt", "le", "eq", "ne", "not", "and", "or")
EDGES = {"lt": (0, 1), "le": (0, 1), "eq": (0, 1), "ne": (0, 1), "not": (0,), "and": (0, 1), "or": (0, 1)}
EDGES |= {"sign": (0,), "copysign": (1,), "if_else_zero": (0,)}
"""Operation -> operands at whose difference, or sign, it jumps."""

# Signs, identities and decimals that are not dyadic.
CONSTANTS = tuple(Fraction(c) for c in ("0", "1", "-1", "2", "-2", "0.5", "0.1", "-0.3", "3", "1/3", "16", "-7"))


@st.composite
def programs(draw: Any, ops: tuple[str, ...] = TAME, most: int = 14, outputs: int = 3) -> Program:
    """A legal program over INPUTS: leaves first, then up to `most` operations, a matrix and some scalars out."""
    instrs = [Instr("input", (), (i.name, k)) for i in INPUTS for k in range(i.size)]
    instrs += [Instr("const", (), draw(st.sampled_from(CONSTANTS))) for _ in range(draw(st.integers(0, 4)))]
    for _ in range(draw(st.integers(1, most))):
        op = draw(st.sampled_from(ops))
        args = tuple(draw(st.integers(0, len(instrs) - 1)) for _ in range(OPS[op].arity))
        instrs.append(Instr(op, args))
    last = st.integers(max(0, len(instrs) - 8), len(instrs) - 1)
    named = [Output(f"o{k}", 1, 1, (draw(last),)) for k in range(draw(st.integers(1, outputs)))]
    shape = draw(st.sampled_from([(1, 2), (2, 1), (2, 3)]))
    named.append(Output("matrix", *shape, tuple(draw(last) for _ in range(shape[0] * shape[1]))))
    return check_legal(Program("random", INPUTS, tuple(instrs), tuple(named)))


def random_states(seed: int, count: int = 3) -> dict[str, Any]:
    """Values of INPUTS around one; the last state holds whole numbers, zeros among them."""
    rng = np.random.default_rng(seed)
    states = {i.name: rng.uniform(-2, 2, (count, i.size)) for i in INPUTS}
    for value in states.values():
        value[-1] = np.round(value[-1])
    return states


STEPS = {
    "floor": lambda a: a,
    "ceil": lambda a: a,
    "fmod": lambda a, b: a / b,
    "remainder": lambda a, b: a / b + 0.5,
}
"""What must not be near a whole number where an operation jumps there."""


def clear_of_steps(program: Program, states: dict[str, Any]) -> Any:
    """(N,): whether no operation of the program is about to jump at a state, so that rounding moves values a little.

    Operands that are inputs, constants or truth values are exact, and may stand on an edge.
    """
    values = [np.asarray(v, dtype=float) for v in node_values(program, states)]
    exact = {k for k, i in enumerate(program.instrs) if i.const is not None or i.op in TRUTHS}
    clear = np.ones(len(states["x"]), bool)
    with np.errstate(all="ignore"):
        for instr in program.instrs:
            operands = [values[a] for a in instr.args]
            if instr.op not in (*STEPS, *EDGES) or exact.issuperset(instr.args):
                continue
            if instr.op in STEPS:
                size = STEPS[instr.op](*operands)
                clear &= np.abs(size - np.round(size)) > 1e-6 * (1 + np.abs(size))
            elif instr.op in ("lt", "le", "eq", "ne"):
                a, b = operands
                clear &= np.abs(a - b) > 1e-6 * (1 + np.abs(a) + np.abs(b))
            else:  # the sign of an operand, or whether it is 0
                for a in EDGES[instr.op]:
                    clear &= np.abs(operands[a]) > 1e-6 if instr.args[a] not in exact else True
    return clear


def same_to_50_digits(a: Program, b: Program, states: dict[str, Any]) -> None:
    """Both programs have the same outputs at every state, as far as 50 digits can tell; NaN may become a number."""
    for left, right in zip(evaluate_exactly(a, states), evaluate_exactly(b, states), strict=True):
        assert left.keys() == right.keys()
        for name in left:
            assert len(left[name]) == len(right[name])
            for x, y in zip(left[name], right[name], strict=True):
                assert not x.is_finite() or abs(x - y) <= 1e-40 * (1 + abs(x)), (name, x, y)


def examples(count: int) -> Any:
    """Settings of a hypothesis test: the same each run; SERVOGEN_EXAMPLES=20 tries 20 times as many, afresh."""
    more = os.environ.get("SERVOGEN_EXAMPLES")
    health = [HealthCheck.too_slow, HealthCheck.filter_too_much, HealthCheck.data_too_large]
    return settings(
        max_examples=count * int(more or 1), deadline=None, derandomize=more is None, database=None,
        suppress_health_check=health,
    )  # fmt: skip
