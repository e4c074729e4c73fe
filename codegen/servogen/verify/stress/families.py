"""The families of systems of a stress run: what each feeds the solver, and what it measures."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator

from servogen import exact
from servogen.results import FloatArray, Status
from servogen.scene.solver import Solver
from servogen.verify.stress import core
from servogen.verify.stress.bars import (
    BITS,
    COMPLAINTS,
    FALSE_NORMAL,
    FALSE_QR,
    GRADED,
    HIGH_BOUND,
    IDLE,
    LOW_BOUND,
    NEAR,
    PINV,
    PINV_R,
    RANK,
    STATUS,
    SVD_BACK,
    SVD_LEFT,
    SVD_RIGHT,
    TAU,
    TAU_LS,
    TAU_R,
    TOUCHED,
    Figure,
    figure,
)
from servogen.verify.stress.bench import Bench, MakeTwin, Task, answers
from servogen.verify.stress.compilers import complaints
from servogen.verify.stress.false_certificates import false_certificates
from servogen.verify.stress.limited import LIMITED, System, crossed, within_limits
from servogen.verify.stress.matrices import classical, integer_factors, nearly_deficient, spectra, with_spectra
from servogen.verify.stress.rationals import accuracy, decided_exactly, error, length, over
from servogen.verify.stress.regressions import REGRESSIONS

_SQUARE = ((2, 2), (3, 3), (12, 12))
SHAPES = ((1, 2), (1, 3), (1, 12), (2, 3), (3, 4), (3, 7), (6, 7), (6, 12), *_SQUARE, (3, 2), (7, 3), (12, 11), (4, 1))
EVERY = tuple((m, l) for m in range(1, 13) for l in range(1, 13))


@dataclass(frozen=True)
class Family:
    """measure: the figures of one task. applies(m, l): whether it has that shape. solver: what is put to the test.

    times: systems for each one asked for. part: systems in one task. finite: there is only one task, with all there
    are. shapes: its own in place of the run's. long: only in a campaign. tools: compilers that it calls by name.
    """

    measure: Callable[[Task, Bench], Iterator[Figure]]
    applies: Callable[[int, int], bool] = lambda m, l: True
    solver: Solver = field(default_factory=Solver)
    times: float = 1
    part: int = 250
    finite: bool = False
    shapes: tuple[tuple[int, int], ...] | None = None
    long: bool = False
    tools: tuple[str, ...] = ()


def run(task: Task, make: MakeTwin) -> list[Figure]:
    """The figures of one task."""
    family = FAMILIES[task.family]
    return list(family.measure(task, Bench(task, make, family.solver)))


def _tasks_of(S: FloatArray, generator: Generator, bench: Bench) -> tuple[FloatArray, FloatArray]:
    """z in turn random and from a random tau, y in turn zero and random."""
    N, m, l = S.shape
    z = generator.standard_normal((N, m))
    z[1::2] = np.einsum("nij,nj->ni", S[1::2].astype(np.float64), generator.standard_normal((N, l))[1::2])
    y = generator.standard_normal((N, l)) * (np.arange(N) // 2 % 2)[:, None]
    return bench.round(z), bench.round(y)


def _full_rank(task: Task, bench: Bench, S: FloatArray, generator: Generator) -> Iterator[Figure]:
    z, y = _tasks_of(S, generator, bench)
    truths = [exact.pinv_full(exact.rational(s)) for s in S]
    yield from accuracy(bench, S, z, y, truths, (TAU if task.m <= task.l else TAU_LS, PINV))


def _largest_condition(task: Task, bench: Bench) -> float:
    return 0.1 / (max(task.m, task.l) * bench.eps)


def _spectra(task: Task, bench: Bench) -> Iterator[Figure]:
    generator = task.generator()
    n = min(task.m, task.l)
    sigma = spectra(task.systems, n, _largest_condition(task, bench), generator)
    S = bench.round(with_spectra(task.m, task.l, sigma, generator))
    yield from _full_rank(task, bench, S, generator)
    _, info = bench.pinv(S)
    yield figure(RANK, info["rank"] != n)


def _taken_away(task: Task, bench: Bench) -> Iterator[Figure]:
    """y among the rows, z small or zero: next to nothing is left of y."""
    generator = task.generator()
    N, m, l = task.systems, task.m, task.l
    S = bench.round(with_spectra(m, l, spectra(N, m, 1e3, generator), generator))
    y = bench.round(np.einsum("nij,ni->nj", S.astype(np.float64), generator.standard_normal((N, m))))
    z = bench.round(generator.standard_normal((N, m)) * 2.0 ** -generator.uniform(0, 60, (N, 1)))
    z[::4] = 0.0
    yield from accuracy(bench, S, z, y, [exact.pinv_full(exact.rational(s)) for s in S])


def _classical(task: Task, bench: Bench) -> Iterator[Figure]:
    """Those worse than 0.1 / (max(m, l) eps) are left out."""
    generator = task.generator()
    most = _largest_condition(task, bench)
    kept: list[FloatArray] = []
    for i in range(20 * task.systems):
        if len(kept) == task.systems:
            break
        A = bench.round(classical(task.m, task.l, i, generator))
        with np.errstate(all="ignore"):
            if np.linalg.cond(A.astype(np.float64)) <= most:
                kept.append(A)
    yield from _full_rank(task, bench, np.array(kept), generator)


def _graded(task: Task, bench: Bench) -> Iterator[Figure]:
    """Rows graded to 1e-14, z alike."""
    generator = task.generator()
    N, m, l = task.systems, task.m, task.l
    base = with_spectra(m, l, spectra(N, m, 1e3, generator), generator)
    D = 10.0 ** -generator.uniform(0, 14, (N, m))
    D[:, 0], D[:, -1] = 1.0, 1e-14
    D = generator.permuted(D, axis=1)
    S = bench.round(D[:, :, None] * base)
    z = bench.round(D * generator.standard_normal((N, m)))
    y = bench.round(np.zeros((N, l)))
    tau, info = bench.solve(S, z, y)
    yield from bench.ends(info)
    yield from answers(info, [m] * N, [Status.OK] * N)
    right, miss = np.zeros((N, l)), np.zeros((N, l))
    for i in range(N):
        s = exact.rational(S[i])
        truth = exact.solution(s, exact.pinv_full(s), exact.rational(z[i]))
        right[i], miss[i] = exact.nearest(truth)[:, 0], error(tau[i], truth)[:, 0]
    kappa = np.linalg.cond(S.astype(np.float64) / np.abs(S).max(axis=2, keepdims=True))
    yield figure(GRADED, over(length(miss), bench.eps * kappa * length(right)))


def _scaled(task: Task, bench: Bench) -> Iterator[Figure]:
    """Rows times 2^k on full rank, all of S times 2^k on any rank: the same bits (tau), or 2^-k exactly (S+)."""
    generator = task.generator()
    N, m, l = task.systems, task.m, task.l
    reach = 300 if task.scalar == "float64" else 40
    S = bench.round(generator.standard_normal((N, m, l)))
    S[::3] = bench.round(generator.integers(-2, 3, (N, m, l)))[::3]
    z, y = _tasks_of(S, generator, bench)
    tau, info = bench.solve(S, z, y)
    X, _ = bench.pinv(S)
    k = generator.integers(-reach, reach + 1, (N, m))
    k = np.where(((info["rank"] == m) & (np.arange(N) % 2 == 0))[:, None], k, k[:, :1])
    scaled_tau, _ = bench.solve(np.ldexp(S, k[:, :, None]), np.ldexp(z, k), y)
    scaled_X, _ = bench.pinv(np.ldexp(S, k[:, :, None]))
    differ = (scaled_tau != tau).any(axis=1) | (np.ldexp(scaled_X, k[:, None, :]) != X).any(axis=(1, 2))
    yield figure(BITS, differ)


def _flipped(task: Task, bench: Bench) -> Iterator[Figure]:
    """Signs of rows (and of z) and of columns (and of y) flipped on full rank: the same bits but for the signs."""
    generator = task.generator()
    N, m, l = task.systems, task.m, task.l
    sigma = spectra(N, min(m, l), _largest_condition(task, bench), generator)
    S = bench.round(with_spectra(m, l, sigma, generator))
    z, y = _tasks_of(S, generator, bench)
    rows, columns = (bench.round(generator.choice([-1.0, 1.0], (N, k))) for k in (m, l))
    flipped = S * rows[:, :, None] * columns[:, None, :]
    tau, _ = bench.solve(S, z, y)
    flipped_tau, _ = bench.solve(flipped, z * rows, y * columns)
    X, _ = bench.pinv(S)
    flipped_X, _ = bench.pinv(flipped)
    differ = (flipped_tau * columns != tau).any(axis=1)
    differ |= (flipped_X * columns[:, :, None] * rows[:, None, :] != X).any(axis=(1, 2))
    yield figure(BITS, differ)


def _nearly_met(B: FloatArray, z: FloatArray) -> bool:
    """Whether some tau leaves less than a hundredth of z in each row: too close to call in float32."""
    rest = z - B @ np.linalg.lstsq(B, z, rcond=None)[0]
    return bool(np.abs(rest).max() <= 1e-2 * np.abs(z).max())


def _products(task: Task, bench: Bench, consistent: bool) -> Iterator[Figure]:
    """S = B C of small integers, below full row rank; z met exactly, or not at all."""
    generator = task.generator()
    N, m, l = task.systems, task.m, task.l
    most = _largest_condition(task, bench)
    factors = [integer_factors(m, l, 1 + i % min(m - 1, l), most, generator) for i in range(N)]
    S = bench.round(np.array([B @ C for B, C in factors]))
    x = generator.integers(-4, 5, (N, l)).astype(np.float64)
    z = np.einsum("nij,nj->ni", S.astype(np.float64), x)
    if not consistent:
        for i, (B, _) in enumerate(factors):
            z[i] = generator.integers(-9, 10, m)
            while _nearly_met(B, z[i]):
                z[i] = generator.integers(-9, 10, m)
    z = bench.round(z)
    y = bench.round(generator.integers(-2, 3, (N, l)) * (np.arange(N) % 2)[:, None])
    truths = [exact.pinv_product(exact.rational(B), exact.rational(C)) for B, C in factors]
    _, info = bench.solve(S, z, y)
    expected = Status.RANK_DEFICIENT_CONSISTENT if consistent else Status.RANK_DEFICIENT_INCONSISTENT
    yield from answers(info, [B.shape[1] for B, _ in factors], [expected] * N)
    yield from accuracy(bench, S, z, y, truths, (TAU_R if consistent else TAU_LS, PINV_R))


def _ddrvls(task: Task, bench: Bench) -> Iterator[Figure]:
    """LAPACK's pairs: full rank and rank 3/4, at size 1, near overflow and near underflow; y = 0, z met exactly."""
    generator = task.generator()
    N, m, l = task.systems, task.m, task.l
    n = min(m, l)
    most = _largest_condition(task, bench)
    top = np.finfo(bench.dtype).maxexp - 20  # S^T z of small integers stays in range
    factors = [integer_factors(m, l, n if i % 2 else max(1, 3 * n // 4), most, generator) for i in range(N)]
    plain = np.array([B @ C for B, C in factors])
    z = np.einsum("nij,nj->ni", plain, generator.integers(-4, 5, (N, l)).astype(np.float64))
    shift = np.array([0, top, -top])[np.arange(N) // 2 % 3]
    S = np.ldexp(bench.round(plain), shift[:, None, None])
    tau, info = bench.solve(S, np.ldexp(bench.round(z), shift[:, None]), bench.round(np.zeros((N, l))))
    yield from bench.ends(info)
    ranks = [B.shape[1] for B, _ in factors]
    yield from answers(info, ranks, [Status.OK if r == m else Status.RANK_DEFICIENT_CONSISTENT for r in ranks])
    X, _ = bench.pinv(S)
    yield from _against(bench, plain, z, tau, np.ldexp(X.astype(np.float64), shift[:, None, None]), factors)


def _against(
    bench: Bench,
    S: FloatArray,
    z: FloatArray,
    tau: FloatArray,
    X: FloatArray,
    factors: Sequence[tuple[FloatArray, FloatArray]],
) -> Iterator[Figure]:
    """Errors of tau and X of S = B C, z met."""
    right, miss, pinv, off = (np.zeros(a.shape) for a in (tau, tau, X, X))
    for i, (B, C) in enumerate(factors):
        truth = exact.pinv_product(exact.rational(B), exact.rational(C))
        answer = truth * exact.rational(z[i])
        right[i], miss[i] = exact.nearest(answer)[:, 0], error(tau[i], answer)[:, 0]
        pinv[i], off[i] = exact.nearest(truth), error(X[i], truth)
    kappa = np.linalg.norm(S, 2, axis=(1, 2)) * np.linalg.norm(pinv, 2, axis=(1, 2))
    yield figure(TAU_R, over(length(miss), bench.eps * kappa * length(right)))
    size = np.linalg.norm(pinv, 2, axis=(1, 2))
    yield figure(PINV_R, over(np.linalg.norm(off, 2, axis=(1, 2)), bench.eps * kappa * size))


def _degenerate_rows(task: Task, bench: Bench) -> Iterator[Figure]:
    """One row zero, or a copy, or a multiple of another; the others at units of their own."""
    generator = task.generator()
    N, m, l = task.systems, task.m, task.l
    most = _largest_condition(task, bench)
    entries = generator.integers(-9, 10, (N, m, l))
    for i in range(N):
        row, other = generator.choice(m, 2, replace=False)
        entries[i, row] = (0, 1, -4)[i % 3] * entries[i, other]
        while nearly_deficient(entries[i], most):
            entries[i] = generator.integers(-9, 10, (m, l))
            entries[i, row] = (0, 1, -4)[i % 3] * entries[i, other]
    S = bench.round(np.ldexp(entries.astype(np.float64), generator.integers(-3, 4, (N, m))[:, :, None]))
    z = np.einsum("nij,nj->ni", S.astype(np.float64), generator.integers(-4, 5, (N, l)).astype(np.float64))
    z = bench.round(z)
    y = bench.round(np.zeros((N, l)))
    matrices = [exact.rational(s) for s in S]
    _, info = bench.solve(S, z, y)
    ranks = [exact.rank(s) for s in matrices]
    yield from answers(info, ranks, [Status.RANK_DEFICIENT_CONSISTENT] * N)
    yield from accuracy(bench, S, z, y, [exact.pinv(s) for s in matrices], (TAU_R, PINV_R))


def _gaps(task: Task, bench: Bench) -> Iterator[Figure]:
    """Singular values of S above 10 rtol or below rtol / 10: the rank has one answer."""
    generator = task.generator()
    n = min(task.m, task.l)
    assert bench.solver.rtol is not None
    rtol = bench.plan.rtol
    ranks = generator.integers(1, n + 1, task.systems)
    sigma = np.where(
        np.arange(n) < ranks[:, None],
        10.0 ** generator.uniform(np.log10(10 * rtol), 0, (task.systems, n)),
        10.0 ** generator.uniform(np.log10(rtol) - 2, np.log10(rtol) - 1, (task.systems, n)),
    )
    sigma[:, 0] = 1.0
    S = bench.round(with_spectra(task.m, task.l, sigma, generator))
    _, info = bench.pinv(S)
    yield figure(RANK, info["rank"] != ranks)
    yield from bench.ends(info)


def _near_tolerance(task: Task, bench: Bench) -> Iterator[Figure]:
    """Rows parallel to an ulp, and singular values within 10 times rtol: either rank will do, one status goes with it,
    and z = S x is met to the tolerance."""
    generator = task.generator()
    N, m, l = task.systems, task.m, task.l
    n = min(m, l)
    row = bench.round(generator.standard_normal((N, 1, l)))
    S = np.where(generator.integers(0, 2, (N, m, l)) > 0, np.nextafter(row, bench.dtype.type(9)), row)
    sigma = np.ones((N, n))
    sigma[:, 1:] = bench.plan.rtol * 10.0 ** generator.uniform(-1, 1, (N, n - 1))
    S[1::2] = bench.round(with_spectra(m, l, sigma, generator))[1::2]
    wide = S.astype(np.float64)
    x = generator.standard_normal((N, l))
    z = bench.round(np.einsum("nij,nj->ni", wide, x))
    tau, info = bench.solve(S, z, bench.round(np.zeros((N, l))))
    yield from bench.ends(info)
    full = info["rank"] == m
    possible = (Status.RANK_DEFICIENT_CONSISTENT, Status.RANK_DEFICIENT_INCONSISTENT)
    yield figure(STATUS, np.where(full, info["status"] != Status.OK, ~np.isin(info["status"], possible)))
    yield figure(RANK, (info["rank"] < 1) | (info["rank"] > n))
    yield figure(TOUCHED, ~np.isfinite(tau).all(axis=1))
    found = tau.astype(np.float64)
    rest = length(z - np.einsum("nij,nj->ni", wide, found))
    yield figure(NEAR, over(rest, bench.plan.rtol * np.linalg.norm(wide, 2, axis=(1, 2)) * (length(x) + length(found))))


def _small_integers(task: Task, bench: Bench) -> Iterator[Figure]:
    """All 2 x 2 over {0, +-1}, with all such z."""
    entries = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=6)))
    yield from decided_exactly(bench, bench.round(entries[:, :4].reshape(-1, 2, 2)), bench.round(entries[:, 4:]))


def _regressions(task: Task, bench: Bench) -> Iterator[Figure]:
    """Matrices on which other libraries failed, of this shape and scalar."""
    found = [r for r in REGRESSIONS if r.shape == (task.m, task.l) and r.only in (None, task.scalar)]
    finite = np.array([r.S for r in found if r.finite])
    if len(finite):
        S = bench.round(finite)
        yield from decided_exactly(bench, S, bench.round(S.sum(axis=2, dtype=np.float64)))
    rest = [r for r in found if not r.finite]
    if rest:
        last = np.full((len(rest), task.l), 7.0, bench.dtype)
        tau, info = bench.solve(bench.round(np.array([r.S for r in rest])), np.zeros((len(rest), task.m)), None, last)
        yield figure(STATUS, info["status"] != Status.NONFINITE)
        yield figure(TOUCHED, (tau != last).any(axis=1))


def _extremes(task: Task, bench: Bench) -> Iterator[Figure]:
    """S and z near overflow and near underflow: the answer is that of both brought to size 1."""
    generator = task.generator()
    N, m, l = task.systems, task.m, task.l
    top = np.finfo(bench.dtype).maxexp - 1
    S = generator.uniform(0.5, 1.0, (N, m, l)) * generator.choice([-1.0, 1.0], (N, m, l))
    z = generator.uniform(0.5, 1.0, (N, m))
    shift = np.array([top, top - 1, -top + 2, -top + 1])[np.arange(N) % 4]
    S = np.ldexp(bench.round(S), shift[:, None, None])
    z = np.ldexp(bench.round(z), shift[:, None])
    tau, info = bench.solve(S, z, bench.round(np.zeros((N, l))))
    yield from bench.ends(info)
    plain, plain_z = (np.ldexp(a.astype(np.float64), -shift.reshape(-1, *[1] * (a.ndim - 1))) for a in (S, z))
    right, miss, rest = np.zeros((N, l)), np.zeros((N, l)), np.zeros((N, m))
    for i in range(N):
        s, zi = exact.rational(plain[i]), exact.rational(plain_z[i])
        answer = exact.solution(s, exact.pinv_full(s), zi)
        right[i], miss[i] = exact.nearest(answer)[:, 0], error(tau[i], answer)[:, 0]
        rest[i] = exact.nearest(zi - s * answer)[:, 0] if m > l else 0.0
    kappa = np.linalg.cond(plain)
    scale = length(right) + kappa * length(rest) / np.linalg.norm(plain, 2, axis=(1, 2))
    yield figure(TAU if m <= l else TAU_LS, over(length(miss), bench.eps * kappa * scale))


def _nonfinite(task: Task, bench: Bench) -> Iterator[Figure]:
    """NaN or infinity at one place of S, z or y: refused, and the outputs as they were."""
    generator = task.generator()
    N, m, l = task.systems, task.m, task.l
    S, z, y = (bench.round(generator.standard_normal(shape)) for shape in ((N, m, l), (N, m), (N, l)))
    for i in range(N):
        target = (S, z, y)[i % 3][i]
        if i % 2:
            S[i, :, generator.integers(l)] = 0.0  # a zero column must hide nothing
        target[np.unravel_index(generator.integers(target.size), target.shape)] = (np.nan, np.inf, -np.inf)[i // 3 % 3]
    last = bench.round(generator.standard_normal((N, l)))
    tau, info = bench.solve(S, z, y, last)
    yield figure(STATUS, info["status"] != Status.NONFINITE)
    yield figure(TOUCHED, (tau != last).any(axis=1))
    bad = S[::3]
    before = bench.round(generator.standard_normal((len(bad), l, m)))
    X, info = bench.pinv(bad, before)
    yield figure(STATUS, info["status"] != Status.NONFINITE)
    yield figure(TOUCHED, np.not_equal(X, before).any(axis=(1, 2)))


def _subnormal(task: Task, bench: Bench) -> Iterator[Figure]:
    """Eigen's list: 2 x 2 of subnormal, smallest and zero entries. No hang, no silent NaN; z = S (1, 1) is met."""
    info = np.finfo(bench.dtype)
    tiny = float(info.smallest_subnormal)
    values = (0.0, tiny, -tiny, 7 * tiny, float(info.tiny), -0.5 * float(info.tiny))
    S = bench.round(np.array(list(itertools.product(values, repeat=4))).reshape(-1, 2, 2))
    z = bench.round(S.sum(axis=2, dtype=np.float64))
    last = np.full((len(S), 2), 7.0, bench.dtype)
    tau, got = bench.solve(S, z, bench.round(np.zeros((len(S), 2))), last)
    untouched = (tau == last).all(axis=1)
    yield figure(TOUCHED, ~np.isfinite(tau).all(axis=1) | ((got["status"] < 0) & ~untouched))
    yield from bench.ends(got)
    yield figure(STATUS, ~np.isin(got["status"], (Status.OK, Status.RANK_DEFICIENT_CONSISTENT)))


def _core(task: Task, bench: Bench) -> Iterator[Figure]:
    """The SVD inside, as ddrvbd: every spectrum to kappa 1 / eps, zeros, identities, near over- and underflow."""
    generator = task.generator()
    N, m, l = task.systems, task.m, task.l
    S = bench.round(with_spectra(m, l, spectra(N, min(m, l), 1 / bench.eps, generator), generator))
    S[0::20], S[1::20] = 0.0, np.eye(m, l)
    reach = np.finfo(bench.dtype).maxexp - 4
    S = np.ldexp(S, np.array([0, 0, 0, reach, -reach // 2])[np.arange(N) % 5][:, None, None])
    for quantity, ratios in zip((SVD_BACK, SVD_LEFT, SVD_RIGHT), core.ratios(S, task.scalar, bench.eps), strict=True):
        yield figure(quantity, ratios)


def _sweeps(task: Task, bench: Bench) -> Iterator[Figure]:
    """Where a textbook Jacobi loop does not end, or slowly: graded both ways, integers, rank one, parallel to ulps."""
    g = task.generator()
    m, l = task.m, task.l
    n = -(-task.systems // 7)
    most = 300 if task.scalar == "float64" else 35
    base = g.standard_normal((n, m, l))
    kinds = (
        g.integers(-1, 2, (n, m, l)),
        g.integers(-3, 4, (n, m, 1)) * g.integers(-3, 4, (n, 1, l)),
        base * 10.0 ** g.uniform(-14, 0, (n, m, 1)) * 10.0 ** g.uniform(-14, 0, (n, 1, l)),
        base[:, :1] * (1 + bench.eps * g.integers(-2, 3, (n, m, l))),
        np.cumprod(np.full((n, m, l), 1e-4), axis=2) * base,
        np.ldexp(base, g.integers(-most, most, (n, m, l))),
        with_spectra(m, l, spectra(n, min(m, l), 1 / bench.eps, g), g),
    )
    S = bench.round(np.concatenate(kinds)[: task.systems])
    last = np.full((len(S), l), 7.0, bench.dtype)
    tau, info = bench.solve(S, bench.round(np.ones((len(S), m))), None, last)
    yield from bench.ends(info)
    yield figure(TOUCHED, ~np.isfinite(tau).all(axis=1) | ((info["status"] < 0) & (tau != last).any(axis=1)))


def _certificates(task: Task, bench: Bench) -> Iterator[Figure]:
    """Whether a certificate was ever given in vain, of the systems given one; and whether each step gives any."""
    found = false_certificates(task.m, task.l, task.scalar, task.systems, seed=task.seed + 1000003 * task.part)
    yield Figure(FALSE_NORMAL, found.false_normal, found.normal)
    yield Figure(FALSE_QR, found.false_qr, found.qr)
    yield Figure(FALSE_QR, found.false_quick, found.quick)
    yield Figure(HIGH_BOUND, found.high_bounds, found.bounds)
    yield Figure(LOW_BOUND, found.low_bounds, found.bounds)
    steps = (found.normal, found.qr, found.quick)
    yield Figure(IDLE, float(sum(accepted == 0 for accepted in steps)), found.systems)


def _every_shape(task: Task, bench: Bench) -> Iterator[Figure]:
    """All shapes: strict warnings of gcc and clang, full rank and below."""
    found = complaints(task.m, task.l, task.scalar, bench.solver)
    yield Figure(COMPLAINTS, float(len(found)), 2)
    yield from _spectra(task, bench)
    if task.m > 1:
        yield from _products(task, bench, True)


def _is_wide(m: int, l: int) -> bool:
    return m <= l


LIMITED_SHAPES = ((1, 3), (3, 2), (3, 4), (4, 6), (3, 7), (6, 7), (6, 12))
_Draw = Callable[[Generator, int, int, int], System]


def _limited(draw: _Draw, shapes: tuple[tuple[int, int], ...] = LIMITED_SHAPES) -> Family:
    return Family(lambda task, bench: within_limits(task, bench, draw), shapes=shapes, part=100, long=True)


SVD, RAW, COD = Solver(method="svd"), Solver(rank="raw"), Solver(method="cod")
GAP = Solver(rank="raw", rtol=2.0**-12)
CORE = "SVD core"
"""The family that calls the SVD inside alone, and no solver."""
OF_COD = ((2, 2), (2, 3), (3, 7), (7, 3), (6, 12), (12, 12))

FAMILIES: dict[str, Family] = {
    "dlatms spectra": Family(_spectra, _is_wide),
    "dlatms spectra, forced SVD": Family(_spectra, _is_wide, SVD),
    "dlatms spectra, raw rank": Family(_spectra, _is_wide, RAW),
    "dlatms spectra, tall": Family(_spectra, lambda m, l: m > l),
    "y taken away": Family(_taken_away, lambda m, l: m in (1, l)),
    "named matrices": Family(_classical, lambda m, l: 1 < m <= l),
    "graded rows": Family(_graded, lambda m, l: 1 < m <= l),
    "scaled by powers of two": Family(_scaled, part=2500),
    "signs flipped": Family(_flipped, part=2500),
    "rank-deficient and consistent": Family(lambda t, b: _products(t, b, True), lambda m, l: m > 1),
    "rank-deficient and inconsistent": Family(lambda t, b: _products(t, b, False), lambda m, l: m > 1),
    "ddrvls pairs": Family(_ddrvls),
    "zero and parallel rows": Family(_degenerate_rows, lambda m, l: m > 1),
    "parallel to an ulp, near rtol": Family(_near_tolerance, lambda m, l: min(m, l) > 1, part=2500),
    "rank with a gap": Family(_gaps, lambda m, l: min(m, l) > 1, GAP, part=2500),
    "near overflow and underflow": Family(_extremes),
    "NaN and infinity": Family(_nonfinite, part=1000),
    CORE: Family(_core, lambda m, l: min(m, l) > 1, SVD, part=2500, tools=("gcc",)),
    "sweeps": Family(_sweeps, lambda m, l: min(m, l) > 1, SVD, times=10, part=5000),
    "2x2 of 0 and +-1": Family(_small_integers, lambda m, l: (m, l) == (2, 2), finite=True),
    "subnormal 2x2": Family(_subnormal, lambda m, l: (m, l) == (2, 2), finite=True),
    "regressions": Family(_regressions, finite=True, shapes=tuple(sorted({r.shape for r in REGRESSIONS}))),
    **{f"limits: {name}": _limited(draw) for name, draw in LIMITED.items()},
    "limits: crossed and NaN": Family(crossed, shapes=LIMITED_SHAPES, part=1000, long=True),
    "certificates": Family(
        _certificates,
        shapes=((2, 2), (2, 3), (3, 4), (3, 7), (6, 7), (6, 12)),
        times=100,
        part=200_000,
        long=True,
        tools=("gcc",),
    ),
    "dlatms spectra, COD": Family(_spectra, solver=COD, shapes=OF_COD),
    "rank-deficient and consistent, COD": Family(lambda t, b: _products(t, b, True), solver=COD, shapes=OF_COD),
    "rank-deficient and inconsistent, COD": Family(lambda t, b: _products(t, b, False), solver=COD, shapes=OF_COD),
    "zero and parallel rows, COD": Family(_degenerate_rows, solver=COD, shapes=OF_COD),
    "near overflow and underflow, COD": Family(_extremes, solver=COD, shapes=OF_COD),
    "NaN and infinity, COD": Family(_nonfinite, solver=COD, shapes=OF_COD, part=1000),
    "every shape, COD": Family(
        _every_shape, solver=COD, shapes=EVERY, times=0.036, part=1000, long=True, tools=("gcc", "clang")
    ),
    "every shape": Family(_every_shape, shapes=EVERY, times=0.036, part=1000, long=True, tools=("gcc", "clang")),
}
