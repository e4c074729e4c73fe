"""The plan of the answer within limits: shapes and numbers of the templates bounded.c.j2 and bounded_quick.c.j2
(numerics.md: Limits)."""

import math
from dataclasses import dataclass
from typing import Any

from servogen.errors import SceneError
from servogen.law.law import Law
from servogen.law.steps import Limit
from servogen.plan.solver import SolverPlan

CAP = 8
"""Reductions allowed for each unknown in one search, which may begin anew once; the largest number ever seen stays
below half of it."""

NOISE = 8
"""max(m, l) eps times this, relative: what rows miss, and pulls at limits, below which they are rounding."""

SPENT = 2
"""rtol times this: entries of a row, in its own unit, below which the pivots before have used it up."""

REACH = 8
"""eps times this: how far, relative to the largest number in play, a free control may come out beyond its limit before
it counts as beyond; it is then put at the limit."""

TURNS = 4
"""Turns of the guess for each control; it mostly takes one for each at a limit and a few more."""

PASSES = 6
"""Refinements of a guess's answer, the first of which finds it; it mostly stands after the third."""

CERTAIN = 32
"""max(m, l) eps times this: what the certificate allows the sums to miss."""


@dataclass(frozen=True)
class BoundPlan:
    """Least squares over a box, in levels. All numbers are exact in the scalar.

    rows: of the system, and one for the slowing where there is one; columns: likewise. metric: whether the distance
    from y is weighed.
    """

    m: int
    l: int
    lower: str
    upper: str
    slowed: bool
    metric: bool
    cap: int
    noise: float
    spent: float
    reach: float
    loose: float
    little: float
    certain: float

    @property
    def guessed(self) -> bool:
        """Whether a guess is made before the search: not where a control's distance from y is not its own."""
        return 1 < self.m <= self.l and not self.slowed and not self.metric

    @property
    def turns(self) -> int:
        """Of the guess, at most."""
        return TURNS * self.l

    @property
    def passes(self) -> int:
        """Of the refinement of a guess's answer, at most."""
        return PASSES

    @property
    def lightest(self) -> int:
        """A row's square weighs nothing where it is lighter by two to this."""
        return 2 * self.looseness

    @property
    def looseness(self) -> int:
        """loose is two to the minus this."""
        return round(-math.log2(self.loose))

    @property
    def littleness(self) -> int:
        """little is two to the minus this."""
        return round(-math.log2(self.little))

    @property
    def rows(self) -> int:
        return self.m + self.slowed

    @property
    def columns(self) -> int:
        return self.l + self.slowed

    def to_json(self) -> dict[str, Any]:
        """For the manifest."""
        return {
            "policy": "keep_direction" if self.slowed else "least_squares",
            "cap": self.cap,
            "noise": self.noise,
            "spent": self.spent,
            "reach": self.reach,
            "loose": self.loose,
            "little": self.little,
            "certain": self.certain,
        }


def plan_bounds(law: Law, solvers: dict[str, SolverPlan]) -> BoundPlan | None:
    """The plan of the law's Limit; None where it has none. SceneError for damping, which no limit goes with."""
    step = next((s for s in law.steps() if isinstance(s, Limit)), None)
    if step is None:
        return None
    solver = solvers[step.solver]
    if solver.damping is not None:
        raise SceneError(
            f"Solver(damping={solver.damping!r}) and limits: a damped answer is no least-squares optimum, so nothing "
            "could be certified; leave out damping (limits bound tau near a singularity, too), or leave out the limits"
        )
    longest = max(solver.m, solver.l)
    slowed = bool(step.slowed)
    return BoundPlan(
        m=solver.m,
        l=solver.l,
        lower=step.lower.removeprefix("in."),
        upper=step.upper.removeprefix("in."),
        slowed=slowed,
        metric=bool(step.metric),
        cap=CAP * (solver.l + slowed),
        noise=NOISE * longest * solver.epsilon,
        spent=SPENT * solver.rtol,
        reach=REACH * solver.epsilon,
        loose=math.ldexp(1.0, int(math.log2(solver.epsilon)) // 2),
        little=math.ldexp(1.0, int(math.log2(solver.epsilon)) // 3),
        certain=CERTAIN * longest * solver.epsilon,
    )
