"""One task of a stress run, and the twin it puts to the test."""

import functools
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, cast

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from servogen.compiler import build_solver
from servogen.plan.solver import SolverPlan, plan_solver
from servogen.results import FloatArray, Status
from servogen.scalars import EPSILON, Scalar
from servogen.scene.solver import Solver
from servogen.verify.stress.bars import CAPPED, RANK, STATUS, SWEEPS, Figure, figure

Columns = dict[str, NDArray[Any]]
"""The fields of `info`, one array each."""


class SolverTwin(Protocol):
    """What `servogen.build_solver(...).load()` gives, here called on stacks: infos as a record array or a sequence."""

    def solve(self, S: Any, z: Any, y: Any = None, last: Any = None) -> tuple[Any, Any]: ...

    def pinv(self, S: Any, last: Any = None) -> tuple[Any, Any]: ...


class LimitedTwin(Protocol):
    """What `servogen.build_solver(..., limits=True).load()` gives."""

    def solve(self, S: Any, z: Any, y: Any, lower: Any, upper: Any, last: Any, active: Any) -> Any: ...


MakeTwin = Callable[[int, int, Scalar, Solver], SolverTwin]


@functools.cache
def built(m: int, l: int, scalar: Scalar, solver: Solver) -> SolverTwin:
    """The generated and compiled package for one shape."""
    package = build_solver(m, l, scalar=scalar, solver=solver)
    return cast(SolverTwin, package.load(flags=("-O1",)))  # the bits are those of any level


@functools.cache
def built_with_limits(m: int, l: int, scalar: Scalar) -> LimitedTwin:
    """The generated and compiled package for one shape, its answer within limits."""
    return cast(LimitedTwin, build_solver(m, l, scalar=scalar, limits=True).load(flags=("-O1",)))


@dataclass(frozen=True)
class Task:
    """A part of one family on one shape: what a process works on. `part` counts the tasks of that family and shape."""

    family: str
    m: int
    l: int
    scalar: Scalar
    systems: int
    part: int
    seed: int

    def __str__(self) -> str:
        return f"{self.family} {self.m}x{self.l} {self.scalar} part {self.part}, {self.systems} systems"

    def generator(self) -> Generator:
        key = zlib.crc32(f"{self.family} {self.m}x{self.l} {self.scalar}".encode())
        return np.random.default_rng([self.seed, key, self.part])


class Bench:
    """The twin of one task, and its answers as arrays."""

    def __init__(self, task: Task, make: MakeTwin, solver: Solver) -> None:
        self.task, self.solver = task, solver
        self.eps = EPSILON[task.scalar]
        self.dtype = np.dtype(task.scalar)
        self.plan: SolverPlan = plan_solver(task.m, task.l, task.scalar, solver)
        self._make = make

    @functools.cached_property
    def twin(self) -> SolverTwin:
        return self._make(self.task.m, self.task.l, self.task.scalar, self.solver)

    def solve(
        self, S: FloatArray, z: FloatArray, y: FloatArray | None, last: FloatArray | None = None
    ) -> tuple[FloatArray, Columns]:
        tau, info = self.twin.solve(S, z, y, last)
        return np.asarray(tau), _columns(info)

    def pinv(self, S: FloatArray, last: FloatArray | None = None) -> tuple[FloatArray, Columns]:
        matrix, info = self.twin.pinv(S, last)
        return np.asarray(matrix), _columns(info)

    def solve_within(
        self,
        S: FloatArray,
        z: FloatArray,
        y: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        active: Any = 0,
        last: FloatArray | None = None,
    ) -> tuple[FloatArray, Columns]:
        """Within limits; active: masks of who may be at one."""
        twin = built_with_limits(self.task.m, self.task.l, self.task.scalar)
        tau, info = twin.solve(S, z, y, lower=lower, upper=upper, last=last, active=active)
        return np.asarray(tau), _columns(info) | {"active": np.asarray(info.active)}

    def round(self, A: NDArray[Any]) -> FloatArray:
        """To the target type: what is fed, and what the truth is made from."""
        return np.asarray(A, self.dtype)

    def ends(self, info: Columns) -> Iterator[Figure]:
        """That its iteration ended."""
        if self.plan.sweep_cap:
            yield figure(SWEEPS, info["sweeps"] / self.plan.sweep_cap)
            yield figure(CAPPED, info["status"] == Status.NOT_CONVERGED)


def answers(info: Columns, ranks: Sequence[int], statuses: Sequence[int]) -> Iterator[Figure]:
    """Rank and status against those decided exactly."""
    yield figure(RANK, info["rank"] != np.array(ranks))
    yield figure(STATUS, info["status"] != np.array(statuses))


def _columns(info: Any) -> Columns:
    names = ("status", "path", "rank", "sweeps", "sigma_min", "residual")
    if isinstance(info, np.ndarray) and info.dtype.names:
        return {name: np.asarray(info[name]) for name in names}
    if isinstance(info, Sequence):
        return {name: np.array([getattr(one, name) for one in info]) for name in names}
    return {name: np.asarray(getattr(info, name)) for name in names}
