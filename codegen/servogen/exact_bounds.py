"""Exact truth for least squares within limits: an active set in rationals, and the proof that its answer is the best.

Of all lower <= x <= upper those that minimise |S x - z|, and of these the one nearest to y, |T (x - y)|. That answer is
unique, and sufficient conditions (Karush, Kuhn and Tucker's, level by level) are checked without rounding: however the
active set was found, what is returned is the truth.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import flint

from servogen.exact import Matrix, pinv

Limits = Sequence[Any]
"""One rational per unknown; None where there is no limit."""

_TRIES = 100_000
"""Changes after which something is wrong: the least index alone ends it after finitely many."""


@dataclass(frozen=True)
class Optimum:
    """x, what its rows leave S x - z, and the pull of the first level, S^T (S x - z); place: -1, 0 or 1 by unknown."""

    x: Matrix
    rest: Matrix
    pull: Matrix
    place: tuple[int, ...]

    @property
    def met(self) -> bool:
        """S x = z."""
        return _vanishes(self.rest)


def best_within(S: Matrix, z: Matrix, y: Matrix, lower: Limits, upper: Limits, metric: Matrix | None = None) -> Optimum:
    """The answer; metric: T, l x l of full rank, None for the identity. ValueError where lower > upper."""
    l = S.ncols()
    if any(a is not None and b is not None and a > b for a, b in zip(lower, upper, strict=True)):
        raise ValueError("no number lies between two of the limits")
    T = _identity(l) if metric is None else metric
    fixed = [a is not None and a == b for a, b in zip(lower, upper, strict=True)]
    place = [-1 if f else 0 for f in fixed]
    fewest, patience = l + 1, 3
    for _ in range(_TRIES):
        x, second = _of_places(S, z, y, lower, upper, T, place)
        rest = S * x - z
        pull = S.transpose() * rest
        wrong = [
            (j, p)
            for j in range(l)
            if not fixed[j] and (p := _better(j, x, pull, second, lower, upper, place)) is not None
        ]
        if not wrong:
            return Optimum(x, rest, pull, tuple(place))
        if len(wrong) < fewest:
            fewest, patience = len(wrong), 3
        elif patience:
            patience -= 1
        else:
            wrong = wrong[:1]
        for j, p in wrong:
            place[j] = p
    raise ArithmeticError("the active set did not settle")


def _better(
    j: int, x: Matrix, pull: Matrix, second: Matrix, lower: Limits, upper: Limits, place: list[int]
) -> int | None:
    """Where unknown j ought to be in place of where it is; None where it is right."""
    if place[j] == 0:
        if lower[j] is not None and x[j, 0] < lower[j]:
            return -1
        return 1 if upper[j] is not None and x[j, 0] > upper[j] else None
    force = pull[j, 0] if pull[j, 0] != 0 else second[j, 0]
    return 0 if force * place[j] > 0 else None


def _of_places(
    S: Matrix, z: Matrix, y: Matrix, lower: Limits, upper: Limits, T: Matrix, place: list[int]
) -> tuple[Matrix, Matrix]:
    """The best x with some unknowns at their limits, and the pull of the distance beside what S leaves open."""
    l = S.ncols()
    x = flint.fmpq_mat(l, 1, [lower[j] if place[j] < 0 else upper[j] if place[j] > 0 else 0 for j in range(l)])
    free = [j for j in range(l) if place[j] == 0]
    multiplier = flint.fmpq_mat(S.nrows(), 1)
    if free:
        S_free, T_free = _columns(S, free), _columns(T, free)
        inverse = pinv(S_free)
        own = inverse * (z - S * x)
        kernel = _identity(len(free)) - inverse * S_free
        own = own - kernel * (pinv(T_free * kernel) * (T_free * own + T * (x - y)))
        for k, j in enumerate(free):
            x[j, 0] = own[k, 0]
        multiplier = inverse.transpose() * (T_free.transpose() * (T * (x - y)))
    return x, T.transpose() * (T * (x - y)) - S.transpose() * multiplier


def _identity(n: int) -> Matrix:
    return flint.fmpq_mat(n, n, [int(i == j) for i in range(n) for j in range(n)])


def _columns(A: Matrix, which: list[int]) -> Matrix:
    return flint.fmpq_mat(A.nrows(), len(which), [A[i, j] for i in range(A.nrows()) for j in which])


def _vanishes(A: Matrix) -> bool:
    return all(A[i, 0] == 0 for i in range(A.nrows()))
