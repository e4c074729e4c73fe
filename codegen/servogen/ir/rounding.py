"""First-order bounds on the rounding error of a program, state by state.

Each operation v errs by at most its row's `rounding` units in the last place, and the error reaches an output through
the derivative of that output with respect to v: bound = sum over v of |d out / d v| * rounding(v) * eps |v|.
"""

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from servogen.ir.adjoint import Partials, adjoints, partials, times
from servogen.ir.evaluate import node_values
from servogen.ir.numbers import nearest
from servogen.ir.ops import OPS
from servogen.ir.program import Instr, Program
from servogen.results import FloatArray
from servogen.scalars import EPSILON, Scalar

Entry = tuple[str, int]
"""An output's name and the number of its entry."""

_BATCH = 2048  # adjoints carried together by one sweep: entries times states


def rounding_bounds(program: Program, inputs: Mapping[str, Any], scalar: Scalar) -> dict[str, FloatArray]:
    """Outputs' error bounds at N states: name -> array (N, size), absolute; as `entry_bounds`, by output."""
    rows = iter(entry_bounds(program, inputs, scalar))
    return {o.name: np.stack([next(rows) for _ in o.nodes], axis=-1) for o in program.outputs if o.size} | {
        o.name: np.zeros((1, 0)) for o in program.outputs if not o.size
    }


def entry_bounds(program: Program, inputs: Mapping[str, Any], scalar: Scalar) -> FloatArray:
    """Error bounds of all output entries, in the program's order, at N states: (entries, N), absolute.

    Derivatives and values are float64 ones; inputs count as exact, constants as rounded once to the scalar.
    """
    values = node_values(program, inputs)
    count = max((len(v) for v in values), default=1)
    slopes = partials(program, values)
    local = local_errors(program, values, scalar)
    roots = [n for o in program.outputs for n in o.nodes]
    width = max(1, _BATCH // count)
    batches = [roots[k : k + width] for k in range(0, len(roots), width)]
    with np.errstate(all="ignore"):
        found = [_bounds(program, batch, slopes, local, count) for batch in batches]
    return np.concatenate(found) if found else np.zeros((0, count))


def local_errors(program: Program, values: Sequence[FloatArray], scalar: Scalar) -> list[FloatArray | float]:
    """What each instruction itself errs by: its rounding; that of a constant to the scalar; 0 for an input."""
    epsilon = EPSILON[scalar]
    smallest = float(np.finfo(scalar).smallest_subnormal)
    local: list[FloatArray | float] = []
    with np.errstate(all="ignore"):
        for instr, value in zip(program.instrs, values, strict=True):
            op = OPS.get(instr.op)
            if isinstance(instr.const, Fraction):
                local.append(_constant_error(instr.const, scalar))
            elif op is None or not op.rounding:
                local.append(0.0)
            else:
                local.append(op.rounding * ((0.0 if _is_exact(program, instr) else epsilon) * np.abs(value) + smallest))
    return local


def _is_exact(program: Program, instr: Instr) -> bool:
    """Whether it only changes an exponent: x + x, 2^k x, x / 2^k; such results are exact but among subnormals."""
    if instr.op == "add":
        return instr.args[0] == instr.args[1]
    factors = {"mul": instr.args, "div": instr.args[1:]}.get(instr.op, ())
    return any(isinstance(c := program.instrs[k].const, Fraction) and _is_power_of_two(abs(c)) for k in factors)


def _is_power_of_two(value: Fraction) -> bool:
    return value > 0 and all(n & (n - 1) == 0 for n in (value.numerator, value.denominator))


def _bounds(
    program: Program, roots: list[int], slopes: Partials, local: list[FloatArray | float], count: int
) -> FloatArray:
    """The bounds of some nodes, (len(roots), count)."""
    seeds: dict[int, FloatArray] = {}
    for row, root in enumerate(roots):
        seeds.setdefault(root, np.zeros((len(roots), count)))[row] = 1.0
    total = np.zeros((len(roots), count))
    for k, weight in adjoints(program, slopes, seeds):
        total += times(np.abs(weight), local[k])
    return total


def _constant_error(value: Fraction, scalar: Scalar) -> float:
    rounded = nearest(value, scalar)
    return float(abs(Fraction(rounded) - value)) if math.isfinite(rounded) else math.inf
