"""The plan of priorities: the levels of rows, shapes and numbers of the template cascade.c.j2 (numerics.md:
Priorities)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from servogen.law.law import Law
from servogen.law.steps import STATE, Cascade
from servogen.plan.bounds import SPENT
from servogen.plan.solver import SolverPlan
from servogen.plan.thresholds import ROUNDING, SWEEP_CAPS


@dataclass(frozen=True)
class CascadePlan:
    """Least squares level by level. levels: the rows of each, the first in priority first. switches: as of the step.

    floor: of a level behind the first, singular values at or below this part of its size count as zero, for they are
    what rounding leaves of rows that the levels before have used up. clean: entries of a row, in its own unit, that are
    rounding. rounding: what Gram-Schmidt errs, over the size of the rows. limit: the certificate, for bound |B|^2.
    orthogonal, converged: as of a SolverPlan. damped: whether small singular values are damped.
    """

    m: int
    l: int
    levels: tuple[tuple[int, ...], ...]
    switches: tuple[tuple[str, tuple[int, ...]], ...]
    rtol: float
    floor: float
    clean: float
    rounding: float
    limit: float
    orthogonal: float
    converged: float
    damped: bool

    @property
    def rows(self) -> tuple[int, ...]:
        """All rows, level by level."""
        return tuple(i for level in self.levels for i in level)

    @property
    def first(self) -> tuple[int, ...]:
        """Where each level begins among `rows`, and where the last one ends."""
        return tuple(sum(map(len, self.levels[:k])) for k in range(len(self.levels) + 1))

    def mask(self, rows: Sequence[int]) -> int:
        """A bit for each row."""
        return sum(1 << i for i in rows)

    @property
    def longest(self) -> int:
        """The most rows of a level."""
        return max(map(len, self.levels))

    @property
    def turns(self) -> bool:
        """Whether some level may need its singular values."""
        return self.longest > 1 or self.damped

    @property
    def sweep_cap(self) -> int:
        """Sweeps of Jacobi's method, for the most directions that a level may have."""
        return next(cap for n, cap in SWEEP_CAPS if min(self.longest, self.l) <= n)

    @property
    def sigma_share(self) -> float:
        """info.sigma_min is at least this part of the first level's, but for rounding; in hundredths, rounded down."""
        return math.floor(100 / math.sqrt(min(len(self.levels[0]), self.l))) / 100

    def to_json(self) -> dict[str, Any]:
        """For the manifest."""
        told = {"levels": [list(level) for level in self.levels], "floor": self.floor, "limit": self.limit}
        if not self.switches:
            return told
        return told | {"switches": {name.removeprefix(STATE): list(rows) for name, rows in self.switches}}


def plan_cascade(law: Law, solvers: dict[str, SolverPlan]) -> CascadePlan | None:
    """The plan of the law's Cascade; None where it has none."""
    step = next((s for s in law.steps() if isinstance(s, Cascade)), None)
    if step is None:
        return None
    solver = solvers[step.solver]
    rounding = ROUNDING * max(solver.m, solver.l) * solver.epsilon
    floor = max(solver.rtol, rounding)
    return CascadePlan(
        m=solver.m,
        l=solver.l,
        levels=step.levels,
        switches=step.switches,
        rtol=solver.rtol,
        floor=floor,
        clean=SPENT * solver.rtol,
        rounding=rounding,
        limit=0.875 / (floor + rounding) ** 2,
        orthogonal=solver.orthogonal,
        converged=solver.converged,
        damped=solver.damping is not None,
    )
