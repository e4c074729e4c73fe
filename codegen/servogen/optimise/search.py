"""The search for the cheapest program: the passes in the order that works, the best program kept.

A new pass is one more entry in SEARCH and its place in ORDERS. passes.py simplifies before and after each.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from servogen.ir.program import Program, check_legal
from servogen.optimise.accuracy import TOLERATED, Accuracy, draw_inputs, mix
from servogen.optimise.cost import Objective, tick_operations
from servogen.optimise.early import early_part, with_early_part
from servogen.optimise.factor import factor
from servogen.optimise.horner import horner
from servogen.optimise.pairs import share_pairs
from servogen.optimise.passes import optimise
from servogen.optimise.reciprocals import share_reciprocals
from servogen.optimise.resubstitute import resubstitute
from servogen.optimise.value_numbering import number_values

Pass = Callable[[Program, Objective], Program]

SEARCH: dict[str, Pass] = {
    "value numbering": lambda program, _: number_values(program),
    "shared reciprocals": lambda program, _: share_reciprocals(program),
    "factoring": lambda program, _: factor(program),
    "shared pairs": lambda program, _: share_pairs(program),
    "Horner form": horner,
    "resubstitution": resubstitute,
}

_FIRST, _SECOND = "value numbering", "shared reciprocals"
ORDERS: tuple[tuple[str, ...], ...] = (
    (_FIRST, _SECOND, "factoring", "shared pairs", "Horner form", "resubstitution"),
    (_FIRST, _SECOND, "factoring", "resubstitution", "Horner form", "shared pairs"),
)
"""Passes are greedy, so their order matters; small programs try all of these, large ones the first."""

_SMALL = 600  # operations at tick of a small program
_ROUNDS = 8
_PATIENCE = 2  # a pass that gained too little so often in a row is left out
_WORTHWHILE = 1e-3  # of the cost: a round that gains less is the last


@dataclass(frozen=True)
class Step:
    """What one pass did: operations at tick before and after; `refused` names output entries that it would have made
    less accurate, and that stayed as they were."""

    name: str
    before: int
    after: int
    refused: tuple[str, ...] = ()


Attempt = Callable[[Program, str], tuple[Program, Step]]


@dataclass(frozen=True)
class Optimised:
    """The program and how it came about."""

    program: Program
    steps: tuple[Step, ...]

    @property
    def refused(self) -> tuple[str, ...]:
        """Remarks about rewrites the accuracy guard refused, each once."""
        found = {f"{s.name} of {entry}" for s in self.steps for entry in s.refused}
        reason = f"its error bound would exceed {TOLERATED} times the unoptimised one's"
        return tuple(f"{text}, refused: {reason}" for text in sorted(found))


def search(
    program: Program,
    states: Mapping[str, Any] | None = None,
    minor: frozenset[str] = frozenset(),
    without: frozenset[str] = frozenset(),
) -> Optimised:
    """The cheapest program found that computes the same outputs: the passes in turn until none gains.

    states: where the accuracy is judged, name -> array (N, size); drawn at random if left out.
    minor: outputs that count less. without: passes to leave out, by name.
    """
    objective = Objective(minor)
    start = optimise(program)
    accuracy = Accuracy.of(start, states)
    orders = ORDERS if tick_operations(start) <= _SMALL else ORDERS[:1]
    attempt = cache(lambda best, name: _attempt(best, name, objective, accuracy))  # rounds and orders meet again
    found = [_in_order(start, [n for n in order if n not in without], objective, attempt) for order in orders]
    best = min(found, key=lambda done: objective.cost(done.program))
    part = early_part(best.program)
    if part is None or not any(i.kind == "parameter" for i in start.inputs):
        return best
    return _with_early_part(best, part, objective, accuracy, without)


def _with_early_part(
    done: Optimised, part: Program, objective: Objective, accuracy: Accuracy, without: frozenset[str]
) -> Optimised:
    """What parameters alone decide, searched by itself."""
    states = draw_inputs(part)
    as_inputs = replace(part, inputs=tuple(replace(i, kind="input") for i in part.inputs))
    found = optimise(check_legal(with_early_part(done.program, search(as_inputs, states, without=without).program)))
    if objective.cost(found) >= objective.cost(done.program) or accuracy.worse(found):
        return done
    step = Step("values of parameters", tick_operations(done.program), tick_operations(found))
    return Optimised(found, (*done.steps, step))


def _in_order(best: Program, order: list[str], objective: Objective, attempt: Attempt) -> Optimised:
    """The passes of one order in turn, round after round."""
    steps: list[Step] = []
    idle: Counter[str] = Counter()
    for _ in range(_ROUNDS):
        before = objective.cost(best)
        for name in order:
            if idle[name] < _PATIENCE:
                cost = objective.cost(best)
                best, step = attempt(best, name)
                idle[name] = 0 if objective.cost(best) < cost * (1 - _WORTHWHILE) else idle[name] + 1
                steps.append(step)
        if objective.cost(best) > before * (1 - _WORTHWHILE):
            break
    return Optimised(best, tuple(steps))


def _attempt(best: Program, name: str, objective: Objective, accuracy: Accuracy) -> tuple[Program, Step]:
    """The outcome of one pass where it is cheaper and accurate enough, else the program as it was."""
    operations = tick_operations(best)
    found = optimise(check_legal(SEARCH[name](best, objective)))
    if objective.cost(found) >= objective.cost(best):
        return best, Step(name, operations, operations)
    worse = accuracy.worse(found)
    if worse:
        found = optimise(mix(best, found, worse))
        refused = tuple(f"{entry}[{k}]" for entry, k in worse)
        if objective.cost(found) >= objective.cost(best) or accuracy.worse(found):
            return best, Step(name, operations, operations, refused)
        return found, Step(name, operations, tick_operations(found), refused)
    return found, Step(name, operations, tick_operations(found))
