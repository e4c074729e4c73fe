"""What a thousand runs came to: quantiles, verdicts, the worst ones with their seeds, and what hurts most."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from servogen.results import FloatArray, Status
from servogen.simulate.claim import Claim
from servogen.simulate.verdict import Outline, grows, word_of, word_of_end

QUANTILES = (0.05, 0.5, 0.95, 1.0)
"""Of what runs came to: the best twentieth, the middle, the worst twentieth, the worst."""


@dataclass(frozen=True, eq=False)
class Runs:
    """N runs of a scene. `ClosedLoop.run(replay=seed)` does one of them again, with its rows.

    seeds (N,), names, draws (N, d): what varied. words (N,): their verdicts. t (N,): of the last row, seconds.
    error (N, m): the largest deviation of each row of psi (phi) from its prescribed decay; end (N, m): |psi| at the
    last row; share (N,): the largest deviation over its tolerance. tau (N, l): the largest magnitude of each control.
    statuses: how many rows of all runs said what. claim: what they were held to. seconds: that they took.
    A run that ended where controller or plant refused a state has NaN, for it came to nothing that compares.
    """

    scene: str
    seeds: Any
    names: tuple[str, ...]
    draws: FloatArray
    words: tuple[str, ...]
    t: FloatArray
    error: FloatArray
    end: FloatArray
    share: FloatArray
    tau: FloatArray
    rows_limited: Any
    statuses: dict[str, int]
    claim: Claim
    seconds: float = 0.0

    @property
    def verdicts(self) -> dict[str, int]:
        """How many runs came to what, the most frequent first."""
        return dict(Counter(self.words).most_common())

    @property
    def refused(self) -> int:
        """How many ended where controller or plant refused a state."""
        return int(np.isnan(self.share).sum())

    @property
    def held(self) -> bool:
        """Whether all of them were."""
        return set(self.words) == {"held"}

    def quantiles(self, shares: Sequence[float] = QUANTILES) -> dict[str, FloatArray]:
        """name -> quantiles of the runs not refused: each row's error and end, each control's largest magnitude."""
        some = np.isfinite(self.share)
        named: list[tuple[str, FloatArray]] = [
            (f"{n}: off its decay", self.error[:, k]) for k, n in enumerate(self.claim.rows)
        ]
        named += [(f"{n}: at the end", self.end[:, k]) for k, n in enumerate(self.claim.rows)]
        named += [(f"largest |tau[{k}]|", self.tau[:, k]) for k in range(self.tau.shape[1])]
        return {n: np.quantile(v[some], shares) if some.any() else np.full(len(shares), np.nan) for n, v in named}

    @property
    def units(self) -> tuple[str, ...]:
        """Of the quantities of `quantiles`, in their order."""
        return (*self.claim.row_units, *self.claim.row_units, *self.claim.tau_units)

    def worst(self, count: int = 5) -> list[int]:
        """Indices of the worst runs: those that were not held first, the largest share of the tolerance first."""
        share = np.nan_to_num(self.share, nan=np.inf, posinf=np.inf)
        bad = np.array([word != "held" for word in self.words])
        return [int(k) for k in np.lexsort((self.seeds, -share, ~bad))[:count]]

    @property
    def correlation(self) -> dict[str, float]:
        """name -> rank correlation (Spearman's) of what varied, by how far it was off its nominal value, with the share
        of the tolerance, in which a refused run is above all others; the largest first. Near 1: what hurts; near 0:
        what does not matter.
        """
        if np.isfinite(self.share).sum() < 3:
            return {}
        share = _ranks(np.nan_to_num(self.share, nan=np.inf, posinf=np.inf))
        middle = (self.draws.max(axis=0) + self.draws.min(axis=0)) / 2
        found = {}
        for k, name in enumerate(self.names):
            value = self.draws[:, k]
            signed, away = (_correlation(_ranks(v), share) for v in (value, np.abs(value - middle[k])))
            found[name] = signed if abs(signed) >= abs(away) else away
        return dict(sorted(found.items(), key=lambda pair: -abs(np.nan_to_num(pair[1]))))


def _ranks(values: FloatArray) -> FloatArray:
    """The place of each value among all of them in order; equal ones share the mean of theirs."""
    _, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    return np.asarray((np.cumsum(counts) - (counts - 1) / 2)[which])


def _correlation(a: FloatArray, b: FloatArray) -> float:
    """Pearson's, and NaN where one of them does not vary. scipy.stats has it too, and takes a second to be loaded."""
    a, b = a - a.mean(), b - b.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0 else float("nan")


def runs_of(
    scene: str,
    found: Any,
    reasons: Mapping[int, str],
    events: Sequence[str],
    claim: Claim,
    sizes: tuple[int, int, int, int],
    drawn: Any,
    seconds: float,
) -> Runs:
    """From the summaries of simulate/batch.py."""
    m, l = sizes[3], sizes[2]
    none = np.array([reasons[int(r)] not in ("finished", "event") for r in found["reason"]])
    counts = found["statuses"].sum(axis=0)
    return Runs(
        scene=scene,
        seeds=drawn.seeds,
        names=drawn.names,
        draws=drawn.values,
        words=tuple(_word(run, reasons, events) for run in found),
        t=found["t"],
        error=np.where(none[:, None], np.nan, found["error"][:, :m]),
        end=np.where(none[:, None], np.nan, found["end"][:, :m]),
        share=np.where(none, np.nan, found["share"]),
        tau=np.where(none[:, None], np.nan, found["tau"][:, :l]),
        rows_limited=found["rows_limited"],
        statuses={Status(k).name: int(n) for k, n in enumerate(counts) if n},
        claim=claim,
        seconds=seconds,
    )


def _word(run: Any, reasons: Mapping[int, str], events: Sequence[str]) -> str:
    reason = reasons[int(run["reason"])]
    event = events[int(run["detail"])] if reason == "event" else ""
    status = Status.OK if reason in ("event", "finished") else Status(int(run["detail"]))
    first = {n: None if run[n] < 0 else int(run[n]) for n in ("left", "inconsistent", "limited", "off")}
    rows = int(run["rows"])
    growing = grows(float(run["third"]), float(run["last"]), rows)
    return word_of(Outline(rows, **first, growing=growing, end=word_of_end(reason, event, status)))
