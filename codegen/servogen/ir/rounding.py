"""First-order bounds on the rounding error of a program, state by state.

Each operation v errs by at most its row's `rounding` units in the last place, and the error reaches an output through
the derivative of that output with respect to v: bound = sum over v of |d out / d v| * rounding(v) * u |v|.
"""

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from servogen.ir.evaluate import node_values
from servogen.ir.numbers import nearest
from servogen.ir.ops import OPS
from servogen.ir.program import Program
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
    epsilon = EPSILON[scalar]
    smallest = float(np.finfo(scalar).smallest_subnormal)
    values = node_values(program, inputs)
    count = max((len(v) for v in values), default=1)
    partials: list[tuple[FloatArray, ...]] = []
    local: list[FloatArray | float] = []
    with np.errstate(all="ignore"):
        for instr, value in zip(program.instrs, values, strict=True):
            op = OPS.get(instr.op)
            partials.append(op.partials(*(values[a] for a in instr.args), value) if op else ())
            if isinstance(instr.const, Fraction):
                local.append(_constant_error(instr.const, scalar))
            else:
                local.append(op.rounding * (epsilon * np.abs(value) + smallest) if op and op.rounding else 0.0)
        roots = [n for o in program.outputs for n in o.nodes]
        width = max(1, _BATCH // count)
        batches = [roots[k : k + width] for k in range(0, len(roots), width)]
        found = [_sweep(program, batch, partials, local, count) for batch in batches]
    return np.concatenate(found) if found else np.zeros((0, count))


def _sweep(
    program: Program,
    roots: list[int],
    partials: list[tuple[FloatArray, ...]],
    local: list[FloatArray | float],
    count: int,
) -> FloatArray:
    """The bounds of some nodes, (len(roots), count), from the last instruction to the first."""
    adjoint: dict[int, FloatArray] = {}
    for row, root in enumerate(roots):
        adjoint.setdefault(root, np.zeros((len(roots), count)))[row] = 1.0
    total = np.zeros((len(roots), count))
    for k in range(max(roots, default=-1), -1, -1):
        weight = adjoint.pop(k, None)
        if weight is None:
            continue
        total += _times(np.abs(weight), local[k])
        for a, partial in zip(program.instrs[k].args, partials[k], strict=True):
            share = _times(weight, partial)
            if a in adjoint:
                adjoint[a] += share
            else:
                adjoint[a] = share
    return total


def _times(weight: FloatArray, factor: FloatArray | float) -> FloatArray:
    """weight * factor, where a branch that is not taken (weight zero) may be NaN."""
    product = np.asarray(weight * factor)
    return product if np.all(np.isfinite(factor)) else np.where(weight == 0, 0.0, product)


def _constant_error(value: Fraction, scalar: Scalar) -> float:
    rounded = nearest(value, scalar)
    return float(abs(Fraction(rounded) - value)) if math.isfinite(rounded) else math.inf
