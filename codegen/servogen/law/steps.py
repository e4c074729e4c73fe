"""What a routine of a law is made of: one dataclass a step, and one row of STEPS that says what it means.

The other columns of a step stand where their layer is, under the row's word: its C in render/templates/steps.c.j2, its
answer to 50 digits in verify/exact_steps.py and with its error bound in verify/answers.py, its cost in
render/render.py. tests/law/test_law.py holds them together.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from servogen.results import Status

Shape = tuple[int, int]
Pattern = tuple[tuple[tuple[int, int], ...], ...]
"""Per row of a sparse matrix the (place in its list of entries, column) of each of them."""

SYSTEM = "system"
"""The solver of the scene's own system, whose rank, margin and residual `info` tells."""

STATE = "in."
"""Before the name of an input that a step reads as the caller gave it, in.y say."""


@dataclass(frozen=True)
class Evaluate:
    """Quantities of the scene's program at the state, by one kernel."""

    into: tuple[str, ...]


@dataclass(frozen=True)
class Solve:
    """into = y + M+ (right - M y), M by rank, tolerances and damping of a solver; free: the name of y, or ""."""

    into: str
    solver: str
    matrix: str
    right: str
    free: str = ""


@dataclass(frozen=True)
class Cascade:
    """into = the lexicographic least squares of matrix x = right nearest to free (zero where it is ""), level by level.

    levels: the rows of each, first in priority first; every row in one of them. Each level is solved as by Solve,
    within what the levels before it leave open.
    switches: (an input of one number a, rows). With a <= 0 these rows are left out, with a >= 1 they are as given;
    between, what is asked of them is a right + (1 - a) matrix x', x' the answer without them.
    """

    into: str
    solver: str
    matrix: str
    right: str
    levels: tuple[tuple[int, ...], ...]
    free: str = ""
    switches: tuple[tuple[str, tuple[int, ...]], ...] = ()


@dataclass(frozen=True)
class Apply:
    """The same as Solve with M+ at hand, for no state changes M: plan puts it in the place of such a Solve."""

    into: str
    solver: str
    matrix: str
    right: str
    free: str = ""


@dataclass(frozen=True)
class React:
    """into = J^T M+ right, M = J Q^-1 J^T, Eq. (17): the forces of constraints J u' = b on the mechanism.

    M is brought to a unit diagonal by powers of two on both sides, so that no constraint's unit decides the rank. One
    step, not a solve and a product: the powers go into J, for the multipliers in the constraints' own units may
    overflow where the forces do not.
    """

    into: str
    solver: str
    matrix: str
    right: str
    jacobian: str


@dataclass(frozen=True)
class Multiply:
    """into = N x; entries: the name of N's nonzeros in a column, placed by pattern."""

    into: str
    entries: str
    vector: str
    pattern: Pattern


@dataclass(frozen=True)
class Limit:
    """into = start where lower <= start <= upper; else least squares of matrix x = right within these limits, and of
    these answers the one nearest to free (zero where it is ""), in the metric L^T `metric` where that is named.

    start: the answer without limits of a solver's system. slowed: "" or the name of what right may be reduced by,
    right - (1 - s) slowed with the largest s from 0 to 1 that can be met. no_lower, no_upper: entries of these two that
    stand for no limit.
    """

    into: str
    solver: str
    start: str
    matrix: str
    right: str
    lower: str
    upper: str
    free: str = ""
    slowed: str = ""
    metric: str = ""
    no_lower: tuple[int, ...] = ()
    no_upper: tuple[int, ...] = ()


@dataclass(frozen=True)
class Invert:
    """into = M+ of a matrix that the caller gives."""

    into: str
    solver: str
    matrix: str


@dataclass(frozen=True)
class Project:
    """into = the vector nearest to an input `of` for which the quantity `value` vanishes; matrix: its derivative by it.

    curvature: the name of its second derivatives, "" where it is affine; places: the (row of value, i, j <= i) of each.
    At most `cap` steps, each of which evaluates the quantities again.
    """

    into: str
    solver: str
    of: str
    value: str
    matrix: str
    cap: int
    curvature: str = ""
    places: tuple[tuple[int, int, int], ...] = ()

    @property
    def quantities(self) -> tuple[str, ...]:
        """What its kernel hands out."""
        return (self.value, self.matrix, *([self.curvature] if self.curvature else []))


@dataclass(frozen=True)
class Advance:
    """into = the input `of` + dt rate, dt an argument of the routine."""

    into: str
    of: str
    rate: str
    dt: str


@dataclass(frozen=True)
class Call:
    """into = the result of an earlier routine; moved: (input, name) of an input that is another at this call."""

    into: str
    routine: str
    moved: tuple[str, str] | None = None


Step = Evaluate | Solve | Cascade | Apply | React | Multiply | Limit | Invert | Project | Advance | Call


Place = Literal["alone", "first", "behind", "quiet", "between", "limiting"]
"""In a routine of its own; the evaluation that others stand behind; behind one; the only one behind one in a routine
without info; among calls of routines; behind a solve of matrices that the caller gives."""


@dataclass(frozen=True)
class Row:
    """What a step means beside its C and its exact answer.

    word: its name in print. places: where it may stand in a routine, see law.Form. reads: the names it needs.
    shape: of what it leaves in `into`, from the shapes of what it reads; KeyError or ShapeError where these do not fit.
    statuses: what it may say beside OK. refuses: it tells by its own status when something it reads is not finite, so
    that nobody need look before.
    """

    word: str
    places: tuple[Place, ...]
    reads: Callable[[Any], tuple[str, ...]]
    shape: Callable[[Any, Mapping[str, Shape]], Shape]
    statuses: tuple[Status, ...]
    refuses: bool


class ShapeError(ValueError):
    """Shapes of a step that do not fit one another."""


def _fits(good: bool, problem: str) -> None:
    if not good:
        raise ShapeError(problem)


def _solved(step: Solve | Cascade | Apply, shapes: Mapping[str, Shape]) -> Shape:
    (m, l), right = shapes[step.matrix], shapes[step.right]
    _fits(right == (m, 1), f"{step.matrix} of {m} x {l} and {step.right} of {right[0]} x {right[1]}")
    if step.free:
        _fits(shapes[step.free] == (l, 1), f"{step.matrix} of {m} x {l} and the free {step.free}")
    return l, 1


def _cascaded(step: Cascade, shapes: Mapping[str, Shape]) -> Shape:
    rows = sorted(i for level in step.levels for i in level)
    m = shapes[step.matrix][0]
    _fits(rows == list(range(m)) and all(step.levels), f"levels that do not hold each of the {m} rows once")
    switched = [i for _, own in step.switches for i in own]
    _fits(len(set(switched)) == len(switched) and set(switched) <= set(rows), "a row that two switches, or none, have")
    _fits(all(shapes[name] == (1, 1) for name, _ in step.switches), "a switch that is no number")
    return _solved(step, shapes)


def _reacted(step: React, shapes: Mapping[str, Shape]) -> Shape:
    m, n = shapes[step.jacobian]
    _fits(shapes[step.matrix] == (m, m), f"{step.jacobian} of {m} x {n} and {step.matrix}, which must be {m} x {m}")
    _fits(shapes[step.right] == (m, 1), f"{step.jacobian} of {m} x {n} and {step.right}")
    return n, 1


def _multiplied(step: Multiply, shapes: Mapping[str, Shape]) -> Shape:
    used = [pair for row in step.pattern for pair in row]
    count, columns = shapes[step.entries][0] * shapes[step.entries][1], shapes[step.vector][0]
    _fits(all(0 <= e < count for e, _ in used), f"the pattern names an entry that {step.entries} has not")
    _fits(all(0 <= j < columns for _, j in used), f"the pattern names a column beyond {step.vector}")
    return len(step.pattern), 1


def _limited(step: Limit, shapes: Mapping[str, Shape]) -> Shape:
    (m, l), right = shapes[step.matrix], shapes[step.right]
    _fits(right == (m, 1), f"{step.matrix} of {m} x {l} and {step.right} of {right[0]} x {right[1]}")
    for name in (step.start, step.lower, step.upper, *([step.free] if step.free else [])):
        _fits(shapes[name] == (l, 1), f"{step.matrix} of {m} x {l} and {name}")
    if step.slowed:
        _fits(shapes[step.slowed] == (m, 1), f"{step.matrix} of {m} x {l} and {step.slowed}")
    _fits(all(0 <= j < l for j in (*step.no_lower, *step.no_upper)), f"an open limit beyond the {l} controls")
    if step.metric:
        _fits(shapes[step.metric] == (l, l), f"{step.matrix} of {m} x {l} and the metric {step.metric}")
    return l, 1


def _projected(step: Project, shapes: Mapping[str, Shape]) -> Shape:
    m, l = shapes[step.matrix]
    _fits(shapes[step.value] == (m, 1), f"{step.value} has not the {m} rows of {step.matrix}")
    _fits(shapes[step.of] == (l, 1), f"{step.of} has not the {l} columns of {step.matrix}")
    _fits(step.cap > 0, "a cap of no steps")
    if step.curvature:
        _fits(shapes[step.curvature] == (len(step.places), 1), f"{step.curvature} and its places differ in number")
        _fits(all(0 <= r < m and 0 <= j <= i < l for r, i, j in step.places), "a place outside the second derivatives")
    return l, 1


def _advanced(step: Advance, shapes: Mapping[str, Shape]) -> Shape:
    _fits(shapes[step.dt] == (1, 1), f"{step.dt} is no number")
    _fits(shapes[step.of] == shapes[step.rate], f"{step.of} and its rate {step.rate} differ in size")
    return shapes[step.of]


def _called(step: Call, shapes: Mapping[str, Shape]) -> Shape:
    if step.moved:
        _fits(shapes[STATE + step.moved[0]] == shapes[step.moved[1]], f"{step.moved[0]} and {step.moved[1]} differ")
    return shapes[f"{step.routine}()"]


_RANK = (Status.RANK_DEFICIENT_CONSISTENT, Status.RANK_DEFICIENT_INCONSISTENT, Status.REGULARISED)
_REFUSED = (Status.NONFINITE, Status.NOT_CONVERGED, Status.OVERFLOW)

STEPS: dict[type, Row] = {
    Evaluate: Row(
        "evaluate",
        ("first",),
        lambda step: (),
        lambda step, shapes: (0, 0),  # its names are quantities, whose shapes the law states
        (Status.NONFINITE, Status.SINGULAR_MASS, Status.DEAD_CENTRE, Status.OVERFLOW),
        False,
    ),
    Solve: Row(
        "solve",
        ("alone", "behind"),
        lambda step: (step.matrix, step.right, *([step.free] if step.free else [])),
        _solved,
        (*_RANK, *_REFUSED),
        True,
    ),
    Cascade: Row(
        "cascade",
        ("behind",),
        lambda step: (
            *(step.matrix, step.right, *([step.free] if step.free else [])),
            *(name for name, _ in step.switches),
        ),
        _cascaded,
        (*_RANK, *_REFUSED),
        True,
    ),
    Apply: Row(
        "apply",
        ("behind",),
        lambda step: (step.right, *([step.free] if step.free else [])),
        _solved,
        (*_RANK, Status.NONFINITE, Status.OVERFLOW),
        True,
    ),
    React: Row(
        "react",
        ("behind", "quiet"),
        lambda step: (step.matrix, step.right, step.jacobian),
        _reacted,
        (*_RANK, *_REFUSED),
        False,
    ),
    Multiply: Row(
        "multiply",
        ("behind",),
        lambda step: (step.entries, step.vector),
        _multiplied,
        (Status.OVERFLOW,),
        True,
    ),
    Limit: Row(
        "limit",
        ("limiting", "behind"),
        lambda step: (
            *(step.start, step.matrix, step.right, step.lower, step.upper),
            *(name for name in (step.free, step.slowed, step.metric) if name),
        ),
        _limited,
        (
            *(Status.LIMITED, Status.LIMITED_INCONSISTENT, Status.RANK_DEFICIENT_INCONSISTENT),
            *(Status.LIMITS_CROSSED, Status.NOT_CONVERGED, Status.OVERFLOW),
        ),
        False,  # an infinite limit that was computed would pass for none
    ),
    Invert: Row(
        "invert",
        ("alone",),
        lambda step: (step.matrix,),
        lambda step, shapes: (shapes[step.matrix][1], shapes[step.matrix][0]),
        (*_RANK, *_REFUSED),
        True,
    ),
    Project: Row(
        "project",
        ("alone",),
        lambda step: (step.of,),
        _projected,
        (*_RANK, *_REFUSED),
        False,
    ),
    Advance: Row(
        "advance",
        ("between",),
        lambda step: (step.of, step.rate, step.dt),
        _advanced,
        (Status.NONFINITE, Status.OVERFLOW),
        True,
    ),
    Call: Row(
        "call",
        ("between",),
        lambda step: (step.moved[1],) if step.moved else (),
        _called,
        (),  # those of the routine
        True,
    ),
}


def handed_out(step: Evaluate | Project) -> tuple[str, ...]:
    """The quantities that its kernel hands out."""
    return step.into if isinstance(step, Evaluate) else step.quantities


def row_of(step: Step) -> Row:
    """The row of the table for a step."""
    return STEPS[type(step)]
