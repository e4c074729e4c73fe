"""The accuracy guard: no rewrite may raise an output's rounding error beyond TOLERATED times the unoptimised one's.

Errors are first-order rounding bounds at many states, not measured differences: they are the same on every machine,
whatever the last bits of its maths library.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from servogen.ir.evaluate import node_values
from servogen.ir.ops import OPS
from servogen.ir.program import Output, Program
from servogen.results import FloatArray

TOLERATED = 1.5
"""The largest ratio of an output's error bound to that of the unoptimised program."""

STATES = 24
_BATCH = 48  # outputs whose adjoints are carried together
_UNIT = 2.0**-53

Entry = tuple[str, int]
"""An output's name and the number of its entry."""


@dataclass(frozen=True, eq=False)
class Accuracy:
    """The error bounds of an unoptimised program, to judge others by. states: name -> array (N, size)."""

    states: Mapping[str, Any]
    reference: FloatArray  # (entries, 3): the largest bound over the states, the median one, states without a bound

    @classmethod
    def of(cls, program: Program, states: Mapping[str, Any] | None = None) -> "Accuracy":
        drawn = draw_inputs(program) if states is None else states
        return cls(drawn, summaries(program, drawn))

    def worse(self, program: Program) -> list[Entry]:
        """The entries whose error bound is beyond what is tolerated, in the program's order."""
        found = summaries(program, self.states)
        with np.errstate(all="ignore"):
            bad = np.any(found[:, :2] > TOLERATED * self.reference[:, :2] * (1 + 1e-9), axis=1)
        bad |= found[:, 2] > self.reference[:, 2]  # a value or a bound was finite there, and is not any more
        entries = [(o.name, k) for o in program.outputs for k in range(o.size)]
        return [e for e, flag in zip(entries, bad, strict=True) if flag]


def draw_inputs(program: Program, count: int = STATES) -> dict[str, FloatArray]:
    """Values for every input, between 1/2 and 2 for parameters and between -2 and 2 for the rest."""
    generator = np.random.default_rng(0)
    values: dict[str, FloatArray] = {}
    for i in program.inputs:
        low = 0.5 if i.kind == "parameter" else -2.0
        values[i.name] = low + (2.0 - low) * generator.random((count, i.size))
    return values


def summaries(program: Program, states: Mapping[str, Any]) -> FloatArray:
    """Largest and median rounding bound of every output entry over the states, and at how many it is not finite.

    (entries, 3); NaN for the first two where no bound is finite.
    """
    bounds = entry_bounds(program, states)
    with np.errstate(all="ignore"):
        finite = np.where(np.isfinite(bounds), bounds, np.nan)
        known = np.any(np.isfinite(finite), axis=1)
        result = np.full((len(bounds), 3), np.nan)
        result[:, 2] = np.sum(~np.isfinite(bounds), axis=1)
        if np.any(known):
            result[known, 0] = np.nanmax(finite[known], axis=1)
            result[known, 1] = np.nanmedian(finite[known], axis=1)
    return result


def entry_bounds(program: Program, states: Mapping[str, Any]) -> FloatArray:
    """First-order bounds as in ir/rounding.py, of all entries in one reverse sweep: (entries, N)."""
    roots = [n for o in program.outputs for n in o.nodes]
    values = node_values(program, states)
    count = max((len(v) for v in values), default=1)
    partials: list[tuple[FloatArray, ...]] = []
    local: list[FloatArray | None] = []
    with np.errstate(all="ignore"):
        for instr, value in zip(program.instrs, values, strict=True):
            if instr.op in OPS:
                op = OPS[instr.op]
                partials.append(op.partials(*(values[a] for a in instr.args), value))
                local.append(op.rounding * _UNIT * np.abs(value) if op.rounding else None)
            else:
                partials.append(())
                inexact = instr.op == "const" and instr.const != _exactly(instr.const)
                local.append(0.5 * _UNIT * np.abs(value) if inexact else None)
        batches = [roots[k : k + _BATCH] for k in range(0, len(roots), _BATCH)]
        found = [_sweep(program, batch, partials, local, count) for batch in batches]
    return np.concatenate(found) if found else np.zeros((0, count))


def _exactly(const: Any) -> Any:
    try:
        return Fraction(float(const))
    except OverflowError:
        return const


def _sweep(
    program: Program,
    roots: list[int],
    partials: list[tuple[FloatArray, ...]],
    local: list[FloatArray | None],
    count: int,
) -> FloatArray:
    adjoint: dict[int, FloatArray] = {}
    for row, root in enumerate(roots):
        adjoint.setdefault(root, np.zeros((len(roots), count)))[row] = 1.0
    total = np.zeros((len(roots), count))
    for k in range(max(roots, default=-1), -1, -1):
        weight = adjoint.pop(k, None)
        if weight is None:
            continue
        error = local[k]
        if error is not None:
            total += _times(np.abs(weight), error)
        for a, partial in zip(program.instrs[k].args, partials[k], strict=True):
            share = _times(weight, partial)
            if a in adjoint:
                adjoint[a] += share
            else:
                adjoint[a] = share
    return total


def _times(weight: FloatArray, factor: FloatArray) -> FloatArray:
    """weight * factor, where a branch that is not taken (weight zero) may be NaN."""
    product = weight * factor
    if not np.all(np.isfinite(factor)):
        product = np.where(weight == 0, 0.0, product)
    return product


def mix(old: Program, new: Program, keep: list[Entry]) -> Program:
    """`new` but for the entries in `keep`, which are computed as `old` does."""
    shift = len(old.instrs)
    moved = [type(i)(i.op, tuple(a + shift for a in i.args), i.const) for i in new.instrs]
    kept = set(keep)
    outputs = []
    for a, b in zip(old.outputs, new.outputs, strict=True):
        nodes = tuple(
            x if (a.name, k) in kept else y + shift for k, (x, y) in enumerate(zip(a.nodes, b.nodes, strict=True))
        )
        outputs.append(Output(b.name, b.rows, b.columns, nodes))
    return Program(new.name, new.inputs, (*old.instrs, *moved), tuple(outputs))
