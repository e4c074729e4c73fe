"""Numerical stress of the solver: families of matrices against exact rationals, each figure beside its bar.

The families, quantities and bars are those of NUMERICS: What the tests must show. Every system comes from the seed, so
that a report is reproduced by its seed and sizes; a figure is the largest over its systems.
"""

import functools
import itertools
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any, Protocol, cast

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from servogen import exact
from servogen.plan.solver import SolverPlan, plan_solver
from servogen.results import FloatArray, Status
from servogen.scalars import EPSILON, Scalar
from servogen.scene.solver import Solver

SHAPES = ((1, 2), (1, 3), (2, 2), (2, 3), (3, 3), (3, 4), (3, 7), (6, 7), (6, 12), (12, 12), (3, 2), (7, 3), (4, 1))
SCALARS: tuple[Scalar, ...] = ("float64", "float32")

BARS: dict[str, float] = {
    "error of tau / (u kappa (|tau| + |y|))": 4,
    "error of S+ / (u kappa |S+|)": 5,
    "residual / (u (|S| |tau| + |z|))": 1.5,
    "error of tau / (u kappa(D^-1 S) (|tau| + |y|))": 4,
    "results whose bits differ": 0,
    "wrong rank": 0,
    "wrong status": 0,
    "error of tau / (u kappa_r (|tau| + |y|))": 8,
    "error of tau / (u kappa_r (|tau| + |y| + kappa_r |residual| / |S|))": 8,
    "error of S+ / (u kappa_r |S+|)": 8,
    "Penrose identities / (u kappa)": 10,
    "outputs touched or silent NaN": 0,
    "sweeps / cap": 1,
    "NOT_CONVERGED": 0,
}

TAU, PINV, RESIDUAL, GRADED, BITS, RANK, STATUS, TAU_R, TAU_LS, PINV_R, PENROSE, TOUCHED, SWEEPS, CAPPED = BARS


class SolverTwin(Protocol):
    """What `servogen.build_solver(...).load()` gives, here called on stacks: infos as a record array or a sequence."""

    def solve(self, S: Any, z: Any, y: Any = None, last: Any = None) -> tuple[Any, Any]: ...

    def pinv(self, S: Any, last: Any = None) -> tuple[Any, Any]: ...


MakeTwin = Callable[[int, int, Scalar, Solver], SolverTwin]
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class StressRow:
    """The largest figure of one quantity over one family."""

    family: str
    scalar: str
    quantity: str
    bar: float
    largest: float
    shape: str  # where the largest occurred
    systems: int
    passed: bool


@dataclass(frozen=True)
class StressReport:
    seed: int
    systems: int  # asked for, per family, shape and scalar
    rows: tuple[StressRow, ...]

    @property
    def passed(self) -> bool:
        return all(row.passed for row in self.rows)

    def to_json(self) -> dict[str, Any]:
        return {
            "seed": self.seed,
            "systems": self.systems,
            "passed": self.passed,
            "rows": [asdict(r) for r in self.rows],
        }


@dataclass(frozen=True)
class Task:
    """One family on one shape: what a process works on."""

    family: str
    m: int
    l: int
    scalar: Scalar
    systems: int
    seed: int

    def generator(self) -> Generator:
        key = zlib.crc32(f"{self.family} {self.m}x{self.l} {self.scalar}".encode())
        return np.random.default_rng([self.seed, key])


@dataclass(frozen=True)
class Measured:
    """The figures of one quantity, one per system."""

    quantity: str
    figures: NDArray[np.float64]


def stress(
    make: MakeTwin | None = None,
    *,
    seed: int = 1,
    systems: int = 200,
    shapes: Sequence[tuple[int, int]] = SHAPES,
    scalars: Sequence[Scalar] = SCALARS,
    families: Sequence[str] | None = None,
    jobs: int = 1,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> StressReport:
    """Every family on every shape it has, `systems` matrices each.

    make(m, l, scalar, solver) gives the twin under test; by default it is the package of `servogen.build_solver`.
    The tasks run on `executor` if one is given (dask.distributed's Client.get_executor(), say), else in `jobs`
    processes; in both cases `make` must be picklable. Raises ValueError for an unknown family.
    """
    chosen = tuple(FAMILIES) if families is None else tuple(families)
    unknown = [name for name in chosen if name not in FAMILIES]
    if unknown:
        raise ValueError(f"no family {unknown[0]!r}; choose from {', '.join(FAMILIES)}")
    twin = built if make is None else make
    tasks = [
        Task(name, m, l, scalar, systems, seed)
        for name, scalar, (m, l) in itertools.product(chosen, scalars, shapes)
        if FAMILIES[name].applies(m, l)
    ]
    results: list[tuple[Task, list[Measured]]] = []
    for task, measured in _run_all(tasks, twin, jobs, executor):
        results.append((task, measured))
        if progress is not None:
            progress(len(results), len(tasks), f"{task.family} {task.m}x{task.l} {task.scalar}")
    return StressReport(seed, systems, tuple(_rows(results)))


@functools.cache
def built(m: int, l: int, scalar: Scalar, solver: Solver) -> SolverTwin:
    """The generated and compiled package for one shape."""
    from servogen.compiler import build_solver

    return cast(SolverTwin, build_solver(m, l, scalar=scalar, solver=solver).load())


def _run_all(
    tasks: Sequence[Task], make: MakeTwin, jobs: int, executor: Executor | None
) -> Iterator[tuple[Task, list[Measured]]]:
    if executor is not None:
        yield from zip(tasks, executor.map(run, tasks, itertools.repeat(make, len(tasks))), strict=True)
        return
    if jobs == 1:
        for task in tasks:
            yield task, run(task, make)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from zip(tasks, pool.map(run, tasks, itertools.repeat(make)), strict=True)


def run(task: Task, make: MakeTwin) -> list[Measured]:
    """The figures of one task."""
    return list(FAMILIES[task.family].measure(task, Bench(task, make)))


def _rows(results: Sequence[tuple[Task, list[Measured]]]) -> Iterator[StressRow]:
    grouped: dict[tuple[str, str, str], list[tuple[Task, NDArray[np.float64]]]] = {}
    for task, measured in results:
        for one in measured:
            if one.figures.size:
                grouped.setdefault((task.family, task.scalar, one.quantity), []).append((task, one.figures))
    for (family, scalar, quantity), parts in grouped.items():
        # a NaN is the worst figure of all
        worst = [float(np.nan_to_num(figures, nan=np.inf, posinf=np.inf).max()) for _, figures in parts]
        at = int(np.argmax(worst))
        task = parts[at][0]
        yield StressRow(
            family=family,
            scalar=scalar,
            quantity=quantity,
            bar=BARS[quantity],
            largest=worst[at],
            shape=f"{task.m}x{task.l}",
            systems=sum(figures.size for _, figures in parts),
            passed=worst[at] <= BARS[quantity],
        )


# ---- running the twin under test -----------


class Bench:
    """The twin of one task, and its answers as arrays."""

    def __init__(self, task: Task, make: MakeTwin) -> None:
        self.task, self.make = task, make
        self.u = EPSILON[task.scalar]
        self.dtype = np.dtype(task.scalar)
        self.plan: SolverPlan = plan_solver(task.m, task.l, task.scalar, Solver())
        self.twin = make(task.m, task.l, task.scalar, Solver())

    def solve(
        self, S: FloatArray, z: FloatArray, y: FloatArray | None, last: FloatArray | None = None
    ) -> tuple[FloatArray, dict[str, NDArray[Any]]]:
        tau, info = self.twin.solve(S, z, y, last)
        return np.asarray(tau), _columns(info)

    def pinv(self, S: FloatArray, last: FloatArray | None = None) -> tuple[FloatArray, dict[str, NDArray[Any]]]:
        matrix, info = self.twin.pinv(S, last)
        return np.asarray(matrix), _columns(info)

    def round(self, A: NDArray[Any]) -> FloatArray:
        """To the target type: what is fed, and what the truth is made from."""
        return np.asarray(A, self.dtype)


def _columns(info: Any) -> dict[str, NDArray[Any]]:
    names = ("status", "path", "rank", "sweeps", "sigma_min", "residual")
    if isinstance(info, np.ndarray) and info.dtype.names:
        return {name: np.asarray(info[name]) for name in names}
    if isinstance(info, Sequence):
        return {name: np.array([getattr(one, name) for one in info]) for name in names}
    return {name: np.asarray(getattr(info, name)) for name in names}


def _termination(bench: Bench, info: dict[str, NDArray[Any]]) -> Iterator[Measured]:
    if bench.plan.sweep_cap:
        yield Measured(SWEEPS, info["sweeps"] / bench.plan.sweep_cap)
        yield Measured(CAPPED, (info["status"] == Status.NOT_CONVERGED).astype(float))


def _norm2(A: FloatArray) -> float:
    return float(np.linalg.norm(A, 2))


# ---- what is measured -----------


def _accuracy(
    bench: Bench,
    S: FloatArray,
    z: FloatArray,
    y: FloatArray,
    truths: Sequence[exact.Matrix],
    quantities: tuple[str, str] = (TAU, PINV),
    *,
    full: bool = True,
) -> Iterator[Measured]:
    """Errors of tau and S+ over u kappa, against S+ in rationals; on full rank the residual and Penrose as well."""
    tau, info = bench.solve(S, z, y)
    X, pinv_info = bench.pinv(S)
    yield from _termination(bench, info)
    yield from _termination(bench, pinv_info)
    errors, pinv_errors, residuals, penrose = [], [], [], []
    for i, truth in enumerate(truths):
        s, zi, yi = (exact.rational(a[i]) for a in (S, z, y))
        right = exact.solution(s, truth, zi, yi)
        right_tau = exact.nearest(right)[:, 0]
        wide = S[i].astype(np.float64)
        S_pinv = exact.nearest(truth)
        kappa = max(_norm2(S_pinv) * _norm2(wide), 1.0)
        size = float(np.linalg.norm(right_tau) + np.linalg.norm(y[i].astype(np.float64)))
        if quantities[0] == TAU_LS:
            rest = exact.nearest(zi - s * right)[:, 0]
            size += kappa * float(np.linalg.norm(rest)) / max(_norm2(wide), np.finfo(np.float64).tiny)
        miss = float(np.linalg.norm(exact.difference(tau[i], right)))
        errors.append(0.0 if miss == 0 else miss / (bench.u * kappa * size))
        off = _norm2(exact.difference(X[i], truth))
        pinv_errors.append(0.0 if off == 0 else off / (bench.u * kappa * _norm2(S_pinv)))
        if full:
            rest = exact.nearest(zi - s * exact.rational(tau[i]))[:, 0]
            allowed = _norm2(wide) * float(np.linalg.norm(tau[i].astype(np.float64)))
            allowed += float(np.linalg.norm(z[i].astype(np.float64)))
            residuals.append(float(np.linalg.norm(rest)) / (bench.u * allowed))
            penrose.append(_penrose(S[i], X[i]) / (bench.u * kappa))
    yield Measured(quantities[0], np.array(errors))
    yield Measured(quantities[1], np.array(pinv_errors))
    if full:
        yield Measured(RESIDUAL, np.array(residuals))
        yield Measured(PENROSE, np.array(penrose))


def _penrose(S: FloatArray, X: FloatArray) -> float:
    """The largest of the four identities' errors, relative; products in extended precision."""
    A, B = S.astype(np.longdouble), X.astype(np.longdouble)
    AB, BA = A @ B, B @ A
    if not B.any():
        return float("inf")
    errors = ((AB @ A - A) / np.abs(A).max(), (BA @ B - B) / np.abs(B).max(), AB - AB.T, BA - BA.T)
    return max(float(np.abs(e).max()) for e in errors)


def _answers(
    bench: Bench, info: dict[str, NDArray[Any]], ranks: Sequence[int], ok: Sequence[int]
) -> Iterator[Measured]:
    yield Measured(RANK, (info["rank"] != np.array(ranks)).astype(float))
    yield Measured(STATUS, (info["status"] != np.array(ok)).astype(float))


# ---- families -----------


@dataclass(frozen=True)
class Family:
    measure: Callable[[Task, Bench], Iterator[Measured]]
    applies: Callable[[int, int], bool]


MODES: dict[str, Callable[[int, float, Generator], FloatArray]] = {
    "one large": lambda n, k, _: np.where(np.arange(n) == 0, 1.0, 1 / k),
    "one small": lambda n, k, _: np.where(np.arange(n) == n - 1, 1 / k, 1.0),
    "geometric": lambda n, k, _: k ** -(np.arange(n) / max(n - 1, 1)),
    "arithmetic": lambda n, k, _: 1 - np.arange(n) / max(n - 1, 1) * (1 - 1 / k),
    "log-uniform": lambda n, k, g: k ** -g.uniform(0, 1, n),
    "random": lambda n, k, g: np.abs(g.standard_normal(n)) + 1 / k,
}
"""The spectra of LAPACK's dlatms, modes 1 to 6."""


def orthogonal(n: int, generator: Generator) -> FloatArray:
    """Haar-distributed n x n."""
    Q, R = np.linalg.qr(generator.standard_normal((n, n)))
    return np.asarray(Q * np.sign(np.diag(R)))


def with_spectrum(m: int, l: int, sigma: FloatArray, generator: Generator) -> FloatArray:
    n = min(m, l)
    return np.asarray((orthogonal(m, generator)[:, :n] * sigma) @ orthogonal(l, generator)[:, :n].T)


def spectrum(n: int, index: int, largest: float, generator: Generator) -> FloatArray:
    """One of the modes in turn, both ways round, kappa log-uniform up to `largest`."""
    modes = list(MODES.values())
    sigma = modes[index % len(modes)](n, largest ** float(generator.uniform(0, 1)), generator)
    return sigma[::-1] if index // len(modes) % 2 else sigma


def _tasks_of(S: FloatArray, generator: Generator, bench: Bench) -> tuple[FloatArray, FloatArray]:
    """z in turn random and from a random tau, y in turn zero and random."""
    N, m, l = S.shape
    z = generator.standard_normal((N, m))
    z[1::2] = np.einsum("nij,nj->ni", S[1::2].astype(np.float64), generator.standard_normal((N, l))[1::2])
    y = generator.standard_normal((N, l)) * (np.arange(N) // 2 % 2)[:, None]
    return bench.round(z), bench.round(y)


def _spectra(task: Task, bench: Bench) -> Iterator[Measured]:
    generator = task.generator()
    n, most = min(task.m, task.l), 0.1 / (max(task.m, task.l) * bench.u)
    S = bench.round(
        np.array(
            [with_spectrum(task.m, task.l, spectrum(n, i, most, generator), generator) for i in range(task.systems)]
        )
    )
    z, y = _tasks_of(S, generator, bench)
    truths = [exact.pinv_full(exact.rational(s)) for s in S]
    yield from _accuracy(bench, S, z, y, truths)
    yield Measured(RANK, (bench.solve(S, z, y)[1]["rank"] != n).astype(float))


def _classical(task: Task, bench: Bench) -> Iterator[Measured]:
    """Matrices with names, permuted and with signs flipped; those worse than 0.1 / (max(m, l) u) are left out."""
    generator = task.generator()
    m, l = task.m, task.l
    most = 0.1 / (max(m, l) * bench.u)
    kept: list[FloatArray] = []
    for i in range(20 * task.systems):
        if len(kept) == task.systems:
            break
        A = CLASSICAL[list(CLASSICAL)[i % len(CLASSICAL)]](m, l, generator)
        A = generator.permuted(A[:, generator.permutation(l)], axis=0) if i % 2 else A
        A = bench.round(A * generator.choice([-1.0, 1.0], (m, 1)) * generator.choice([-1.0, 1.0], l))
        with np.errstate(all="ignore"):
            if np.linalg.cond(A.astype(np.float64)) <= most:
                kept.append(A)
    S = np.array(kept)
    z, y = _tasks_of(S, generator, bench)
    yield from _accuracy(bench, S, z, y, [exact.pinv_full(exact.rational(s)) for s in S])


def _grid(m: int, l: int) -> tuple[FloatArray, FloatArray]:
    return np.arange(m, dtype=np.float64)[:, None], np.arange(l, dtype=np.float64)[None, :]


def _kahan(m: int, l: int, generator: Generator) -> FloatArray:
    c = float(generator.uniform(0.05, 0.95))
    i, j = _grid(m, l)
    return np.asarray((1 - c * c) ** (i / 2) * np.where(j == i, 1.0, np.where(j > i, -c, 0.0)))


def _bidiagonal(m: int, l: int, generator: Generator) -> FloatArray:
    i, j = _grid(m, l)
    ratio = 10.0 ** -generator.uniform(0, 2)
    return np.asarray(ratio**i * ((j == i) + (j == i + 1)))


CLASSICAL: dict[str, Callable[[int, int, Generator], FloatArray]] = {
    "Hilbert": lambda m, l, g: np.asarray(1 / (np.add(*_grid(m, l)) + 1 + g.integers(0, 5))),
    "Kahan": _kahan,
    "Laeuchli": lambda m, l, g: (
        np.where(_grid(m, l)[1] == 0, 1.0, 0.0)
        + 10.0 ** -g.uniform(0, 7) * (_grid(m, l)[1] == _grid(m, l)[0] + 1 if l > m else np.eye(m, l))
    ),
    "Vandermonde": lambda m, l, g: np.vander(g.uniform(-1, 1, m), l),
    "Wilkinson": lambda m, l, g: np.eye(m, l) * np.abs(np.arange(l) - (m - 1) / 2) + np.eye(m, l, 1) + np.eye(m, l, -1),
    "graded bidiagonal": _bidiagonal,
    "D1 C D2": lambda m, l, g: (
        g.standard_normal((m, l)) * 10.0 ** -g.uniform(0, 3, (m, 1)) * 10.0 ** -g.uniform(0, 3, l)
    ),
    "parallel to an ulp": lambda m, l, g: (
        g.standard_normal(l) * (1 + 2.0 ** -g.integers(4, 40) * g.standard_normal((m, l)))
    ),
}
"""Test matrices of the literature (NUMERICS: Families)."""


def _graded(task: Task, bench: Bench) -> Iterator[Measured]:
    generator = task.generator()
    N, m, l = task.systems, task.m, task.l
    base = np.array([with_spectrum(m, l, spectrum(m, i, 1e3, generator), generator) for i in range(N)])
    D = 10.0 ** -generator.uniform(0, 14, (N, m))
    D[:, 0], D[:, -1] = 1.0, 1e-14
    D = generator.permuted(D, axis=1)
    S = bench.round(D[:, :, None] * base)
    z = bench.round(D * generator.standard_normal((N, m)))
    y = bench.round(np.zeros((N, l)))
    tau, info = bench.solve(S, z, y)
    yield from _termination(bench, info)
    yield from _answers(bench, info, [m] * N, [Status.OK] * N)
    figures = []
    for i in range(N):
        rows = np.abs(S[i].astype(np.float64)).max(axis=1)
        kappa = float(np.linalg.cond(S[i] / rows[:, None]))
        s = exact.rational(S[i])
        right = exact.solution(s, exact.pinv_full(s), exact.rational(z[i]))
        error = float(np.linalg.norm(exact.difference(tau[i], right)))
        figures.append(error / (bench.u * kappa * float(np.linalg.norm(exact.nearest(right)))))
    yield Measured(GRADED, np.array(figures))


def _scaled(task: Task, bench: Bench) -> Iterator[Measured]:
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
    yield Measured(BITS, differ.astype(float))


def _integers(m: int, l: int, rank: int, generator: Generator) -> tuple[FloatArray, FloatArray]:
    """B (m x rank) and C (rank x l) of full rank, small integers."""
    while True:
        B, C = generator.integers(-3, 4, (m, rank)), generator.integers(-3, 4, (rank, l))
        if np.linalg.matrix_rank(B) == rank == np.linalg.matrix_rank(C):
            return B.astype(np.float64), C.astype(np.float64)


def _nearly_met(B: FloatArray, z: FloatArray) -> bool:
    """Whether some tau leaves less than a hundredth of z in each row: too close to call in float32."""
    rest = z - B @ np.linalg.lstsq(B, z, rcond=None)[0]
    return bool(np.abs(rest).max() <= 1e-2 * np.abs(z).max())


def _products(task: Task, bench: Bench, consistent: bool) -> Iterator[Measured]:
    generator = task.generator()
    N, m, l = task.systems, task.m, task.l
    factors = [_integers(m, l, 1 + i % min(m - 1, l), generator) for i in range(N)]
    S = bench.round(np.array([B @ C for B, C in factors]))
    x = generator.integers(-4, 5, (N, l)).astype(np.float64)
    z = np.einsum("nij,nj->ni", S.astype(np.float64), x)
    if not consistent:
        # along a null vector of S^T the residual stays
        for i, (B, _) in enumerate(factors):
            z[i] = generator.integers(-9, 10, m)
            while _nearly_met(B, z[i]):
                z[i] = generator.integers(-9, 10, m)
    z = bench.round(z)
    y = bench.round(generator.integers(-2, 3, (N, l)) * (np.arange(N) % 2)[:, None])
    truths = [exact.pinv_product(exact.rational(B), exact.rational(C)) for B, C in factors]
    _, info = bench.solve(S, z, y)
    expected = Status.RANK_DEFICIENT_CONSISTENT if consistent else Status.RANK_DEFICIENT_INCONSISTENT
    yield from _answers(bench, info, [B.shape[1] for B, _ in factors], [expected] * N)
    yield from _accuracy(bench, S, z, y, truths, (TAU_R if consistent else TAU_LS, PINV_R), full=False)


def _degenerate_rows(task: Task, bench: Bench) -> Iterator[Measured]:
    """One row zero, or a copy, or a multiple of another; the others at units of their own."""
    generator = task.generator()
    N, m, l = task.systems, task.m, task.l
    entries = generator.integers(-9, 10, (N, m, l))
    for i in range(N):
        row, other = generator.choice(m, 2, replace=False)
        entries[i, row] = (0, 1, -4)[i % 3] * entries[i, other]
    S = bench.round(np.ldexp(entries.astype(np.float64), generator.integers(-3, 4, (N, m))[:, :, None]))
    z = np.einsum("nij,nj->ni", S.astype(np.float64), generator.integers(-4, 5, (N, l)).astype(np.float64))
    z = bench.round(z)
    y = bench.round(np.zeros((N, l)))
    matrices = [exact.rational(s) for s in S]
    _, info = bench.solve(S, z, y)
    ranks = [exact.rank(s) for s in matrices]
    yield from _answers(bench, info, ranks, [Status.RANK_DEFICIENT_CONSISTENT] * N)
    yield from _accuracy(bench, S, z, y, [exact.pinv(s) for s in matrices], (TAU_R, PINV_R), full=False)


def _small_integers(task: Task, bench: Bench) -> Iterator[Measured]:
    """All 2 x 2 over {0, +-1}, with all such z."""
    entries = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=6)))
    S = bench.round(entries[:, :4].reshape(-1, 2, 2))
    z = bench.round(entries[:, 4:])
    yield from _against_decisions(bench, S, z)


def _regressions(task: Task, bench: Bench) -> Iterator[Measured]:
    """Matrices on which other libraries failed, of this shape (NUMERICS names the issues)."""
    found = [np.array(A, float) for A in REGRESSIONS if np.shape(A) == (task.m, task.l)]
    S = bench.round(np.array(found))
    z = bench.round(np.array([A.sum(axis=1) for A in found]))
    yield from _against_decisions(bench, S, z)


REGRESSIONS: tuple[Any, ...] = (
    [[1, 2], [1, 2]],  # casadi#1820
    [[1, 2], [2, 4]],
    [[1, 2, 3], [2, 1, 3], [3, 1, 4]],
    [[5e-30, 0, 1, 0, 0, 6e-16, 0, 0], [0, 6e-16, 0, 0, 1, 0, 0, 0], [0, 0, 6e-16, 1, 0, 0, 0, 1]],  # nalgebra#1313
    [[0, 0], [2.2250738585072014e-308, 1]],  # a column of realmin, LAPACK#565
    [[-0.5, 0.5, 0.5, -0.5], [0.5, -0.5, 0.5, -0.5], [1e-2, 1e-2, -1e-2, -1e-2]],  # PX4-Matrix#148
)


def _against_decisions(bench: Bench, S: FloatArray, z: FloatArray) -> Iterator[Measured]:
    """Rank and status decided exactly, and the errors of tau and S+."""
    y = bench.round(np.zeros((len(S), S.shape[2])))
    matrices = [exact.rational(s) for s in S]
    truths = [exact.pinv(s) for s in matrices]
    ranks = [exact.rank(s) for s in matrices]
    statuses = []
    for s, truth, zi, rank in zip(matrices, truths, z, ranks, strict=True):
        target = exact.rational(zi)
        if rank == s.nrows():
            statuses.append(Status.OK)
        elif s * truth * target == target:
            statuses.append(Status.RANK_DEFICIENT_CONSISTENT)
        else:
            statuses.append(Status.RANK_DEFICIENT_INCONSISTENT)
    _, info = bench.solve(S, z, y)
    yield from _answers(bench, info, ranks, statuses)
    yield from _accuracy(bench, S, z, y, truths, (TAU_LS, PINV_R), full=False)


def _extremes(task: Task, bench: Bench) -> Iterator[Measured]:
    """S near overflow and near underflow, z at the same scale, y apart: exact rationals know no such limits."""
    generator = task.generator()
    N, m, l = task.systems, task.m, task.l
    top = np.finfo(bench.dtype).maxexp - 1
    S = generator.uniform(0.5, 1.0, (N, m, l)) * generator.choice([-1.0, 1.0], (N, m, l))
    z = generator.uniform(0.5, 1.0, (N, m))
    shift = np.array([top, top - 1, -top + 2, -top + 1])[np.arange(N) % 4]
    S = np.ldexp(bench.round(S), shift[:, None, None])
    z = np.ldexp(bench.round(z), shift[:, None])
    y = bench.round(np.zeros((N, l)))
    tau, info = bench.solve(S, z, y)
    yield from _termination(bench, info)
    figures = []
    for i in range(N):
        s, zi = exact.rational(S[i]), exact.rational(z[i])
        truth = exact.pinv_full(s)
        right = exact.solution(s, truth, zi)
        A = np.ldexp(S[i].astype(np.float64), -shift[i])
        kappa = float(np.linalg.cond(A))
        size = float(np.linalg.norm(exact.nearest(right)))
        if m > l:
            size += kappa * float(np.linalg.norm(np.ldexp(exact.nearest(zi - s * right)[:, 0], -shift[i]))) / _norm2(A)
        figures.append(float(np.linalg.norm(exact.difference(tau[i], right))) / (bench.u * kappa * size))
    yield Measured(TAU if m <= l else TAU_LS, np.array(figures))


def _nonfinite(task: Task, bench: Bench) -> Iterator[Measured]:
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
    yield Measured(STATUS, (info["status"] != Status.NONFINITE).astype(float))
    yield Measured(TOUCHED, (tau != last).any(axis=1).astype(float))
    bad = S[::3]
    before = bench.round(generator.standard_normal((len(bad), l, m)))
    X, info = bench.pinv(bad, before)
    yield Measured(STATUS, (info["status"] != Status.NONFINITE).astype(float))
    yield Measured(TOUCHED, (np.not_equal(X, before)).any(axis=(1, 2)).astype(float))


def _gaps(task: Task, bench: Bench) -> Iterator[Measured]:
    """Singular values of the row-scaled S above 10 rtol or below rtol / 10: the rank has one answer."""
    generator = task.generator()
    n = min(task.m, task.l)
    rtol = bench.plan.rtol
    solver = Solver(rank="raw", rtol=1000 * rtol)  # rounding noise, near max(m, l) u, stays far below
    twin = bench.make(task.m, task.l, task.scalar, solver)
    ranks = generator.integers(1, n + 1, task.systems)
    sigma = np.where(
        np.arange(n) < ranks[:, None],
        10.0 ** generator.uniform(np.log10(min(1e4 * rtol, 0.5)), 0, (task.systems, n)),
        10.0 ** generator.uniform(np.log10(rtol) + 1, np.log10(rtol) + 2, (task.systems, n)),
    )
    sigma[:, 0] = 1.0
    S = bench.round(np.array([with_spectrum(task.m, task.l, s, generator) for s in sigma]))
    _, info = twin.pinv(S)
    columns = _columns(info)
    yield Measured(RANK, (columns["rank"] != ranks).astype(float))
    yield from _termination(bench, columns)


def _denormals(task: Task, bench: Bench) -> Iterator[Measured]:
    """Eigen's list: 2 x 2 of subnormal, smallest and zero entries. No hang, no silent NaN; z = S (1, 1) is met."""
    info = np.finfo(bench.dtype)
    tiny = float(info.smallest_subnormal)
    values = (0.0, tiny, -tiny, 7 * tiny, float(info.tiny), -0.5 * float(info.tiny))
    S = bench.round(np.array(list(itertools.product(values, repeat=4))).reshape(-1, 2, 2))
    z = bench.round(S.sum(axis=2, dtype=np.float64))
    y = bench.round(np.zeros((len(S), 2)))
    last = np.full((len(S), 2), 7.0, bench.dtype)
    tau, got = bench.solve(S, z, y, last)
    untouched = (tau == last).all(axis=1)
    wrong = ~np.isfinite(tau).all(axis=1) | ((got["status"] < 0) & ~untouched)
    yield Measured(TOUCHED, wrong.astype(float))
    yield from _termination(bench, got)
    yield Measured(STATUS, (~np.isin(got["status"], (Status.OK, Status.RANK_DEFICIENT_CONSISTENT))).astype(float))


FAMILIES: dict[str, Family] = {
    "spectra": Family(_spectra, lambda m, l: m <= l),
    "classical": Family(_classical, lambda m, l: 1 < m <= l),
    "graded rows": Family(_graded, lambda m, l: 1 < m <= l),
    "scaled by powers of two": Family(_scaled, lambda m, l: True),
    "rank-deficient and consistent": Family(lambda t, b: _products(t, b, True), lambda m, l: m > 1),
    "rank-deficient and inconsistent": Family(lambda t, b: _products(t, b, False), lambda m, l: m > 1),
    "zero and parallel rows": Family(_degenerate_rows, lambda m, l: m > 1),
    "2x2 of 0 and +-1": Family(_small_integers, lambda m, l: (m, l) == (2, 2)),
    "regressions": Family(_regressions, lambda m, l: any(np.shape(A) == (m, l) for A in REGRESSIONS)),
    "near overflow and underflow": Family(_extremes, lambda m, l: True),
    "NaN and infinity": Family(_nonfinite, lambda m, l: True),
    "rank with a gap": Family(_gaps, lambda m, l: min(m, l) > 1),
    "subnormal 2x2": Family(_denormals, lambda m, l: (m, l) == (2, 2)),
}
