"""The nearest tau with phi = 0, phi not affine in tau: Newton's method at 50 digits on Lagrange's conditions."""

from dataclasses import dataclass
from typing import Any

import mpmath as mp
import numpy as np

from servogen.ir.evaluate import DIGITS, evaluate_exactly
from servogen.ir.program import Program
from servogen.ir.rounding import rounding_bounds
from servogen.law.steps import STATE, Project
from servogen.results import FloatArray
from servogen.scalars import EPSILON, Scalar

BAR = 8.0
"""Roundings of the size of tau that an answer may come with, before the condition of the conditions themselves."""

_STEPS = 12
_SMOOTH = 0.05  # the bends may turn what first-order propagation says by this part


@dataclass(frozen=True, eq=False)
class Nearest:
    """tau to 50 digits, and the 2-norm by which correctly rounded code may miss it."""

    tau: list[Any]
    tolerance: float


class Projection:
    """What a step projects onto: its phi, A and the second derivatives of phi by tau, which `program` computes."""

    def __init__(self, program: Program, step: Project, scalar: Scalar) -> None:
        self.step, self._program, self._scalar = step, program, scalar
        self._input = step.of.removeprefix(STATE)

    def nearest(self, inputs: dict[str, FloatArray], start: list[Any], guess: FloatArray, carried: float) -> Any:
        """Nearest, or None where the conditions have no regular solution near `guess`.

        inputs: name -> (1, size), parameters included. start: the tau that is projected, of which the code knows only
        what is within `carried`, a 2-norm.
        """
        l = len(start)
        with mp.workdps(DIGITS):
            x = [mp.mpf(float(v)) for v in guess]
            force = None
            for _ in range(_STEPS):
                phi, A, H = self._at(inputs, x, l)
                back = mp.matrix([a - b for a, b in zip(start, x, strict=True)])
                if force is None:
                    force = mp.matrix(np.linalg.lstsq(_floats(A).T, _floats(back).ravel(), rcond=None)[0].tolist())
                W = mp.eye(l) + sum((force[k] * H[k] for k in range(1, len(H))), force[0] * H[0])
                K = _saddle(W, A)
                try:
                    move = mp.lu_solve(K, mp.matrix([*(back - A.T * force), *(-phi)]))
                except (ZeroDivisionError, ValueError):
                    return None
                x = [a + move[j] for j, a in enumerate(x)]
                force = force + move[l:]
                if mp.norm(move) <= mp.mpf(10) ** (5 - DIGITS) * (1 + mp.norm(mp.matrix(x))):
                    return self._judged(inputs, x, start, A, H, force, carried)
        return None

    def _at(self, inputs: dict[str, FloatArray], tau: list[Any], l: int) -> tuple[Any, Any, list[Any]]:
        values = next(evaluate_exactly(self._program, inputs | {self._input: np.array([tau], dtype=object)}))
        phi = mp.matrix(values[self.step.value])
        A = mp.matrix(phi.rows, l)
        H = [mp.zeros(l) for _ in range(phi.rows)]
        for k, value in enumerate(values[self.step.matrix]):
            A[k // l, k % l] = value
        for (row, i, j), value in zip(self.step.places, values[self.step.curvature], strict=True):
            H[row][i, j] = H[row][j, i] = value
        return phi, A, H

    def _judged(
        self, inputs: dict[str, FloatArray], x: list[Any], start: list[Any], A: Any, H: Any, force: Any, carried: float
    ) -> Nearest | None:
        """How the rounding of phi, A and tau moves the solution: through the inverse of Lagrange's conditions."""
        l, m, eps = len(x), A.rows, EPSILON[self._scalar]
        tau = np.array([float(v) for v in x])
        if not np.all(np.isfinite(tau)) or np.linalg.matrix_rank(_floats(A)) < m:
            return None
        bounds = rounding_bounds(self._program, inputs | {self._input: tau[None, :]}, self._scalar)
        W = np.eye(l) + np.tensordot(_floats(force).ravel(), np.array([_floats(h) for h in H]), 1)
        free = np.linalg.svd(_floats(A))[2][m:]
        if m < l and np.min(np.linalg.eigvalsh(free @ W @ free.T)) <= 0:  # stationary, but not the nearest
            return None
        inverse = np.linalg.inv(_floats(_saddle(mp.matrix(W.tolist()), A)))[:l]
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
    l, m = W.rows, A.rows
    K = mp.zeros(l + m)
    K[:l, :l] = W
    K[l:, :l] = A
    K[:l, l:] = A.T
    return K


def _floats(matrix: Any) -> FloatArray:
    return np.array(matrix.tolist(), dtype=float)
