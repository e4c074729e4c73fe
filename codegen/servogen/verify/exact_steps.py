"""The steps of a law to 50 digits, each as its definition says: full rank, no tolerance, no status."""

from collections.abc import Callable, Iterable
from typing import Any

import flint
import mpmath as mp
import numpy as np

from servogen import exact
from servogen.exact_bounds import Optimum, best_within
from servogen.exact_levels import lexicographic
from servogen.ir.evaluate import DIGITS
from servogen.ir.numbers import as_fraction
from servogen.law.steps import Apply, Cascade, Evaluate, Limit, Multiply, Pattern, React, Solve, Step
from servogen.results import FloatArray

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


def _cascade(step: Cascade, values: Values) -> list[Any]:
    """Level by level, of whatever rank, without rounding."""
    m = len(values[step.right])
    l = len(values[step.matrix]) // m
    free = values.get(step.free, [mp.mpf(0)] * l)
    if not all(mp.isfinite(x) for x in (*values[step.matrix], *values[step.right], *free)):
        return [mp.nan] * l
    best = lexicographic(
        rational(values[step.matrix], m, l), rational(values[step.right], m, 1), rational(free, l, 1), step.levels
    )
    return column(best.x)


def rational(values: list[Any], rows: int, columns: int) -> exact.Matrix:
    """mpf values as exact rationals."""
    return flint.fmpq_mat(rows, columns, [_fmpq(v) for v in values])


def _fmpq(value: Any) -> Any:
    fraction = as_fraction(value)
    return flint.fmpq(fraction.numerator, fraction.denominator)


def column(x: exact.Matrix) -> list[Any]:
    """A column of rationals as mpf."""
    with mp.workdps(DIGITS):
        return [mp.mpf(int(x[i, 0].p)) / int(x[i, 0].q) for i in range(x.nrows())]


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


_FIRST = flint.fmpq(10) ** 60
"""What one unit of slowing weighs beside one of the distance from y, where slowing comes first."""


def admissible(
    S: FloatArray,
    z: FloatArray,
    y: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    slowed: FloatArray | None = None,
    metric: FloatArray | None = None,
) -> Optimum:
    """The best tau within limits of a system of machine numbers, without rounding; see law.steps.Limit.

    Slowing is one more unknown from 0 to 1, and its square weighs more than all the rest of the distance by so much
    that more than 50 digits are right. rest is what the rows miss of what was asked for, slowed down.
    """
    l = len(y)
    low, high = (
        [None if np.isinf(v) else exact.rational(np.array([v]))[0, 0] for v in side] for side in (lower, upper)
    )
    S_exact, z_exact, y_exact = (exact.rational(a) for a in (S, z, y))
    T = None if metric is None else exact.rational(metric)
    if slowed is None:
        return best_within(S_exact, z_exact, y_exact, low, high, T)
    slow = exact.rational(slowed)
    wider = exact.rational(np.hstack([S, slowed[:, None]]))
    wish = flint.fmpq_mat(l + 1, 1, [*(y_exact[j, 0] for j in range(l)), 0])
    weights = flint.fmpq_mat(l + 1, l + 1)
    for i in range(l):
        for j in range(l):
            weights[i, j] = flint.fmpq(int(i == j)) if T is None else T[i, j]
    weights[l, l] = _FIRST
    best = best_within(wider, z_exact, wish, [*low, flint.fmpq(0)], [*high, flint.fmpq(1)], weights)
    if not best.met:
        return best_within(S_exact, z_exact - slow, y_exact, low, high, T)
    x = flint.fmpq_mat(l, 1, [best.x[j, 0] for j in range(l)])
    return Optimum(x, best.rest, S_exact.transpose() * best.rest, best.place[:l])


def _limit(step: Limit, values: Values) -> list[Any]:
    """The start where it is admissible; else the optimum for the system and the limits rounded to double."""
    start = values[step.start]
    if not all(mp.isfinite(x) for x in start):
        return start
    l = len(start)
    lower, upper = (np.array([float(x) for x in values[name]]) for name in (step.lower, step.upper))
    lower[list(step.no_lower)], upper[list(step.no_upper)] = -np.inf, np.inf
    if all(a <= x <= b for a, x, b in zip(lower, start, upper, strict=True)):
        return start

    def numbers(name: str, *shape: int) -> Any:
        return np.array([float(x) for x in values[name]]).reshape(shape) if name else None

    z = numbers(step.right, -1)
    y = numbers(step.free, -1) if step.free in values else np.zeros(l)
    best = admissible(
        numbers(step.matrix, len(z), l), z, y, lower, upper, numbers(step.slowed, -1), numbers(step.metric, l, l)
    )
    return column(best.x)


EXACT: dict[type, Callable[[Any, Values], list[Any]]] = {
    Solve: _solve,
    Cascade: _cascade,
    Apply: _solve,
    React: _react,
    Multiply: _multiply,
    Limit: _limit,
}
"""One function a step that works on what an evaluation left."""


def walk(steps: Iterable[Step], values: Values) -> None:
    """Put what each step leaves beside the values of the quantities, all mpf; NaN where it does not exist."""
    for step in steps:
        if not isinstance(step, Evaluate):
            values[step.into] = EXACT[type(step)](step, values)
