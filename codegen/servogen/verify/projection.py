"""The nearest tau with phi = 0, phi not affine in tau: Newton's method at 60 digits on Lagrange's conditions."""

from dataclasses import dataclass
from typing import Any

import flint
import numpy as np

from servogen.ir.balls import Ball, balls, total, working
from servogen.ir.evaluate import evaluate_exactly
from servogen.ir.program import Program
from servogen.ir.rounding import rounding_bounds
from servogen.law.steps import STATE, Project
from servogen.results import FloatArray
from servogen.scalars import EPSILON, Scalar

BAR = 8.0
"""Roundings of the size of tau that an answer may come with, before the condition of the conditions themselves."""

_STEPS = 12
_MET = flint.arb("1e-45")  # relative to tau; quadratic convergence then leaves nothing
_SMOOTH = 0.05  # the bends may turn what first-order propagation says by this part


@dataclass(frozen=True, eq=False)
class Nearest:
    """tau to 50 digits and more, and the 2-norm by which correctly rounded code may miss it."""

    tau: list[Ball]
    tolerance: float


class Projection:
    """What a step projects onto: its phi, A and the second derivatives of phi by tau, which `program` computes."""

    def __init__(self, program: Program, step: Project, scalar: Scalar) -> None:
        self.step, self._program, self._scalar = step, program, scalar
        self._input = step.of.removeprefix(STATE)

    def nearest(self, inputs: dict[str, FloatArray], start: list[Ball], guess: FloatArray, carried: float) -> Any:
        """Nearest, or None where the conditions have no regular solution near `guess`.

        inputs: name -> (1, size), parameters included. start: the tau that is projected, of which the code knows only
        what is within `carried`, a 2-norm.
        """
        l = len(start)
        with working():
            x = flint.arb_mat(l, 1, balls(guess))
            target, force = flint.arb_mat(l, 1, start), None
            for _ in range(_STEPS):
                phi, A, H = self._at(inputs, x.entries(), l)
                m, back = phi.nrows(), target - x
                if force is None:
                    force = flint.arb_mat(
                        m, 1, balls(np.linalg.lstsq(_floats(A).T, _floats(back).ravel(), rcond=None)[0])
                    )
                W = sum((force[k, 0] * H[k] for k in range(m)), _unit(l))
                missed = back - A.transpose() * force
                try:
                    move = _saddle(W, A).solve(flint.arb_mat(l + m, 1, [*missed.entries(), *(-phi).entries()]))
                except ZeroDivisionError:
                    return None
                # Newton's method mends what a step errs by, so the radii need not be carried along.
                steps = move.mid().entries()
                x = (x + flint.arb_mat(l, 1, steps[:l])).mid()
                force = (force + flint.arb_mat(m, 1, steps[l:])).mid()
                if _norm(steps) <= _MET * (1 + _norm(x.entries())):
                    return self._judged(inputs, x.entries(), start, A, H, force, carried)
        return None

    def _at(self, inputs: dict[str, FloatArray], tau: list[Ball], l: int) -> tuple[Any, Any, list[Any]]:
        values = next(evaluate_exactly(self._program, inputs | {self._input: np.array([tau], dtype=object)}))
        m = len(values[self.step.value])
        phi = flint.arb_mat(m, 1, values[self.step.value])
        A = flint.arb_mat(m, l, values[self.step.matrix])
        H = [flint.arb_mat(l, l) for _ in range(m)]
        for (row, i, j), value in zip(self.step.places, values[self.step.curvature], strict=True):
            H[row][i, j] = H[row][j, i] = value
        return phi, A, H

    def _judged(
        self,
        inputs: dict[str, FloatArray],
        x: list[Ball],
        start: list[Ball],
        A: Any,
        H: Any,
        force: Any,
        carried: float,
    ) -> Nearest | None:
        """How the rounding of phi, A and tau moves the solution: through the inverse of Lagrange's conditions."""
        l, m, eps = len(x), A.nrows(), EPSILON[self._scalar]
        tau = np.array([float(v) for v in x])
        if not np.all(np.isfinite(tau)) or np.linalg.matrix_rank(_floats(A)) < m:
            return None
        bounds = rounding_bounds(self._program, inputs | {self._input: tau[None, :]}, self._scalar)
        W = np.eye(l) + np.tensordot(_floats(force).ravel(), np.array([_floats(h) for h in H]), 1)
        free = np.linalg.svd(_floats(A))[2][m:]
        if m < l and np.min(np.linalg.eigvalsh(free @ W @ free.T)) <= 0:  # stationary, but not the nearest
            return None
        inverse = np.linalg.inv(_floats(_saddle(flint.arb_mat(W.tolist()), A)))[:l]
        reach = float(np.linalg.norm(_floats(force)))
        size = np.linalg.norm(tau) + np.linalg.norm([float(v) for v in start])
        along = BAR * eps * size + carried + float(np.linalg.norm(bounds[self.step.matrix])) * reach
        along += (m + 1) * eps * float(np.linalg.norm(_floats(A))) * reach
        across = bounds[self.step.value].ravel() + BAR * eps * np.linalg.norm(_floats(A), axis=1) * np.linalg.norm(tau)
        error = float(np.linalg.norm(inverse[:, :l], 2) * along + np.linalg.norm(inverse[:, l:], axis=0) @ across)
        bend = float(np.linalg.norm([_floats(h) for h in H]))
        if not error * bend * np.linalg.norm(inverse, 2) < _SMOOTH:
            return None
        return Nearest(x, error)


def _saddle(W: Any, A: Any) -> Any:
    """[[W, A^T], [A, 0]]."""
    m = A.nrows()
    upper = [[*a, *b] for a, b in zip(W.table(), A.transpose().table(), strict=True)]
    return flint.arb_mat([*upper, *([*row, *[0] * m] for row in A.table())])


def _unit(size: int) -> Any:
    return flint.arb_mat(size, size, [int(i == j) for i in range(size) for j in range(size)])


def _norm(entries: list[Ball]) -> Ball:
    return total(x * x for x in entries).sqrt().mid()


def _floats(matrix: Any) -> FloatArray:
    return np.array([[float(x) for x in row] for row in matrix.table()])
