"""Run time against error: a panel an output, a marker a contender, and the line of those that nobody beats in both."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogFormatter

from servogen.bench.results import Bench, Measurement, Output

OURS, THEIRS, PARETO = "#b3261e", "#3b5b7a", "#8a8a8a"
_DASHES = {"float64": "o", "float32": "s"}


@dataclass(frozen=True)
class _Room:
    """What labels take: their font in points; of a panel's height, what lies between neighbours; of its width, the gap
    from a marker to its label, and a letter."""

    font: float
    height: float
    gap: float
    letter: float


_WIDE, _NARROW = _Room(8.5, 0.052, 0.045, 0.0135), _Room(8, 0.058, 0.05, 0.021)


def draw(bench: Bench, folder: Path) -> tuple[Path, ...]:
    """Write bench.svg and bench.png into `folder` (which exists); the same bytes for the same bench."""
    figure = _figure(bench)
    style = {"svg.hashsalt": "servogen", "svg.fonttype": "path"}
    paths = folder / "bench.svg", folder / "bench.png"
    with matplotlib.rc_context(style):
        figure.savefig(paths[0], metadata={"Date": None, "Creator": "servogen"})
        figure.savefig(paths[1], dpi=150, metadata={"Software": None})
    return paths


def narrow_figures(bench: Bench) -> dict[Output, Figure]:
    """A figure an output, as wide as a telephone's screen."""
    found = {}
    for output in _outputs(bench):
        with matplotlib.rc_context({"font.size": 9}):
            figure = Figure(figsize=(4.0, 4.0))
            FigureCanvasAgg(figure)
            axes = figure.subplots()
            figure.subplots_adjust(left=0.17, right=0.99, top=0.99, bottom=0.12)
            _panel(axes, bench, output, _NARROW)
            axes.set_title("", loc="left")
            axes.set_ylabel("largest error / largest magnitude")
            found[output] = figure
    return found


def pareto(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Those points of (time, error) that no other beats in one without losing in the other, by rising time."""
    line: list[tuple[float, float]] = []
    for point in sorted(points):
        if not line or point[1] < line[-1][1]:
            line.append(point)
    return line


def _figure(bench: Bench) -> Figure:
    outputs = _outputs(bench)
    columns = min(2, len(outputs))  # no more, or a page shows them too small to read
    rows_of_panels = -(-len(outputs) // columns)
    width, height = 5.4 * columns + 0.6, 5.2 * rows_of_panels + 1.0
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows_of_panels, columns, sharex=True, sharey=True, squeeze=False)
    panels = grid.ravel()[: len(outputs)]
    for spare in grid.ravel()[len(outputs) :]:
        spare.remove()
    for axes, output in zip(panels, outputs, strict=True):
        _panel(axes, bench, output, _WIDE)
    for first in grid[:, 0]:
        first.set_ylabel("largest error, as a part of the output's largest magnitude")
    figure.suptitle(
        f"{bench.scene}: run time against error", x=0.012, y=1 - 0.1 / height, ha="left", fontsize=14, weight="bold"
    )
    figure.text(0.012, 1 - 0.38 / height, _caption(bench), ha="left", va="top", fontsize=9.5, color="#444444")
    figure.subplots_adjust(
        left=0.7 / width, right=1 - 0.1 / width, top=1 - 0.95 / height, bottom=0.6 / height, wspace=0.04, hspace=0.16
    )
    return figure


def _outputs(bench: Bench) -> list[Output]:
    return [o for o in Output if any(m.output is o for m in bench.measurements)]


def _panel(axes: Any, bench: Bench, output: Output, room: _Room) -> None:
    rows = [m for m in bench.measurements if m.output is output and not m.aside]
    low, high = _limits(bench.measurements)
    _axes(axes, bench, output, named=room is _WIDE)
    axes.set_xlim(*_time_limits(bench.measurements))
    axes.set_ylim(low, high)
    _markers(axes, rows, high, room)


def _caption(bench: Bench) -> str:
    return (
        f"{bench.compiler}, {' '.join(bench.flags) or 'no flags'}; {bench.states} states, seed {bench.seed}; "
        f"median of batches of calls at different states, all contenders in turn, {bench.rounds} rounds.\n"
        "Lower left is better; the grey line joins those that nobody beats in both."
    )


class _TimeFormatter(LogFormatter):
    """matplotlib's choice of ticks, with their unit."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        return _time(x) if super().__call__(x, pos) else ""


def _axes(axes: Any, bench: Bench, output: Output, named: bool) -> None:
    """named: whether the lines of the two epsilons say so."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_title(title(bench, output), loc="left", fontsize=11)
    axes.set_xlabel("time per call")
    axes.xaxis.set_major_formatter(_TimeFormatter())
    axes.xaxis.set_minor_formatter(_TimeFormatter(labelOnlyBase=False, minor_thresholds=(1, 0.4)))
    axes.tick_params(labelbottom=True)
    axes.grid(True, which="major", color="#e6e6e6", linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for epsilon, name in ((2.0**-52, "double"), (2.0**-23, "float")):
        axes.axhline(epsilon, color="#bbbbbb", linewidth=0.8, linestyle=":")
        if not named:
            continue
        axes.annotate(
            f"epsilon of {name}", (0.995, epsilon), xycoords=("axes fraction", "data"), xytext=(0, 2),
            textcoords="offset points", ha="right", va="bottom", fontsize=7.5, color="#888888",
        )  # fmt: skip


def title(bench: Bench, output: Output) -> str:
    """What an output is, in words."""
    words = {
        Output.MATRIX: "the constraints' matrix",
        Output.RIGHT: "the right side",
        Output.SYSTEM: "matrix and right side at once",
        Output.ANSWER: "the answer, with everything before it",
    }
    label = next(m.label for m in bench.measurements if m.output == output)
    return f"{label}: {words[output]}"


def _markers(axes: Any, rows: Sequence[Measurement], top: float, room: _Room) -> None:
    """Markers, the line of those that nobody beats in both, and labels; what leaves the axis stands at its edge."""
    points = [(m.times.median, m.errors.largest_relative) for m in rows]
    bottom = axes.get_ylim()[0]
    placed = [(x, min(max(y, bottom * 1.5), top / 1.5)) for x, y in points]
    line = pareto([p for p, m in zip(placed, rows, strict=True) if not m.errors.nonfinite])
    axes.plot(*zip(*line, strict=True) if line else ([], []), color=PARETO, linewidth=1, zorder=2)
    for m, (x, y) in zip(rows, placed, strict=True):
        colour = OURS if m.ours else THEIRS
        axes.plot([x], [y], _DASHES[m.scalar], color=colour, markersize=8 if m.ours else 7, zorder=4)
    _labels(axes, rows, placed, room)


def _labels(axes: Any, rows: Sequence[Measurement], placed: Sequence[tuple[float, float]], room: _Room) -> None:
    """Beside the markers, where need be moved up or down and joined to them by a line."""
    to_panel = axes.transScale + axes.transLimits
    spots = [tuple(to_panel.transform(p)) for p in placed]
    texts = [_label(m) for m in rows]
    beside = [_beside(x, room.letter * len(text), room) for (x, _), text in zip(spots, texts, strict=True)]
    wanted = [(x, y + room.height if side == "center" else y) for (x, y), (_, side) in zip(spots, beside, strict=True)]
    heights = _spread(wanted, room.height)
    for m, text, at, height, (x, side) in zip(rows, texts, spots, heights, beside, strict=True):
        colour = OURS if m.ours else THEIRS
        axes.annotate(
            text, at, xycoords="axes fraction", xytext=(x, height), textcoords="axes fraction", ha=side, va="center",
            fontsize=room.font, color=colour, zorder=5, path_effects=[withStroke(linewidth=2.5, foreground="white")],
            weight="bold" if m.ours else "normal",
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.6, "alpha": 0.6, "shrinkA": 1, "shrinkB": 4},
        )  # fmt: skip


def _beside(x: float, width: float, room: _Room) -> tuple[float, str]:
    """Where a label of that width goes, and its side that is there: right of the marker, left, or above it."""
    if x + room.gap + width <= 1:
        return x + room.gap, "left"
    if x - room.gap - width >= 0:
        return x - room.gap, "right"
    return min(max(x, width / 2), 1 - width / 2), "center"


def _label(m: Measurement) -> str:
    error = "not finite" if m.errors.nonfinite else _ulps(m.errors.largest_ulps)
    return f"{m.contender}  {_time(m.times.median)}, {error}"


def _ulps(ulps: float) -> str:
    if ulps < 0.05:
        return "next to no error"
    return f"{ulps:.{1 if ulps < 100 else 0}f} ulp" if ulps < 1e6 else f"{ulps:.0e} ulp"


def _time(nanoseconds: float) -> str:
    unit, name = next(
        (u, n) for u, n in ((1.0, "ns"), (1e3, "us"), (1e6, "ms")) if nanoseconds < 999.5 * u or n == "ms"
    )
    return f"{nanoseconds / unit:.3g} {name}"


def _spread(spots: Sequence[tuple[float, float]], apart: float) -> list[float]:
    """Heights of the labels: each at its marker's, then pushed apart, group by group."""
    heights = [y for _, y in spots]
    groups: list[list[int]] = []
    for k in sorted(range(len(spots)), key=lambda k: (spots[k][1], k)):
        groups.append([k])
        while len(groups) > 1 and _bottom(groups[-1], spots, apart) < _top(groups[-2], spots, apart):
            groups[-2:] = [groups[-2] + groups[-1]]
    for group in groups:
        for k, height in zip(group, _stack(group, spots, apart), strict=True):
            heights[k] = height
    return heights


def _stack(group: Sequence[int], spots: Sequence[tuple[float, float]], apart: float) -> list[float]:
    """Evenly spaced around the group's centre, within the panel."""
    span = (len(group) - 1) * apart
    centre = sum(spots[k][1] for k in group) / len(group)
    start = min(max(centre - span / 2, 0.03), 0.97 - span)
    return [start + i * apart for i in range(len(group))]


def _bottom(group: Sequence[int], spots: Sequence[tuple[float, float]], apart: float) -> float:
    return _stack(group, spots, apart)[0] - apart / 2


def _top(group: Sequence[int], spots: Sequence[tuple[float, float]], apart: float) -> float:
    return _stack(group, spots, apart)[-1] + apart / 2


def _limits(rows: Sequence[Measurement]) -> tuple[float, float]:
    """Of the error axis: the finite errors with a margin, and always the two epsilons; what is next to nothing is not
    worth an axis."""
    finite = [e for e in (m.errors.largest_relative for m in rows) if 2.0**-56 < e < float("inf")]
    return min([2.0**-52, *finite]) / 30, max([2.0**-23, *finite]) * 30


def _time_limits(rows: Sequence[Measurement]) -> tuple[float, float]:
    times = [m.times.median for m in rows]
    return min(times) / 1.6, max(times) * 1.6
