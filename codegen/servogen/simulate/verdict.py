"""What a run came to: one word, one sentence of what happened, when and why, and what to try."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from servogen.results import STATUS_MEANING, FloatArray, Status

if TYPE_CHECKING:
    from servogen.simulate.trajectory import Trajectory

GROWTH = 10.0
"""A deviation that grows by this factor from the third quarter of a run to the last, and has come to a hundredth of its
tolerance, is on its way out."""


@dataclass(frozen=True)
class Verdict:
    """word: `held`, `left the domain`, `limited`, `inconsistent`, `not held`, `stopped: reason` or `refused: status`.

    held: all steps were done, psi (phi) stayed within its tolerance of the prescribed decay at every row and was not on
    its way out at the end, the state stayed in its domain, and the controller met its constraints at every row.
    not held: psi left its decay, and none of the other words tells why.
    What happened first gives the word. reason: one sentence, with figures and units. advice: what to try.
    """

    word: str
    reason: str
    advice: str

    @property
    def held(self) -> bool:
        return self.word == "held"

    def __str__(self) -> str:
        return self.word


@dataclass(frozen=True)
class Outline:
    """The bare facts of a run, from which its word follows. Rows count from 0; None: never.

    left, inconsistent, limited, off: the first row at which the state was outside its ranges, the constraints were
    not all met, an actuator held a control back, psi was beyond its tolerance.
    growing: psi off its decay was on its way out.
    end: the word of what ended the run before its time, or None; rows: that it left behind.
    """

    rows: int
    left: int | None
    inconsistent: int | None
    limited: int | None
    off: int | None
    growing: bool
    end: str | None


def happened(outline: Outline) -> list[tuple[int, str]]:
    """(row, word) of all that keeps a run from being held and tells why, in its order.

    Actuators count only where psi has left its decay since.
    """
    o = outline
    weak = o.limited if o.limited is not None and o.off is not None and o.limited <= o.off else None
    last = None if o.end is None else o.rows - 1
    named = ((o.left, "left the domain"), (o.inconsistent, "inconsistent"), (weak, "limited"), (last, o.end or ""))
    return sorted(((row, word) for row, word in named if row is not None), key=lambda pair: pair[0])


def word_of(outline: Outline) -> str:
    """What happened first."""
    found = happened(outline)
    if found:
        return found[0][1]
    return "not held" if outline.off is not None or outline.growing else "held"


def word_of_end(reason: str, event: str, status: Status) -> str | None:
    """The word of what ended a run before its time, see trajectory.Stop."""
    if reason == "finished":
        return None
    if reason == "event":
        return f"stopped: {event}"
    return f"refused: {status.name}" if reason == "controller" else f"stopped: {reason} {status.name}"


def grows(third: float, last: float, rows: int) -> bool:
    """Whether a deviation, as a share of its tolerance, is on its way out: its largest in two quarters of a run.

    rows: of the run; fewer than eight say nothing.
    """
    return rows >= 8 and last > max(GROWTH * third, 0.01)


@dataclass(frozen=True)
class _Told:
    """Something that keeps a run from being held: what happened, and what to try."""

    what: str
    advice: str


def judge(run: "Trajectory") -> Verdict:
    """The verdict of a run, from its rows and its claim."""
    if len(run.t) == 0:
        return _refused_at_the_start(run)
    off = _off(run)
    outline = _outline(run, off)
    word, found = word_of(outline), happened(outline)
    if found:
        told = [(run.t[row], _TELLING.get(name, _ended)(run, row, off)) for row, name in found]
        (since, first), *rest = told
        later = "".join(f"; then, at t = {t:.4g} s, {then.what}" for t, then in rest)
        advice = f"{_another_plant(run)}{first.advice}"
        return Verdict(word, f"At t = {since:.4g} s {first.what}{later}; {off.clause}.", advice)
    if word == "held":
        stayed = f"for {run.t[-1]:.4g} s q and u stayed within {_sources(run)}"
        return Verdict(word, f"{_capital(off.clause)}; {stayed}.", "")
    return Verdict(word, f"{_capital(off.clause)}.", f"{_another_plant(run)}{_advice_where_off(run)}")


def _outline(run: "Trajectory", off: "_Off") -> Outline:
    """The bare facts of the rows."""

    def first(rows: Any) -> int | None:
        found = np.flatnonzero(rows)
        return int(found[0]) if len(found) else None

    return Outline(
        rows=len(run.t),
        left=first(_outside(run)[1].any(axis=1)),
        inconsistent=first(run.status == Status.RANK_DEFICIENT_INCONSISTENT),
        limited=first(run.limited),
        off=off.row,
        growing=off.growing,
        end=word_of_end(run.stop.reason, run.stop.event, run.stop.status),
    )


def _outside(run: "Trajectory") -> tuple[FloatArray, Any]:
    """The state with its angles at the nearest turn, and which entries are outside their ranges."""
    claim = run.claim
    state = claim.folded(np.hstack([run.q, run.u]).astype(float))
    return state, (state < claim.low) | (state > claim.high)


def _left(run: "Trajectory", first: int, off: "_Off") -> _Told:
    claim = run.claim
    state, outside = _outside(run)
    k = int(np.flatnonzero(outside[first])[0])
    unit = claim.units[k]
    name, source = claim.names[k], claim.sources[claim.names[k][0]]
    own = state[:, k]
    worst = own[int(np.argmax(np.maximum(own - claim.high[k], claim.low[k] - own)))]
    told = (
        f"{name} left the range {_number(claim.low[k])} to {_number(claim.high[k], unit)} ({source}), "
        f"and came to {_number(worst, unit)}"
    )
    if first == 0:
        told = told.replace(" left the range", " was already outside the range", 1)
    meant = 'If the run is meant to go there, say so: sg.Simulation(domain={"q": (lo, hi), "u": (lo, hi)})'
    if off.row is None or off.row > first:
        advice = (
            f"{meant}. If not: the constraints were held until then, so this is motion that they leave free; "
            "constrain it too, or damp it with y or a weight where there are more controls than constraints."
        )
    else:
        advice = f"{meant}. If not: start nearer, or ask for slower errors (Theta) and slower references."
    return _Told(told, advice)


def _inconsistent(run: "Trajectory", first: int, off: "_Off") -> _Told:
    count = np.count_nonzero(run.status == Status.RANK_DEFICIENT_INCONSISTENT)
    return _Told(
        f"the constraints could not all be met (rank {run.rank[first]} of {run.constraint.shape[1]}); so at "
        f"{count:,} of {len(run.t):,} rows",
        "The controls do not reach all constraints there: drop one, keep away from the singularity "
        "(sg.Simulation(sigma_min=...) stops before it), or allow a compromise near it (sg.Solver(damping=...)).",
    )


def _limited(run: "Trajectory", first: int, off: "_Off") -> _Told:
    masks = int(np.bitwise_or.reduce(run.limited))
    names = ", ".join(f"tau[{k}]" for k in range(run.tau.shape[1]) if masks >> k & 1)
    largest = int(np.argmax(np.max(np.abs(run.tau), axis=0)))
    count = np.count_nonzero(run.limited)
    own = np.any(np.isin(run.status, (Status.LIMITED, Status.LIMITED_INCONSISTENT)))
    who = "the scene's limits" if own else "actuators"
    told = (
        f"{who} held {names} back{'' if own else ' at a limit or a rate'}; so at {count:,} of {len(run.t):,} rows "
        f"(largest control {_number(np.max(np.abs(run.tau)), run.claim.tau_units[largest])})"
    )
    advice = "Ask for less: slower errors (Theta), slower references, a nearer start; or give the actuators more."
    return _Told(told, advice)


def _ended(run: "Trajectory", last: int, off: "_Off") -> _Told:
    stop = run.stop
    if stop.reason == "event":
        return _Told(
            f"the run's own stop {stop.event!r} ended it",
            f"If that is its natural end, run it for less than {stop.t:.4g} s; if not, see what leads there.",
        )
    refused = "refused" if stop.reason == "controller" else "could not be computed"
    return _Told(f"the {stop.reason} {refused}: {STATUS_MEANING[stop.status]}", _advice_of(stop.status))


_TELLING = {"left the domain": _left, "inconsistent": _inconsistent, "limited": _limited}
"""By its word, what happened at a row; what ended a run has words of its own."""


def _refused_at_the_start(run: "Trajectory") -> Verdict:
    stop = run.stop
    word = word_of_end(stop.reason, stop.event, stop.status) or ""
    reason = f"The {stop.reason} refused the start: {STATUS_MEANING[stop.status]}."
    return Verdict(word, reason, _advice_of(stop.status))


@dataclass(frozen=True)
class _Off:
    """psi off its decay: the first row beyond its tolerance, or None; whether on its way out at the end; in words."""

    row: int | None
    growing: bool
    clause: str


def _off(run: "Trajectory") -> _Off:
    claim = run.claim
    if not np.any(np.isfinite(claim.tolerance)):
        return _Off(None, False, "nothing is claimed of constraints that come and go")
    deviation = np.abs(run.constraint - run.ideal).astype(float)
    share = deviation / claim.tolerance
    largest = share.max(axis=1)
    row = int(np.argmax(largest))
    k = int(np.argmax(share[row]))
    beyond = np.flatnonzero(largest > 1)
    quarter = len(run.t) // 4
    growing = False
    if quarter and not len(beyond):
        before, last = largest[-2 * quarter : -quarter].max(), largest[-quarter:].max()
        growing = grows(float(before), float(last), len(run.t))
    unit = claim.row_units[k]
    share_told = "" if math.isnan(claim.relative[k]) else f", {claim.relative[k]:.3g} of its size over the domain"
    tolerance = f"tolerance {_number(claim.tolerance[k], unit)}{share_told}"
    worst = f"{_number(deviation[row, k], unit)}, at t = {run.t[row]:.4g} s"
    what = f"{claim.rows[k]} was off its prescribed decay by at most {worst}"
    if len(beyond):
        since = float(run.t[beyond[0]])
        return _Off(int(beyond[0]), False, f"{what}, and beyond its tolerance since t = {since:.4g} s ({tolerance})")
    if growing:
        return _Off(None, True, f"{what}, and that deviation is growing ({tolerance})")
    return _Off(None, False, f"{what} ({tolerance})")


def _another_plant(run: "Trajectory") -> str:
    """Where the plant's parameters are not the controller's, that first."""
    own = [n for n, v in run.plant.items() if not np.array_equal(v, run.parameters[n])]
    if not own:
        return ""
    told = ", ".join(f"{n} = {_list(run.plant[n])} where the controller takes {_list(run.parameters[n])}" for n in own)
    return f"The plant has {told}: the nearer the controller's is, the better. "


def _advice_where_off(run: "Trajectory") -> str:
    regularised = int(np.sum(run.status == Status.REGULARISED))
    if regularised:
        return (
            f"Damping changed the answer at {regularised:,} of {len(run.t):,} rows: keep further from the singularity, "
            "or damp less (sg.Solver(damping=...))."
        )
    if run.hold:
        return (
            "Sample faster (a shorter hold), ask for slower errors (Theta), or damp the motion that is left free (y)."
        )
    return (
        "Halve the step: what falls with it is the integrator's error. What stays is the model's: another plant than "
        "the controller's, or single precision."
    )


def _advice_of(status: Status) -> str:
    return {
        Status.DEAD_CENTRE: "Keep away from dead centres: there the velocities that the constraints allow are more.",
        Status.NONFINITE: "Look for a division by zero or a root of a negative number in the model at that state.",
        Status.SINGULAR_MASS: "Give parameters of a body that has mass, or keep away from where Q is singular.",
        Status.NOT_CONVERGED: "Scale the constraints and controls to like sizes; tell us of it with the state.",
        Status.LIMITS_CROSSED: "Give limits that leave a number between lower and upper at that state.",
        Status.OVERFLOW: "Something grew without bound: look at what grows before the end, and try a shorter step.",
    }[status]


def _sources(run: "Trajectory") -> str:
    return " and ".join(dict.fromkeys(run.claim.sources.values()))


def _number(value: Any, unit: str = "") -> str:
    return f"{value:.4g} {unit}".rstrip()


def _list(values: Any) -> str:
    return ", ".join(_number(x) for x in values)


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]
