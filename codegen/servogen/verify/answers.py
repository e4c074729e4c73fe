"""What each step of a law ought to leave: 50-digit values, how far correctly rounded code may be off, and a status.

One function a step, in ANSWERS. Tolerances are first-order: what the errors of a step's inputs do to its result, and
the rounding of its own arithmetic; a solve may err by BAR eps kappa (|tau| + |y|) beyond the former.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import flint
import numpy as np

from servogen import exact
from servogen.exact_levels import kept_levels, lexicographic
from servogen.ir.balls import ZERO, Ball, all_finite, balls, working
from servogen.ir.numbers import as_fraction
from servogen.law.steps import STATE, Advance, Apply, Cascade, Limit, Multiply, React, Solve, Step
from servogen.results import FloatArray, Info, Status
from servogen.singular import pseudo_cascade, pseudo_solution
from servogen.textbook import pseudo_inverse
from servogen.textbook.cascade import solve_cascade, solve_switched
from servogen.textbook.policy import Policy
from servogen.verify.exact_steps import admissible, column, rational, sparse_product, transposed_product
from servogen.verify.vectors import ANY_ANSWER, ANY_RANK, ANY_STATUS

BAR = 8.0
"""tau may err by BAR eps kappa(S) (|tau| + |y|) beyond what the errors of S and z cost."""

_TRUSTED = 0.05  # relative error of S beyond which first-order propagation proves nothing

Exact = list[Ball]  # row by row


@dataclass(frozen=True, eq=False)
class Point:
    """Everything about one state: the truth, and the scalar's own answers by the interpreter."""

    values: dict[str, Exact]
    bounds: dict[str, FloatArray]
    rounded: dict[str, FloatArray]
    status: Status  # of the quantities that need Q, before any solve


@dataclass(frozen=True, eq=False)
class Answer:
    """Expected tau with its tolerance (inf: not compared), status and rank."""

    tau: Exact
    tolerance: float
    status: int
    rank: int

    @property
    def known(self) -> bool:
        """Whether there is anything to compare with."""
        return self.status >= 0 and bool(np.isfinite(self.tolerance))


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What a step sees: the point, the inputs, what counts as rank to each solver, and what steps before it left."""

    point: Point
    inputs: Mapping[str, Any]
    policies: Mapping[str, Policy]
    answers: dict[str, Answer] = field(default_factory=dict)


def unknown(size: int, status: int = ANY_ANSWER, rank: int = ANY_RANK) -> Answer:
    """An answer of which nothing but perhaps the status is known."""
    return Answer([ZERO] * size, np.inf, status, rank)


def worse(first: int, second: int) -> int:
    """The status of two steps one after the other, neither of them negative."""
    return ANY_ANSWER if ANY_ANSWER in (first, second) else max(first, second)


def _solve(step: Solve | Apply, at: Surroundings) -> Answer:
    """y + M+ (right - M y). Whether a right side with errors of its own is consistent, is not decided."""
    solver, right = at.policies[step.solver], at.answers.get(step.right)
    if right is None:
        return solved(at.point, step.matrix, step.right, _free(step, at), solver)
    if not right.known:
        return unknown(solver.l)
    rounded = np.array([float(v) for v in right.tau]).astype(solver.scalar)
    limits = np.full(len(rounded), right.tolerance)
    p = at.point
    point = Point(
        p.values | {step.right: right.tau}, p.bounds | {step.right: limits}, p.rounded | {step.right: rounded}, p.status
    )
    answer = solved(point, step.matrix, step.right, _free(step, at), solver)
    if 0 < answer.status <= Status.RANK_DEFICIENT_INCONSISTENT and np.any(rounded):
        return Answer(answer.tau, answer.tolerance, ANY_ANSWER, answer.rank)
    return answer


def _free(step: Solve | Cascade | Apply, at: Surroundings) -> str | FloatArray | None:
    """y as solved() takes it."""
    if step.free.startswith(STATE):
        return np.asarray(at.inputs[step.free.removeprefix(STATE)])
    return step.free or None


def _cascade(step: Cascade, at: Surroundings) -> Answer:
    """Level by level, of the scalar's own system: exact where the ranks are those of exact arithmetic, else by the SVD
    at 50 digits with the ranks that the textbook finds.

    Levels multiply what errors do: a level's directions err by those before it, over how much of its rows they leave.
    """
    solver, p, free = at.policies[step.solver], at.point, _free(step, at)
    m, l = solver.m, solver.l
    S, z = p.rounded[step.matrix].reshape(m, l).astype(float), p.rounded[step.right].astype(float)
    y = np.zeros(l) if free is None else p.rounded[free] if isinstance(free, str) else free
    y = np.asarray(y, dtype=float)
    switches = [(rows, float(np.ravel(at.inputs[n.removeprefix(STATE)])[0])) for n, rows in step.switches]
    if not all(np.isfinite(a) for _, a in switches):
        return unknown(l, Status.NONFINITE, 0)
    _, info = solve_switched(S, z, y, step.levels, switches, solver)
    if info.status < 0:
        return unknown(l, info.status, 0)
    length = np.where(np.linalg.norm(S, axis=1) > 0, np.linalg.norm(S, axis=1), 1.0)
    S_error = float(np.max(np.linalg.norm(p.bounds[step.matrix].reshape(m, l), axis=1) / length))
    y_error = norm(p.bounds[free]) if isinstance(free, str) else 0.0
    counted = pseudo_inverse.counted_rows(S, solver)
    exactly = exact.rational(counted), exact.rational(z), exact.rational(y)

    def answer(there: frozenset[int]) -> tuple[exact.Matrix, float]:
        """tau without the switches that are not there, and how far the code may be off it."""
        asked, missable = flint.fmpq_mat(exactly[1]), p.bounds[step.right].ravel() / length
        for k in there:
            rows, a = switches[k]
            if a < 1:
                before, off = answer(there - {k})
                part, instead = flint.fmpq(*a.as_integer_ratio()), exact.rational(S) * before
                for i in rows:
                    asked[i, 0] = part * exactly[1][i, 0] + (1 - part) * instead[i, 0]
                    missable[i] += off
        kept = kept_levels(step.levels, switches, there)
        right = exact.nearest(asked)[:, 0]
        ranks = solve_cascade(S, right, y, kept, solver)[1].level_rank
        best = lexicographic(exactly[0], asked, exactly[2], kept)
        tau = best.x
        if list(best.ranks) != ranks or info.status == Status.REGULARISED:
            digits = pseudo_cascade(counted, right, y, kept, ranks, solver.damping)
            tau = flint.fmpq_mat(l, 1, [flint.fmpq(*as_fraction(v).as_integer_ratio()) for v in digits])
        found, factor, own = exact.nearest(tau)[:, 0], amplification(counted, kept, ranks), [i for k in kept for i in k]
        missed = float(np.max(np.abs(right - S @ found)[own] / length[own], initial=0.0))
        each = BAR * solver.epsilon + 2 * S_error if S_error * factor < _TRUSTED else np.inf
        reach = norm(found) + norm(y) + norm(right / length)
        return tau, float(factor * (each * (reach + factor * missed) + np.max(missable) + 2 * y_error))

    with np.errstate(all="ignore"):
        tau, tolerance = answer(frozenset(k for k, (_, a) in enumerate(switches) if a > 0))
    if not np.isfinite(tolerance):
        return Answer(column(tau), np.inf, ANY_ANSWER, ANY_RANK)
    return Answer(column(tau), tolerance, info.status, info.rank)


def amplification(S: FloatArray, levels: Sequence[Sequence[int]], ranks: Sequence[int]) -> float:
    """What priorities make of relative errors of rows: the product over the levels of |D^-1 S_k| |(D F)^+ D|.

    D: the rows' lengths; F: what the levels before leave of D^-1 S_k, in the `rank` directions that it takes up. At
    full row rank that is |D^-1 S_k| / sigma_r; below, a long row outweighs others however badly it is placed.
    """
    length = np.linalg.norm(S, axis=1)
    length = np.where(length > 0, length, 1.0)
    unit = np.asarray(S, dtype=float) / length[:, None]
    still_open, product = np.eye(S.shape[1]), 1.0
    for own, rank in zip(map(list, levels), ranks, strict=True):
        if rank > 0:
            right = np.linalg.svd(unit[own] @ still_open)[2][:rank]
            heaviest = np.array(own)[np.argsort(-length[own], kind="stable")]
            Q, R = np.linalg.qr(length[heaviest][:, None] * (unit[heaviest] @ right.T))
            product *= float(
                np.linalg.norm(unit[own], 2) * np.linalg.norm(np.linalg.solve(R, Q.T * length[heaviest]), 2)
            )
            still_open = still_open - right.T @ (right @ still_open)
    return product


def _react(step: React, at: Surroundings) -> Answer:
    """J^T times the multipliers, those of the system in the code's own units."""
    solver, point = at.policies[step.solver], at.point
    m = solver.m
    n = len(point.values[step.jacobian]) // m
    point = _in_own_units(point, step, m) if m > 1 else point
    force = solved(point, step.matrix, step.right, None, solver)
    if not force.known:
        return unknown(n, force.status if force.status < 0 else ANY_ANSWER, force.rank)
    R = transposed_product(point.values[step.jacobian], force.tau)
    size, reach = norm(point.values[step.jacobian]), norm(force.tau)
    tolerance = size * force.tolerance + norm(point.bounds[step.jacobian]) * reach
    tolerance += (m + 1) * solver.epsilon * size * reach + m * float(np.finfo(solver.scalar).smallest_subnormal)
    return Answer(R, tolerance, force.status, force.rank)


def _multiply(step: Multiply, at: Surroundings) -> Answer:
    """N x for an x that a step left."""
    x, entries = at.answers[step.vector], at.point.values[step.entries]
    tau = sparse_product(entries, step.pattern, x.tau)
    size, reach = norm(entries), norm(x.tau)
    tolerance = size * x.tolerance + norm(at.point.bounds[step.entries]) * reach if x.tolerance < np.inf else np.inf
    epsilon = next(iter(at.policies.values())).epsilon
    return Answer(tau, tolerance + (len(step.pattern) + 1) * epsilon * size * reach, x.status, x.rank)


def _limit(step: Limit, at: Surroundings) -> Answer:
    """The start where that is admissible beyond doubt; else the exact optimum of the scalar's own system and limits.

    Like the answer below full rank it is no smooth function of the system, so nothing but the search is judged by it.
    """
    start, solver, p = at.answers[step.start], at.policies[step.solver], at.point
    l = solver.l
    lower, upper = (np.array(_given(name, at), dtype=float) for name in (step.lower, step.upper))
    lower[list(step.no_lower)], upper[list(step.no_upper)] = -np.inf, np.inf
    own = np.array([float(v) for v in start.tau])
    near = start.tolerance
    if start.known and np.all((lower + near <= own) & (own <= upper - near)):
        return start
    if not np.all((lower <= upper) & (lower < np.inf) & (upper > -np.inf)):
        return unknown(l, Status.LIMITS_CROSSED if start.known and not np.isnan(own).any() else ANY_STATUS, 0)
    if not start.known or start.rank < min(solver.m, l):
        return unknown(l, ANY_STATUS)
    S, z = p.rounded[step.matrix].reshape(solver.m, l).astype(float), p.rounded[step.right].astype(float)
    y = np.zeros(l) if not step.free else np.asarray(_given(step.free, at), dtype=float)
    slowed = p.rounded[step.slowed].astype(float) if step.slowed else None
    metric = p.rounded[step.metric].reshape(l, l).astype(float) if step.metric else None
    best = admissible(S, z, y, lower, upper, slowed, metric)
    tau, x = column(best.x), exact.nearest(best.x)[:, 0]
    rows = np.linalg.norm(S, axis=1)
    free = (S / rows[:, None])[:, [place == 0 for place in best.place]]
    sigma = np.linalg.svd(free, compute_uv=False) if free.size else np.ones(1)
    kappa = float(sigma[0] / max(sigma[-1], solver.epsilon * sigma[0])) if sigma[0] > 0 else 1.0
    if metric is not None:
        kappa *= float(np.linalg.cond(metric))
    noise = (S != 0) & (np.abs(S) <= BAR * solver.epsilon * rows[:, None])
    if (
        noise.any()
    ):  # a control that only rounding connects goes to whichever limit its sign says, and to none without it
        other = admissible(np.where(noise, 0.0, S), z, y, lower, upper, slowed, metric)
        if norm(exact.nearest(other.x)[:, 0] - x) > BAR * solver.epsilon * norm(x):
            return unknown(l, ANY_STATUS)
    missed = norm(exact.nearest(best.rest))
    reach = norm(x) + norm(y) + float(np.max(np.abs(z) / rows)) + float(np.max(np.abs(own)))
    tolerance = BAR * solver.epsilon * kappa * (reach + kappa * missed / float(np.min(rows)))
    inside = np.all((lower <= own) & (own <= upper))
    if inside or np.all((lower - near <= own) & (own <= upper + near)):
        return Answer(tau, tolerance + near, ANY_ANSWER, start.rank)
    size = norm(S) * (norm(x) + norm(y)) + norm(z)
    clear = missed == 0.0 or missed > 1e3 * kappa * solver.epsilon * size
    status = Status.LIMITED if missed == 0.0 else Status.LIMITED_INCONSISTENT
    return Answer(tau, tolerance, status if clear and solver.m <= l else ANY_ANSWER, start.rank)


def _given(name: str, at: Surroundings) -> Any:
    """An input, or a quantity in the scalar's own arithmetic."""
    return at.inputs[name.removeprefix(STATE)] if name.startswith(STATE) else at.point.rounded[name]


ANSWERS: dict[type, Callable[[Any, Surroundings], Answer]] = {
    Solve: _solve,
    Cascade: _cascade,
    Apply: _solve,
    React: _react,
    Multiply: _multiply,
    Limit: _limit,
}
"""Steps that work on what an evaluation left; truth.py has those that evaluate, and calls."""


def answer_of(step: Step, at: Surroundings) -> Answer:
    """What a step of ANSWERS ought to leave at a state."""
    return ANSWERS[type(step)](step, at)


def advanced(step: Advance, start: FloatArray, rate: Answer, dt: float) -> tuple[Exact, float]:
    """start + dt rate, and the 2-norm of the error it comes with; where the rate is not known, the start."""
    values = balls(start)
    if not rate.known:
        return values, np.inf
    with working():
        return [a + dt * b for a, b in zip(values, rate.tau, strict=True)], dt * rate.tolerance


def solved(point: Point, matrix: str, right: str, free: str | FloatArray | None, solver: Policy) -> Answer:
    """What a solve gives for the system (matrix, right) at a point; free: y, or its name among the quantities."""
    l = solver.l
    S, z = point.rounded[matrix].reshape(-1, l), point.rounded[right]
    y_rounded = point.rounded[free] if isinstance(free, str) else np.zeros(l) if free is None else free
    _, info = pseudo_inverse.solve(S, z, y_rounded, solver)
    if info.status < 0:
        return Answer([ZERO] * l, np.inf, info.status, 0)
    y = point.values[free] if isinstance(free, str) else balls(y_rounded)
    if info.rank == 0:
        error = norm(point.bounds[free]) if isinstance(free, str) else 0.0
        return Answer(y, error, info.status, 0)
    if info.rank < min(solver.m, l) or info.status == Status.REGULARISED:
        return _truncated(point, matrix, right, y_rounded, info, solver)
    y_error = norm(point.bounds[free]) if isinstance(free, str) else 0.0
    tau, tolerance = _full_rank(point, matrix, right, y, y_error, solver)
    return Answer(tau, tolerance, info.status if np.isfinite(tolerance) else ANY_ANSWER, info.rank)


def _full_rank(point: Point, matrix: str, right: str, y: Exact, y_error: float, solver: Policy) -> tuple[Exact, float]:
    """tau to 50 digits, and the 2-norm by which the code may miss it."""
    m, l = solver.m, solver.l
    if not all_finite(point.values[matrix], point.values[right]):
        return y, np.inf
    S = rational(point.values[matrix], m, l)
    inverse = exact.pinv_full(S)
    tau = exact.solution(S, inverse, rational(point.values[right], m, 1), rational(y, l, 1))
    sizes = np.array([float(v) for v in point.values[matrix]]).reshape(m, l)
    S_error, z_error = norm(point.bounds[matrix]), norm(point.bounds[right])
    sigma = np.linalg.svd(sizes, compute_uv=False)
    reach = norm(exact.nearest(tau)) + norm(y)
    if not np.isfinite(reach) or sigma[-1] == 0 or S_error > _TRUSTED * sigma[-1]:
        return y, np.inf
    rounding = BAR * solver.epsilon * sigma[0] / sigma[-1] * reach
    rest = exact.rational(np.array([0.0])) if m <= l else S * tau - rational(point.values[right], m, 1)
    residual = norm(exact.nearest(rest))
    carried = (z_error + 2 * S_error * reach + S_error * residual / sigma[-1]) / sigma[-1]
    smallest = l * float(np.finfo(solver.scalar).smallest_subnormal)
    return column(tau), float(rounding + carried + 2 * y_error + smallest)


def _truncated(point: Point, matrix: str, right: str, y: FloatArray, info: Info, solver: Policy) -> Answer:
    """tau of a system below full rank or damped: that of the SVD at 50 digits of the scalar's own S, z and y.

    The rank is the textbook's decision. Such an answer jumps with S, so nothing but the solver is judged by it.
    """
    S, z = point.rounded[matrix].reshape(solver.m, solver.l), point.rounded[right]
    tau, kappa = pseudo_solution(pseudo_inverse.counted_rows(S, solver), z, y, info.rank, solver.damping)
    residual = norm(z - S @ np.array([float(v) for v in tau]))
    size = norm(S)
    carried = kappa * residual / size if size > 0 else 0.0
    tolerance = BAR * solver.epsilon * kappa * (norm(tau) + norm(y) + carried)
    return Answer(balls(map(as_fraction, tau)), tolerance if np.isfinite(tolerance) else np.inf, info.status, info.rank)


def _in_own_units(point: Point, step: React, m: int) -> Point:
    """The rows of J, and with them both sides of the system of R, in the code's powers of two."""
    unit = -pseudo_inverse.symmetric_units(point.rounded[step.matrix].reshape(m, m).astype(float))
    by_row = np.repeat(unit, len(point.values[step.jacobian]) // m)
    shifts = {step.matrix: (unit[:, None] + unit).ravel(), step.right: unit, step.jacobian: by_row}
    values, bounds, rounded = dict(point.values), dict(point.bounds), dict(point.rounded)
    for name, shift in shifts.items():
        values[name] = [v * flint.arb((1, int(k))) for v, k in zip(values[name], shift, strict=True)]
        with np.errstate(over="ignore"):
            bounds[name] = np.ldexp(bounds[name].ravel(), shift)
            rounded[name] = np.ldexp(rounded[name].ravel(), shift.astype(np.int32))
    return Point(values, bounds, rounded, point.status)


def norm(values: Any) -> float:
    """2-norm of numbers of any kind, without overflow or underflow on the way."""
    sizes = np.array([abs(float(v)) for v in np.ravel(values)])
    largest = float(np.max(sizes, initial=0.0))
    return largest * float(np.linalg.norm(sizes / largest)) if 0 < largest < np.inf else largest
