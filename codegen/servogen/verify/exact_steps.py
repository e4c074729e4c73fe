"""The steps of a law to 50 digits, each as its definition says: full rank, no tolerance, no status."""

from collections.abc import Callable, Iterable
from typing import Any

import mpmath as mp

from servogen.ir.evaluate import DIGITS
from servogen.law.steps import Apply, Evaluate, Multiply, Pattern, React, Solve, Step

Values = dict[str, list[Any]]


def _react(step: React, values: Values) -> list[Any]:
    """J^T M^-1 right, Eq. (17); NaN where the rows of J are dependent."""
    right, entries, jacobian = values[step.right], values[step.matrix], values[step.jacobian]
    m, n = len(right), len(jacobian) // len(right)
    with mp.workdps(DIGITS):
        if not all(mp.isfinite(x) for x in (*entries, *right, *jacobian)):
            return [mp.nan] * n
        try:
            force = mp.lu_solve(mp.matrix([entries[m * i : m * (i + 1)] for i in range(m)]), mp.matrix(right))
        except ZeroDivisionError:
            return [mp.nan] * n
    return transposed_product(jacobian, list(force))


def transposed_product(jacobian: list[Any], force: list[Any]) -> list[Any]:
    """J^T force, J row by row."""
    m, n = len(force), len(jacobian) // len(force)
    with mp.workdps(DIGITS):
        return [mp.fsum(jacobian[n * i + c] * force[i] for i in range(m)) for c in range(n)]


def sparse_product(entries: list[Any], pattern: Pattern, vector: list[Any]) -> list[Any]:
    """N x for the nonzeros of N, placed by the pattern."""
    with mp.workdps(DIGITS):
        return [mp.fsum(entries[e] * vector[j] for e, j in row) for row in pattern]


def _solve(step: Solve | Apply, values: Values) -> list[Any]:
    l = len(values[step.matrix]) // len(values[step.right])
    return minimum_norm(values[step.matrix], values[step.right], values.get(step.free, [mp.mpf(0)] * l))


def _multiply(step: Multiply, values: Values) -> list[Any]:
    return sparse_product(values[step.entries], step.pattern, values[step.vector])


def minimum_norm(entries: list[Any], right: list[Any], free: list[Any]) -> list[Any]:
    """y + S+ (z - S y) for S of full row or column rank; NaN where it has neither."""
    with mp.workdps(DIGITS):
        m, l = len(right), len(free)
        if not all(mp.isfinite(x) for x in (*entries, *right, *free)):
            return [mp.nan] * l
        S = mp.matrix([entries[i * l : (i + 1) * l] for i in range(m)])
        y = mp.matrix(free)
        rest = mp.matrix(right) - S * y
        try:
            move = S.T * mp.lu_solve(S * S.T, rest) if m <= l else mp.lu_solve(S.T * S, S.T * rest)
        except ZeroDivisionError:
            return [mp.nan] * l
        return list(y + move)


EXACT: dict[type, Callable[[Any, Values], list[Any]]] = {
    Solve: _solve,
    Apply: _solve,
    React: _react,
    Multiply: _multiply,
}
"""One function a step that works on what an evaluation left."""


def walk(steps: Iterable[Step], values: Values) -> None:
    """Put what each step leaves beside the values of the quantities, all mpf; NaN where it does not exist."""
    for step in steps:
        if not isinstance(step, Evaluate):
            values[step.into] = EXACT[type(step)](step, values)
