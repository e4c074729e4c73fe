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
from servogen.ir.program import Program, live
from servogen.results import FloatArray
from servogen.scalars import EPSILON, Scalar


def rounding_bounds(program: Program, inputs: Mapping[str, Any], scalar: Scalar) -> dict[str, FloatArray]:
    """Outputs' error bounds at N states: name -> array (N, size), absolute.

    Derivatives and values are float64 ones; inputs count as exact, constants as rounded once to the scalar.
    """
    epsilon = EPSILON[scalar]
    smallest = float(np.finfo(scalar).smallest_subnormal)
    values = node_values(program, inputs)
    partials: list[tuple[FloatArray, ...]] = []
    local: list[FloatArray] = []
    with np.errstate(all="ignore"):
        for instr, value in zip(program.instrs, values, strict=True):
            operands = [values[a] for a in instr.args]
            if isinstance(instr.const, Fraction):
                partials.append(())
                local.append(np.full_like(value, _constant_error(instr.const, scalar)))
            elif instr.const is not None:
                partials.append(())
                local.append(np.zeros_like(value))
            else:
                op = OPS[instr.op]
                partials.append(op.partials(*operands, value))
                local.append(op.rounding * (epsilon * np.abs(value) + smallest))
        bounds = {}
        for o in program.outputs:
            columns = [_bound(program, root, partials, local) for root in o.nodes]
            bounds[o.name] = np.stack(columns, axis=-1) if columns else np.zeros((1, 0))
    return bounds


def _bound(program: Program, root: int, partials: list[tuple[FloatArray, ...]], local: list[FloatArray]) -> FloatArray:
    adjoint: dict[int, FloatArray] = {root: np.ones_like(local[root])}
    total = np.zeros_like(local[root])
    for k in sorted(live(program, [root]), reverse=True):
        weight = adjoint.pop(k)
        reached = weight != 0  # a branch that is not taken may be NaN
        total += np.where(reached, np.abs(weight) * local[k], 0.0)
        for a, partial in zip(program.instrs[k].args, partials[k], strict=True):
            share = np.where(reached, weight * partial, 0.0)
            adjoint[a] = adjoint[a] + share if a in adjoint else share
    return total


def _constant_error(value: Fraction, scalar: Scalar) -> float:
    rounded = nearest(value, scalar)
    return float(abs(Fraction(rounded) - value)) if math.isfinite(rounded) else math.inf
