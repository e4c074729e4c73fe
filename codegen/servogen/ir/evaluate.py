"""The program's interpreters: arrays of float64 or float32, and 50 digits and more (the truth of every check)."""

from collections.abc import Iterator, Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from servogen.ir.balls import NAN, Ball, ball, working
from servogen.ir.numbers import nearest
from servogen.ir.ops import OPS
from servogen.ir.program import Program
from servogen.results import FloatArray


def node_values(program: Program, inputs: Mapping[str, Any], dtype: Any = np.float64) -> list[FloatArray]:
    """The value of every instruction at N states at once, each an array (N,) of dtype.

    inputs: name -> array (N, size).
    """
    columns = {name: np.atleast_2d(np.asarray(value)).astype(dtype) for name, value in inputs.items()}
    count = max((c.shape[0] for c in columns.values()), default=1)
    values: list[FloatArray] = []
    with np.errstate(all="ignore"):
        for instr in program.instrs:
            if isinstance(instr.const, Fraction):
                values.append(np.full(count, nearest(instr.const, np.dtype(dtype).name), dtype))
            elif instr.const is not None:
                name, k = instr.const
                values.append(np.broadcast_to(columns[name][:, k], (count,)))
            else:
                values.append(np.asarray(OPS[instr.op].numpy(*(values[a] for a in instr.args)), dtype=dtype))
    return values


def evaluate(program: Program, inputs: Mapping[str, Any], dtype: Any = np.float64) -> dict[str, FloatArray]:
    """Outputs at N states: name -> array (N, rows, columns)."""
    values = node_values(program, inputs, dtype)
    return {
        o.name: np.stack([values[n] for n in o.nodes], axis=-1).reshape(-1, o.rows, o.columns)
        if o.nodes
        else np.zeros((1, o.rows, o.columns), dtype)
        for o in program.outputs
    }


def evaluate_exactly(program: Program, inputs: Mapping[str, Any]) -> Iterator[dict[str, list[Ball]]]:
    """Outputs at each of N states as balls: name -> list, row by row; NaN where a value does not exist.

    inputs: name -> array (N, size) of floats or balls.
    """
    columns = {name: np.atleast_2d(np.asarray(value)) for name, value in inputs.items()}
    count = max((c.shape[0] for c in columns.values()), default=1)
    with working():
        start = [ball(i.const) if isinstance(i.const, Fraction) else None for i in program.instrs]
    reads = [(k, *i.const) for k, i in enumerate(program.instrs) if isinstance(i.const, tuple)]
    steps = [(k, OPS[i.op].ball, i.args) for k, i in enumerate(program.instrs) if i.const is None]
    for n in range(count):
        values: list[Any] = list(start)
        with working():
            for k, name, entry in reads:
                column = columns[name]
                values[k] = ball(column[n if len(column) > 1 else 0, entry])
            for k, function, args in steps:
                try:
                    values[k] = function(*[values[a] for a in args])
                except (ZeroDivisionError, ValueError, OverflowError):
                    values[k] = NAN
        yield {o.name: [values[k] if values[k].is_finite() else NAN for k in o.nodes] for o in program.outputs}
