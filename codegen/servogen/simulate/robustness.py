"""Many runs as one figure: how far they were off, by verdict, and what hurts most."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from servogen.simulate.plots import COLOURS, NARROW, STYLE
from servogen.simulate.runs import Runs

_HELD = "#009E73"


def write_robustness(runs: Runs, out: Path) -> tuple[Path, ...]:
    """robustness.png and .svg in the folder `out`; none where no run has a deviation to draw."""
    if not (np.isfinite(runs.share) & (runs.share > 0)).any():
        return ()
    with rc_context(STYLE):
        figure = _figure(runs, 7.2, 3.0)
        figure.suptitle(f"{runs.scene}: {len(runs.words):,} runs of generated C", fontsize=11, x=0.02, ha="left")
        png, svg = out / "robustness.png", out / "robustness.svg"
        figure.savefig(png, dpi=160, metadata={"Software": None})
        figure.savefig(svg, metadata={"Date": None, "Creator": None})
    return png, svg


def narrow_robustness(runs: Runs) -> Figure:
    """The same as wide as a telephone's screen and without a title: for the columns of a page."""
    with rc_context(NARROW):
        return _figure(runs, 4.0, 2.2)


def _figure(runs: Runs, width: float, height: float) -> Figure:
    """height: of the histogram; the correlations below take what their number asks for."""
    bars = 0.5 + 0.3 * min(len(runs.correlation), 20)
    figure = Figure(figsize=(width, height + bars), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 1, height_ratios=[height, bars])
    _shares(runs, above)
    _correlations(runs, below)
    return figure


def _shares(runs: Runs, axis: Any) -> None:
    """How many runs were off by how much of the tolerance, a colour a verdict."""
    some = np.isfinite(runs.share) & (runs.share > 0)
    low, high = np.log10(runs.share[some].min()), np.log10(runs.share[some].max())
    edges = np.logspace(low - 0.05, max(high, low + 0.1) + 0.05, 41)
    words = np.array(runs.words)
    named = list(runs.verdicts)
    columns = [runs.share[some & (words == word)] for word in named]
    labels = [f"{word} ({count:,})" for word, count in runs.verdicts.items()]
    others = iter([c for c in COLOURS if c != _HELD] * len(named))
    colours = [_HELD if word == "held" else next(others) for word in named]
    axis.hist(columns, edges, stacked=True, label=labels, color=colours)
    axis.set_axisbelow(True)
    axis.axvline(1.0, color="black", linewidth=1.0)
    axis.set_xscale("log")
    axis.set_xlabel("largest deviation over its tolerance")
    axis.set_ylabel("runs")
    axis.legend()


def _correlations(runs: Runs, axis: Any) -> None:
    """Rank correlation of what varied with the deviation."""
    found = list(runs.correlation.items())[:20][::-1]
    axis.barh([name for name, _ in found], [rho for _, rho in found], color=COLOURS[0], height=0.6)
    axis.set_axisbelow(True)
    axis.axvline(0.0, color="black", linewidth=0.8)
    axis.set_xlim(-1, 1)
    axis.set_xticks([-1, -0.5, 0, 0.5, 1])
    axis.set_xlabel("rank correlation with it: ±1 hurts, 0 does not matter")
