"""How `servogen simulate --runs` speaks: quantiles, verdicts, what hurts most, and the worst runs."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.markup import escape

from servogen.cli.console import out, table
from servogen.simulate.runs import QUANTILES, Runs
from servogen.simulate.trajectory import with_unit

WORST = 5
"""Runs whose seeds are shown."""


def runs_summary(runs: Runs) -> dict[str, Any]:
    """The runs in numbers, for --json."""
    return {
        "scene": runs.scene,
        "runs": len(runs.words),
        "seconds": runs.seconds,
        "verdicts": runs.verdicts,
        "refused": runs.refused,
        "tolerance": {n: float(x) for n, x, _ in _tolerances(runs)},
        "quantiles": {"of": list(QUANTILES)} | runs.quantiles(),
        "statuses": runs.statuses,
        "rows_limited": int(runs.rows_limited.sum()),
        "correlation": runs.correlation,
        "worst": [
            {
                "seed": int(runs.seeds[k]),
                "verdict": runs.words[k],
                "share_of_tolerance": float(runs.share[k]),
                "drawn": dict(zip(runs.names, runs.draws[k].tolist(), strict=True)),
            }
            for k in runs.worst(WORST)
        ],
    }


def show_runs(runs: Runs, machine: str, files: Sequence[Path]) -> None:
    """The same for a person."""
    header = ("quantity", *("largest" if q == 1 else f"{100 * q:g} %" for q in QUANTILES))
    rows = [
        (escape(f"{name} [{unit}]") if unit else name, *(f"{x:.4g}" for x in values))
        for unit, (name, values) in zip(runs.units, runs.quantiles().items(), strict=True)
    ]
    count = len(runs.words)
    table(f"{runs.scene}: {_runs(count)} in {runs.seconds:.3g} s", header, rows, right=range(1, len(header)))
    if machine:
        out.print(f"  the machine: {machine}", markup=False)
    statuses = ", ".join(f"{n} ({c:,})" for n, c in runs.statuses.items())
    out.print(f"  statuses {statuses or 'none'}", markup=False)
    for word, number in runs.verdicts.items():
        style = "bold green" if word == "held" else "bold red"
        out.print(f"  [{style}]{escape(word)}[/]: {_runs(number)}, {100 * number / count:.3g} %")
    if runs.refused:
        ended = f"  {_runs(runs.refused)} ended where controller or plant refused a state"
        out.print(f"{ended}: in no quantile, and worse than all others", markup=False)
    held_to = ", ".join(f"{n} {with_unit(x, unit, 3)}" for n, x, unit in _tolerances(runs))
    out.print(f"  tolerance of the deviation from the prescribed decay: {held_to}", markup=False)
    hurts = ", ".join(f"{n} ({rho:+.2f})" for n, rho in runs.correlation.items())
    if hurts:
        out.print(f"  what hurts most, by rank correlation with the error: {hurts}", markup=False)
    worst = [(int(runs.seeds[k]), runs.words[k], f"{runs.share[k]:.3g}", _drawn(runs, k)) for k in runs.worst(WORST)]
    title = "The worst; --replay SEED in the place of --runs does one again, with its rows and figures"
    table(title, ("seed", "verdict", "error / tolerance", "drawn"), worst, right=(0, 2))
    for file in files:
        out.print(f"  wrote  {file}", markup=False, soft_wrap=True)


def _runs(count: int) -> str:
    return f"{count:,} run{'' if count == 1 else 's'}"


def _tolerances(runs: Runs) -> Iterator[tuple[str, float, str]]:
    yield from zip(runs.claim.rows, runs.claim.tolerance, runs.claim.row_units, strict=True)


def _drawn(runs: Runs, k: int) -> str:
    return ", ".join(f"{n} = {x:.4g}" for n, x in zip(runs.names, runs.draws[k], strict=True))
