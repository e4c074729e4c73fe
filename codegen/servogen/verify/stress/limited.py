"""Families of systems within limits, against the exact optimum in rationals (exact_bounds.py)."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from servogen import exact
from servogen.exact_bounds import Optimum, best_within
from servogen.results import FloatArray, Status
from servogen.verify.stress.bars import (
    BEYOND,
    CAPPED,
    FALSE_OPTIMUM,
    OPTIMUM,
    STATUS,
    TAU_WITHIN,
    TOUCHED,
    WARM,
    Figure,
    figure,
)
from servogen.verify.stress.bench import Bench, Task

System = tuple[NDArray[Any], ...]
"""Stacks of S, z, y, lower, upper."""


def random(r: Generator, N: int, m: int, l: int) -> System:
    size = r.choice([0.1, 1, 10], (N, 1))
    S, z, y = r.standard_normal((N, m, l)), size * r.standard_normal((N, m)), r.standard_normal((N, l))
    return S, z, y, -2 * r.random((N, l)), 2 * r.random((N, l))


def none_active(r: Generator, N: int, m: int, l: int) -> System:
    S, z, y, *_ = random(r, N, m, l)
    return S, z, y, np.full((N, l), -1e6), np.full((N, l), 1e6)


def one_active(r: Generator, N: int, m: int, l: int) -> System:
    """One control has a limit, and a tau within it meets the rows."""
    S, _, y, *_ = random(r, N, m, l)
    x = r.standard_normal((N, l))
    upper = np.full((N, l), np.inf)
    upper[np.arange(N), r.integers(0, l, N)] = -1.0
    x = np.where(np.isfinite(upper), -1 - r.random((N, l)), x)
    return S, _products(S, x), y, np.full((N, l), -np.inf), upper


def all_active(r: Generator, N: int, m: int, l: int) -> System:
    """Far more is asked for than there is."""
    S, z, y, lower, upper = random(r, N, m, l)
    return S, 1e3 * z, y, lower, upper


def vertices(r: Generator, N: int, m: int, l: int) -> System:
    """All rows can be met, at a corner of the box."""
    S, lower, upper = r.integers(-3, 4, (N, m, l)), -r.integers(1, 9, (N, l)) / 4, r.integers(1, 9, (N, l)) / 4
    x = np.where(r.random((N, l)) < 0.5, lower, upper)
    return S, _products(S, x), r.standard_normal((N, l)), lower, upper


def near_ties(r: Generator, N: int, m: int, l: int) -> System:
    """The same but for the last bit of z."""
    S, z, *rest = vertices(r, N, m, l)
    return S, np.nextafter(z, r.choice([-9.0, 9.0], z.shape)), *rest


def ties(r: Generator, N: int, m: int, l: int) -> System:
    """Small integers: ranks that drop, equal pulls, limits of no width."""
    limits = -r.integers(0, 2, (N, l)), r.integers(0, 2, (N, l))
    return r.integers(-2, 3, (N, m, l)), r.integers(-4, 5, (N, m)), r.integers(-2, 3, (N, l)), *limits


def no_width(r: Generator, N: int, m: int, l: int) -> System:
    S, z, y, lower, upper = random(r, N, m, l)
    return S, z, y, lower, np.where(r.random((N, l)) < 0.4, lower, upper)


def infinite_sides(r: Generator, N: int, m: int, l: int) -> System:
    S, z, y, lower, upper = random(r, N, m, l)
    return S, z, y, np.where(r.random((N, l)) < 0.5, -np.inf, lower), np.where(r.random((N, l)) < 0.5, np.inf, upper)


def far_sides(r: Generator, N: int, m: int, l: int) -> System:
    """Limits of 1e38 in place of none, and some of 1e-37 beside them: nearly all of a float32's range."""
    S, z, y, lower, upper = infinite_sides(r, N, m, l)
    tiny = r.random((N, l)) < 0.2
    lower, upper = np.where(tiny, -1e-37, np.maximum(lower, -1e38)), np.where(tiny, 1e-37, np.minimum(upper, 1e38))
    return S, z, y, lower, upper


def deficient(r: Generator, N: int, m: int, l: int) -> System:
    k = max(1, min(m, l) - 1)
    S = r.integers(-3, 4, (N, m, k)) @ r.integers(-3, 4, (N, k, l))
    z = np.where(r.random((N, 1)) < 0.5, _products(S, r.integers(-2, 3, (N, l))), r.standard_normal((N, m)))
    return S, z, *random(r, N, m, l)[2:]


def rows_apart(r: Generator, N: int, m: int, l: int, by: int) -> System:
    """By up to 2^by, and not to be met."""
    S, z, *rest = random(r, N, m, l)
    d = 2.0 ** r.integers(0, by + 1, (N, m))
    return S * d[:, :, None], z * d, *rest


def columns_apart(r: Generator, N: int, m: int, l: int) -> System:
    """By up to 2^10, at a corner."""
    S, z, y, lower, upper = vertices(r, N, m, l)
    d = 2.0 ** r.integers(0, 11, (N, l))
    return S * d[:, None, :], z, y, lower / d, upper / d


LIMITED: dict[str, Callable[[Generator, int, int, int], System]] = {
    "random": random,
    "none active": none_active,
    "one active": one_active,
    "all active": all_active,
    "vertices": vertices,
    "near ties, 1 ulp": near_ties,
    "degenerate ties": ties,
    "zero-width boxes": no_width,
    "infinite sides": infinite_sides,
    "sides at 1e38 and 1e-37": far_sides,
    "rank-deficient": deficient,
    "rows 2^8 apart": lambda r, N, m, l: rows_apart(r, N, m, l, 8),
    "rows 2^20 apart": lambda r, N, m, l: rows_apart(r, N, m, l, 20),
    "columns 2^10 apart": columns_apart,
}


def _products(S: Any, x: Any) -> FloatArray:
    return np.asarray(np.einsum("nij,nj->ni", np.asarray(S, float), np.asarray(x, float)))


def within_limits(task: Task, bench: Bench, draw: Callable[[Generator, int, int, int], System]) -> Iterator[Figure]:
    """The answers of one family measured; again with the mask of another answer as a hint, and with their own."""
    S, z, y, lower, upper = (bench.round(a) for a in draw(task.generator(), task.systems, task.m, task.l))
    tau, info = bench.solve_within(S, z, y, lower, upper)
    yield figure(CAPPED, info["status"] == Status.NOT_CONVERGED)
    yield figure(BEYOND, ~((lower <= tau) & (tau <= upper)).all(axis=1) & (info["status"] >= 0))
    for hint in (info["active"], np.roll(info["active"], 1)):
        again, told = bench.solve_within(S, z, y, lower, upper, hint)
        yield figure(WARM, (again != tau).any(axis=1) | (told["status"] != info["status"]))
    optimum, off, status, false = (np.zeros(task.systems) for _ in range(4))
    for k in range(task.systems):
        if info["status"][k] >= 0:
            given = tuple(a[k].astype(float) for a in (S, z, y, lower, upper))
            measured = _measured(given, tau[k].astype(float), Status(int(info["status"][k])), bench.eps)
            optimum[k], off[k], status[k], false[k] = measured
    yield figure(OPTIMUM, optimum)
    yield figure(TAU_WITHIN, off)
    yield figure(STATUS, status)
    yield figure(FALSE_OPTIMUM, false)


def _measured(given: tuple[FloatArray, ...], tau: FloatArray, status: Status, u: float) -> tuple[float, ...]:
    """|S tau - z| above the least and the error of tau, over what rounding allows; a wrong status; a false optimum,
    which is beyond a hundred times the bar."""
    S, z, y, lower, upper = given
    sides = [[None if np.isinf(v) else exact.rational(np.array([v]))[0, 0] for v in side] for side in (lower, upper)]
    best = best_within(*(exact.rational(a) for a in (S, z, y)), *sides)
    rows = np.linalg.norm(S, axis=1)
    x = exact.nearest(best.x)[:, 0]
    reach = float(np.linalg.norm(x)) + np.linalg.norm(y) + np.max(np.abs(z) / np.where(rows > 0, rows, np.inf))
    size = float(np.linalg.norm(S)) * (np.linalg.norm(x) + np.linalg.norm(y)) + np.linalg.norm(z)
    least = _norm(best.rest)
    missed = _norm(exact.rational(S) * exact.rational(tau) - exact.rational(z)) - least
    off = float(np.linalg.norm(exact.difference(tau, best.x)))
    kappa = _condition(S, best)
    excess = float(missed / (u * kappa * size)) if size > 0 else 0.0
    plainly_missed = least > 100 * u * size and np.max(np.abs(exact.nearest(best.pull))) > 100 * u * size * max(
        1e-300, float(np.linalg.norm(S))
    )
    plainly_free = not any(best.place) and np.all((x > lower + 100 * u * reach) & (x < upper - 100 * u * reach))
    wrong = (
        status != Status.LIMITED_INCONSISTENT
        if plainly_missed
        else status not in (Status.LIMITED, Status.OK, Status.RANK_DEFICIENT_CONSISTENT)
        if best.met
        else plainly_free and status >= Status.LIMITED
    )
    return excess, float(off / (u * kappa * reach)) if reach > 0 else 0.0, float(wrong), float(excess > 400)


def _norm(column: exact.Matrix) -> float:
    return float(np.linalg.norm(exact.nearest(column)))


def _condition(S: FloatArray, best: Optimum) -> float:
    """Of the free columns, rows of one size."""
    size = np.abs(S).max(axis=1, keepdims=True)
    free = (S / np.where(size > 0, size, 1))[:, [p == 0 for p in best.place]]
    sigma = np.linalg.svd(free, compute_uv=False) if free.size else np.ones(1)
    sigma = sigma[sigma > 1e-12 * sigma[0]] if sigma[0] > 0 else np.ones(1)
    return float(sigma[0] / sigma[-1])


def crossed(task: Task, bench: Bench) -> Iterator[Figure]:
    """A lower limit above the upper one, or a NaN: refused, and the outputs as they were."""
    generator = task.generator()
    S, z, y, lower, upper = (bench.round(a) for a in random(generator, task.systems, task.m, task.l))
    k, j = np.arange(task.systems), generator.integers(0, task.l, task.systems)
    upper[k, j] = np.where(k % 3 == 0, np.nan, lower[k, j] - 1)
    lower[k[k % 3 == 1], j[k % 3 == 1]] = np.nan
    last = bench.round(generator.standard_normal((task.systems, task.l)))
    tau, info = bench.solve_within(S, z, y, lower, upper, last=last)
    yield figure(STATUS, info["status"] != Status.LIMITS_CROSSED)
    yield figure(TOUCHED, (tau != last).any(axis=1))
