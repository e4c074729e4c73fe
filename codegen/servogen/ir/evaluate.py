"""The program's interpreters: arrays of float64 or float32, and 50 digits (the truth of every check)."""

from collections.abc import Iterator, Mapping
from fractions import Fraction
from typing import Any

import mpmath as mp
import numpy as np

from servogen.ir.numbers import nearest
from servogen.ir.ops import OPS
from servogen.ir.program import Program
from servogen.results import FloatArray

DIGITS = 50


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


def evaluate_exactly(program: Program, inputs: Mapping[str, Any]) -> Iterator[dict[str, list[Any]]]:
    """Outputs at each of N states to 50 digits: name -> list of mpf, row by row; NaN where a value does not exist.

    inputs: name -> array (N, size) of floats or mpf.
    """
    columns = {name: np.atleast_2d(np.asarray(value)) for name, value in inputs.items()}
    count = max((c.shape[0] for c in columns.values()), default=1)
    with mp.workdps(DIGITS):
        steps: list[tuple[Any, tuple[int, ...], Any]] = []
        for instr in program.instrs:
            if isinstance(instr.const, Fraction):
                steps.append((None, (), mp.mpf(instr.const.numerator) / instr.const.denominator))
            elif instr.const is not None:
                steps.append((None, (), instr.const))
            else:
                steps.append((OPS[instr.op].mpmath, instr.args, None))
    for n in range(count):
        with mp.workdps(DIGITS):
            values: list[Any] = []
            for function, args, const in steps:
                if function is not None:
                    values.append(_real(function, *(values[a] for a in args)))
                elif isinstance(const, tuple):
                    column = columns[const[0]]
                    entry = column[n if len(column) > 1 else 0, const[1]]
                    values.append(entry if isinstance(entry, mp.mpf) else mp.mpf(float(entry)))
                else:
                    values.append(const)
            result = {o.name: [values[k] for k in o.nodes] for o in program.outputs}
        yield result


def _real(function: Any, *args: Any) -> Any:
    """The real value of a function, NaN where it has none."""
    try:
        value = function(*args)
    except (ZeroDivisionError, ValueError, OverflowError):
        return mp.nan
    return value if isinstance(value, mp.mpf) else (mp.mpf(value) if not isinstance(value, mp.mpc) else mp.nan)
