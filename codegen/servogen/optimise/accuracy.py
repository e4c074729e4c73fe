"""The accuracy guard: no rewrite may raise an output's error bound beyond TOLERATED times the unoptimised one's.

Errors are first-order rounding bounds at many states, not measured differences: they are the same on every machine,
whatever the last bits of its maths library.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from servogen.ir.program import Output, Program
from servogen.ir.rounding import Entry, entry_bounds
from servogen.results import FloatArray

TOLERATED = 1.24
"""The largest ratio of an output's error bound to that of the unoptimised program.

Measured errors scatter about their bounds: with a fifth rounding after four the largest error was seen to grow by 1.6,
and 1.5 is what may be measured.
"""

STATES = 24


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
    bounds = entry_bounds(program, states, "float64")
    with np.errstate(all="ignore"):
        finite = np.where(np.isfinite(bounds), bounds, np.nan)
        known = np.any(np.isfinite(finite), axis=1)
        result = np.full((len(bounds), 3), np.nan)
        result[:, 2] = np.sum(~np.isfinite(bounds), axis=1)
        if np.any(known):
            result[known, 0] = np.nanmax(finite[known], axis=1)
            result[known, 1] = np.nanmedian(finite[known], axis=1)
    return result


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
