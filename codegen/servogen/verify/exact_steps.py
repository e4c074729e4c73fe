"""The steps of a law on balls of 60 digits, each as its definition says: full rank, no tolerance, no status."""

from collections.abc import Callable, Iterable
from typing import Any

import flint
import numpy as np

from servogen import exact
from servogen.exact_bounds import Optimum, best_within
from servogen.exact_levels import switched
from servogen.ir.balls import NAN, ZERO, Ball, all_finite, ball, balls, total, working
from servogen.law.steps import Apply, Cascade, Evaluate, Limit, Multiply, Pattern, React, Solve, Step
from servogen.results import FloatArray

Values = dict[str, list[Ball]]


def _react(step: React, values: Values) -> list[Ball]:
    """J^T M^-1 right, Eq. (17); NaN where the rows of J are dependent."""
    right, entries, jacobian = values[step.right], values[step.matrix], values[step.jacobian]
    m, n = len(right), len(jacobian) // len(right)
    if not all_finite(entries, right, jacobian):
        return [NAN] * n
    with working():
        try:
            force = flint.arb_mat(m, m, entries).solve(flint.arb_mat(m, 1, right))
        except ZeroDivisionError:
            return [NAN] * n
    return transposed_product(jacobian, force.entries())


def transposed_product(jacobian: list[Ball], force: list[Ball]) -> list[Ball]:
    """J^T force, J row by row."""
    m, n = len(force), len(jacobian) // len(force)
    with working():
        return [total(jacobian[n * i + c] * force[i] for i in range(m)) for c in range(n)]


def sparse_product(entries: list[Ball], pattern: Pattern, vector: list[Ball]) -> list[Ball]:
    """N x for the nonzeros of N, placed by the pattern."""
    with working():
        return [total(entries[e] * vector[j] for e, j in row) for row in pattern]


def _solve(step: Solve | Apply, values: Values) -> list[Ball]:
    l = len(values[step.matrix]) // len(values[step.right])
    return minimum_norm(values[step.matrix], values[step.right], values.get(step.free, [ZERO] * l))


def _cascade(step: Cascade, values: Values) -> list[Ball]:
    """Level by level, of whatever rank, from the midpoints on without rounding."""
    m = len(values[step.right])
    l = len(values[step.matrix]) // m
    free = values.get(step.free, [ZERO] * l)
    if not all_finite(values[step.matrix], values[step.right], free):
        return [NAN] * l
    switches = [(rows, float(values[name][0])) for name, rows in step.switches]
    system = rational(values[step.matrix], m, l), rational(values[step.right], m, 1), rational(free, l, 1)
    return column(switched(*system, step.levels, switches).x)


def rational(values: list[Ball], rows: int, columns: int) -> exact.Matrix:
    """The midpoints, exactly."""
    return flint.fmpq_mat(rows, columns, [v.mid().fmpq() for v in values])


def column(x: exact.Matrix) -> list[Ball]:
    """A column of rationals as balls."""
    with working():
        return [ball(x[i, 0]) for i in range(x.nrows())]


def _multiply(step: Multiply, values: Values) -> list[Ball]:
    return sparse_product(values[step.entries], step.pattern, values[step.vector])


def minimum_norm(entries: list[Ball], right: list[Ball], free: list[Ball]) -> list[Ball]:
    """y + S+ (z - S y) for S of full row or column rank; NaN where it has neither."""
    m, l = len(right), len(free)
    if not all_finite(entries, right, free):
        return [NAN] * l
    with working():
        S, y = flint.arb_mat(m, l, entries), flint.arb_mat(l, 1, free)
        rest, T = flint.arb_mat(m, 1, right) - S * y, S.transpose()
        try:
            move = T * (S * T).solve(rest) if m <= l else (T * S).solve(T * rest)
        except ZeroDivisionError:
            return [NAN] * l
        return (y + move).entries()  # type: ignore[no-any-return]


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


def _limit(step: Limit, values: Values) -> list[Ball]:
    """The start where it is admissible; else the optimum for the system and the limits rounded to double."""
    start = values[step.start]
    if not all_finite(start):
        return start
    l = len(start)
    lower, upper = (np.array([float(x) for x in values[name]]) for name in (step.lower, step.upper))
    lower[list(step.no_lower)], upper[list(step.no_upper)] = -np.inf, np.inf
    if all(a <= x.mid() <= b for a, x, b in zip(balls(lower), start, balls(upper), strict=True)):
        return start

    def numbers(name: str, *shape: int) -> Any:
        return np.array([float(x) for x in values[name]]).reshape(shape) if name else None

    z = numbers(step.right, -1)
    y = numbers(step.free, -1) if step.free in values else np.zeros(l)
    best = admissible(
        numbers(step.matrix, len(z), l), z, y, lower, upper, numbers(step.slowed, -1), numbers(step.metric, l, l)
    )
    return column(best.x)


EXACT: dict[type, Callable[[Any, Values], list[Ball]]] = {
    Solve: _solve,
    Cascade: _cascade,
    Apply: _solve,
    React: _react,
    Multiply: _multiply,
    Limit: _limit,
}
"""One function a step that works on what an evaluation left."""


def walk(steps: Iterable[Step], values: Values) -> None:
    """Put what each step leaves beside the values of the quantities, all balls; NaN where it does not exist."""
    for step in steps:
        if not isinstance(step, Evaluate):
            values[step.into] = EXACT[type(step)](step, values)
