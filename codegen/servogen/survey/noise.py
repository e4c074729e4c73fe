"""The noise that rounding leaves of a row where it vanishes: the solver's default `atol` (numerics.md: Tolerances).

A row such as [cos(q), 0] is zero at q = pi/2, where the constraint does not reach the controls. The number type has no
pi/2, so the computed row is 6e-17 there instead of zero, and a controller that divides by it asks for torques of 1e16.
What is left of a row at its zeros is therefore taken as its noise, and the solver treats a row that small as zero.

First the zeros are searched for: from states of the domain, Gauss-Newton steps that make the row smaller, with the
regularisation of Levenberg (1944) and Marquardt (1963), all inputs moving at once within the domain's box. Then the
rounding errors of the row at each zero are bounded.

The result must not depend on the machine that generates the code, although its sine and cosine may differ in their last
bits. Such a difference changes the noise by a relative 1e-16, which matters only if the noise is that close to a power
of two, where it is rounded up to the next. Noise often is a few ulps of a round number, and so exactly a power of two;
it is multiplied by the irrational 2^MARGIN before it is rounded up, so that these cases are far from a power of two.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from servogen.ir.adjoint import adjoints, partials, times
from servogen.ir.evaluate import node_values
from servogen.ir.program import Program, only
from servogen.ir.rounding import local_errors
from servogen.results import FloatArray
from servogen.scalars import EPSILON, Scalar
from servogen.scene.samples import Samples
from servogen.scene.scene import Scene, State

Numbers = NDArray[np.int64]

STARTS = 32
"""States of the domain from which the search for zeros of a row starts."""

STEPS = 32
"""The most steps of one search. At a double zero (where the slope vanishes too) a step halves the distance only."""

PATIENCE = 4
"""A search is given up after this many steps, one after another, that did not halve the row.

Towards a zero of order p each step shrinks the row to (1 - 1/p)^p of its size, which is never above 1/e.
"""

FLOOR = 2.0**-30
"""The least regularisation, relative to the largest entry of J J^T.

The entries of a row may depend on one another (cos(q) and 2 cos(q)); J J^T is then singular, and this keeps it regular.
"""

NEAR = 2.0
"""A row whose largest entry is at most NEAR times its noise counts as zero there."""

MARGIN = 0.25
"""Added to the binary logarithm of the noise before it is rounded up to an integer: a factor of 2^(1/4)."""


def survey_noise(samples: Samples, program: Program, matrix: str, scalar: Scalar) -> tuple[float, ...]:
    """Per row of the program's output `matrix`: what the row may come out as where it should be zero, a power of two.

    The noise of an entry is its rounding error to first order: the rounding of every operation, and half an ulp of
    every input and parameter, each times the derivative of the entry by it. A row's noise is that of its worst entry
    at the worst zero. It is 0 for a row that has no zero in the domain's box, and for a row whose noise vanishes with
    it, because such a row is accurate however small it is. Parameters are at their defaults.
    """
    rows, row, x = _zeros(samples, program, matrix)
    noise = rows.noise(row, x, scalar)
    largest = [float(np.max(noise[row == i], initial=0.0)) for i in range(rows.count)]
    limit = float(np.finfo(scalar).max) / 4  # noise as large as this belongs to a row that overflows
    return tuple(2.0 ** math.ceil(math.log2(n) + MARGIN) if 0 < n < limit else 0.0 for n in largest)


class _Rows:
    """The rows of a matrix (count x columns) as functions of the F inputs that they depend on; parameters are fixed.

    Searches for zeros of all rows run side by side. Search k of N is about one row, row[k], and has come to the input
    values x[k]: row (N,), x (N, F).
    """

    def __init__(self, scene: Scene, program: Program, matrix: str) -> None:
        output = program.output(matrix)
        self._part = only(program, matrix)
        self.count, self.columns = output.rows, output.columns
        fixed = {f.name: np.array(f.default) for f in scene.parameters}
        leaves = [(k, i.const) for k, i in enumerate(self._part.instrs) if isinstance(i.const, tuple)]
        self._inputs = [(k, leaf) for k, leaf in leaves if leaf[0] not in fixed]
        self._base = {i.name: fixed.get(i.name, np.zeros(i.size)) for i in self._part.inputs}

    def pick(self, states: State) -> FloatArray:
        """The values of the F inputs in N states, (N, F); states: name -> (N, size)."""
        count = len(next(iter(states.values())))
        return np.array([states[name][:, k] for _, (name, k) in self._inputs]).reshape(-1, count).T

    def at(self, row: Numbers, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of each search, the entries of its row (N, columns) and their derivatives by the inputs (N, columns, F)."""
        values = self._values(x)
        entries = np.zeros((len(row), self.columns))
        slopes = np.zeros((len(row), self.columns, x.shape[1]))
        nodes = np.reshape(self._part.outputs[0].nodes, (self.count, self.columns))
        for i in range(self.count):
            here = row == i
            for j in range(self.columns):
                entries[here, j] = np.broadcast_to(values[nodes[i, j]], len(row))[here]
        place = {node: f for f, (node, _) in enumerate(self._inputs)}
        for node, weight in adjoints(self._part, partials(self._part, values), self._seeds(row)):
            if node in place:
                slopes[:, :, place[node]] = weight.T
        return entries, slopes

    def noise(self, row: Numbers, x: FloatArray, scalar: Scalar) -> FloatArray:
        """Of each search, a bound of the rounding error of its row's worst entry, to first order, (N,)."""
        if not len(row):
            return np.zeros(0)
        values = self._values(x)
        local = local_errors(self._part, values, scalar)
        for k, instr in enumerate(self._part.instrs):
            if isinstance(instr.const, tuple):
                local[k] = EPSILON[scalar] / 2 * np.abs(values[k])  # an input is known to half an ulp
        total = np.zeros((self.columns, len(row)))
        with np.errstate(all="ignore"):
            for node, weight in adjoints(self._part, partials(self._part, values), self._seeds(row)):
                total += times(np.abs(weight), local[node])
        return np.asarray(np.max(total, axis=0))

    def _values(self, x: FloatArray) -> list[FloatArray]:
        states = {name: np.tile(value, (len(x), 1)) for name, value in self._base.items()}
        for f, (_, (name, k)) in enumerate(self._inputs):
            states[name][:, k] = x[:, f]
        return node_values(self._part, states)

    def _seeds(self, row: Numbers) -> dict[int, FloatArray]:
        """Where the reverse sweep starts: instruction -> (columns, N), 1 where it is that entry of the row searched."""
        seeds: dict[int, FloatArray] = {}
        for place, node in enumerate(self._part.outputs[0].nodes):
            i, j = divmod(place, self.columns)
            seeds.setdefault(node, np.zeros((self.columns, len(row))))[j, row == i] = 1.0
        return seeds


@lru_cache(maxsize=32)
@np.errstate(all="ignore")  # at some states the matrix is NaN or infinite; their searches end and are not kept
def _zeros(samples: Samples, program: Program, matrix: str) -> tuple[_Rows, Numbers, FloatArray]:
    """The rows, and the zeros found of them (row, x) in the domain's box at which their noise does not vanish, too.

    All in float64: a zero lies where it lies, whatever the number type of the generated code.
    """
    rows = _Rows(samples.scene, program, matrix)
    low, high = (rows.pick({n: np.atleast_2d(b[side]) for n, b in samples.box.items()}) for side in (0, 1))
    starts = rows.pick(samples.searched)[:STARTS]
    row, x = np.repeat(np.arange(rows.count), STARTS), np.tile(starts, (rows.count, 1))
    size = np.max(np.abs(rows.at(row, x)[0]), axis=1, initial=0.0)
    known = [size[(row == i) & np.isfinite(size)] for i in range(rows.count)]
    typical = np.array([np.median(sizes) if len(sizes) else 0.0 for sizes in known])
    vanished = EPSILON["float64"] ** 1.5 * typical
    row, x, size = _descend(rows, row, x, low, high, vanished)
    noise = rows.noise(row, x, "float64")
    kept = (size <= NEAR * noise) & (noise > vanished[row]) & np.isfinite(noise)
    return rows, row[kept], x[kept]


def _descend(
    rows: _Rows, row: Numbers, x: FloatArray, low: FloatArray, high: FloatArray, vanished: FloatArray
) -> tuple[Numbers, FloatArray, FloatArray]:
    """Where the searches end: (row, x, the row's largest entry there).

    A search ends when its row is at most `vanished` (given per row), when steps no longer help, or after STEPS.
    """
    width = high - low
    entries, slopes = rows.at(row, x)
    norm = np.linalg.norm(entries, axis=1)
    damping, best, failed = np.full(len(row), 1e-2), norm, np.zeros(len(row), int)
    ended: list[tuple[Numbers, FloatArray, FloatArray]] = []
    for step in range(STEPS + 1):
        on = np.isfinite(norm) & (norm > vanished[row]) & (failed < PATIENCE) & (step < STEPS) & (x.shape[1] > 0)
        ended.append((row[~on], x[~on], np.max(np.abs(entries[~on]), axis=1, initial=0.0)))
        if not on.any():
            break
        row, x, entries, slopes, norm = row[on], x[on], entries[on], slopes[on], norm[on]
        damping, best, failed = damping[on], best[on], failed[on]
        trial = np.clip(x - width * _step(entries, slopes * width, damping), low, high)
        new_entries, new_slopes = rows.at(row, trial)
        new_norm = np.linalg.norm(new_entries, axis=1)
        good = new_norm < norm
        x, norm = np.where(good[:, None], trial, x), np.where(good, new_norm, norm)
        entries = np.where(good[:, None], new_entries, entries)
        slopes = np.where(good[:, None, None], new_slopes, slopes)
        damping = np.where(good, damping / 10, damping * 4)
        failed = np.where(norm <= best / 2, 0, failed + 1)
        best = np.where(norm <= best / 2, norm, best)
    row, x, size = (np.concatenate(parts) for parts in zip(*ended, strict=True))
    return row, x, size


def _step(entries: FloatArray, slopes: FloatArray, damping: FloatArray) -> FloatArray:
    """J^T (J J^T + damping |J J^T|)^-1 s, (N, F); zero where J is not finite, or zero."""
    scale = np.max(np.abs(slopes), axis=(1, 2), initial=0.0)
    good = np.isfinite(scale) & (scale > 0)
    scale = np.where(good, scale, 1.0)
    J = np.where(good[:, None, None], slopes / scale[:, None, None], 0.0)
    gram = J @ J.transpose(0, 2, 1)
    largest = np.where(good, np.max(np.abs(gram), axis=(1, 2), initial=0.0), 1.0)
    gram += (np.maximum(damping, FLOOR) * largest)[:, None, None] * np.eye(gram.shape[1])
    multipliers = np.linalg.solve(gram, (entries / scale[:, None])[:, :, None])
    return np.where(good[:, None], (J.transpose(0, 2, 1) @ multipliers)[:, :, 0], 0.0)
