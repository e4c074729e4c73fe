"""Derivatives of a program by one sweep from its last instruction to its first."""

from collections.abc import Iterator, Sequence

import numpy as np

from servogen.ir.ops import OPS
from servogen.ir.program import Program
from servogen.results import FloatArray

Partials = list[tuple[FloatArray, ...]]
"""Per instruction, the derivative with respect to each operand: arrays (N,)."""


def partials(program: Program, values: Sequence[FloatArray]) -> Partials:
    """values: of every instruction at N states, as `evaluate.node_values` gives them."""
    with np.errstate(all="ignore"):
        return [
            OPS[i.op].partials(*(values[a] for a in i.args), v) if i.op in OPS else ()
            for i, v in zip(program.instrs, values, strict=True)
        ]


def adjoints(program: Program, slopes: Partials, seeds: dict[int, FloatArray]) -> Iterator[tuple[int, FloatArray]]:
    """(instruction, derivative of the seeded combination with respect to it), last first; arrays of the seeds' shape.

    seeds: instruction -> its weight, (K, N); taken apart on the way. slopes: from `partials`.
    """
    for k in range(max(seeds, default=-1), -1, -1):
        weight = seeds.pop(k, None)
        if weight is None:
            continue
        yield k, weight
        for a, slope in zip(program.instrs[k].args, slopes[k], strict=True):
            share = times(weight, slope)
            if a in seeds:
                seeds[a] += share
            else:
                seeds[a] = share


def times(weight: FloatArray, factor: FloatArray | float) -> FloatArray:
    """weight * factor, where a branch that is not taken (weight zero) may be NaN."""
    product = np.asarray(weight * factor)
    return product if np.isfinite(factor).all() else np.where(weight == 0, 0.0, product)
