"""What the templates of the solver name."""

from collections.abc import Callable
from typing import Any

from servogen.plan.bounds import BoundPlan
from servogen.plan.cascade import CascadePlan
from servogen.plan.solver import SolverPlan
from servogen.results import OF_LIMITS, OF_PASSIVE, PATH_MEANING, STATUS_MEANING, Path, Status
from servogen.scalars import BITS

PLAIN = {"matrix": "S", "right": "z", "unknown": "tau"}
"""The names of the solver's equation S tau = z in comments where a scene has none of its own."""


def solver_context(
    plan: SolverPlan,
    prefix: str,
    literal: Callable[[float], str],
    bound: BoundPlan | None = None,
    cascade: CascadePlan | None = None,
    joins: bool = False,
) -> dict[str, Any]:
    """Everything the templates solver/solver.c.j2 and solver/info.h.j2 name. bound, cascade: of limits
    and priorities, if there are. joins: whether there are passive constraints."""
    return {
        "p": prefix,
        "P": prefix.upper(),
        "K": prefix.upper(),  # of the names of this solver's numbers; another solver of the same package has its own
        "real": plan.real,
        "plan": plan,
        "bits": BITS[plan.scalar],
        "named": PLAIN,
        "solved": PLAIN,
        "lit": literal,
        "bound": bound,
        "cascade": cascade,
        "statuses": statuses(bound is not None, joins),
        "paths": paths(),
    }


def statuses(limited: bool = False, joins: bool = False) -> list[tuple[str, int, str]]:
    """Name, number and meaning of each status there is, with limits and passive constraints or without, remarks before
    refusals."""
    said = [s for s in Status if (limited or s not in OF_LIMITS) and (joins or s not in OF_PASSIVE)]
    return [(s.name, int(s), STATUS_MEANING[s]) for s in sorted(said, key=lambda s: (s < 0, abs(s)))]


def paths() -> list[tuple[str, int, str]]:
    """Name, number and meaning of each path."""
    return [(path.name, int(path), PATH_MEANING[path]) for path in Path]
