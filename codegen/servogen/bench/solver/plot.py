"""Work-precision diagrams: a panel a condition, time along, error up, and the line of those nobody beats in both."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from servogen.bench.plot import PARETO, pareto
from servogen.bench.solver.work_precision import Point, WorkPrecision

STYLES: dict[str, tuple[str, str]] = {
    "servogen auto": ("*", "#b3261e"),
    "servogen NORMAL, unproven": ("o", "#b3261e"),
    "servogen QR (NORMAL in vain)": ("s", "#b3261e"),
    "servogen SVD": ("^", "#b3261e"),
    "servogen COD": ("p", "#b3261e"),
    "servogen NORMAL, unproven, unrefined": ("o", "#e8a09a"),
    "servogen QR (NORMAL in vain), unrefined": ("s", "#e8a09a"),
    "servogen SVD, unrefined": ("^", "#e8a09a"),
    "servogen COD, unrefined": ("p", "#e8a09a"),
    "casadi.pinv, generated C": ("D", "#1f6f54"),
    "Eigen LLT of S S^T, unchecked": ("d", "#7fb8a4"),
    "Eigen COD": ("P", "#3b5b7a"),
    "Eigen JacobiSVD": ("X", "#3b5b7a"),
    "LAPACK gelsy": ("<", "#8a6d1f"),
    "LAPACK gelsd": (">", "#8a6d1f"),
    "LAPACK gesvj": ("v", "#8a6d1f"),
    "numpy lstsq, from Python": ("1", "#6b6b6b"),
    "numpy pinv, from Python": ("2", "#6b6b6b"),
    "scipy lstsq, from Python": ("3", "#6b6b6b"),
    "scipy pinv, from Python": ("4", "#6b6b6b"),
}
"""Marker and colour: ours red, paler without refinement; each library its own."""

TOP = 1e8
"""Errors beyond, and answers that are not finite, stand at the upper edge."""


def draw(found: WorkPrecision, folder: Path) -> dict[tuple[str, str], Path]:
    """One SVG and PNG a shape and scalar, in `folder`; (shape, scalar) -> the SVG."""
    folder.mkdir(parents=True, exist_ok=True)
    paths: dict[tuple[str, str], Path] = {}
    with matplotlib.rc_context({"svg.hashsalt": "servogen", "svg.fonttype": "path"}):
        for shape, scalar in dict.fromkeys((p.shape, p.scalar) for p in found.points):
            figure = _figure(found, shape, scalar)
            path = folder / f"precision_{shape}_{scalar}.svg"
            figure.savefig(path, metadata={"Date": None, "Creator": "servogen"})
            figure.savefig(path.with_suffix(".png"), dpi=110, metadata={"Software": None})
            paths[shape, scalar] = path
    return paths


def shown(found: WorkPrecision, shape: str, scalar: str) -> list[float]:
    """The conditions that get a panel: every other decade, from 1 on."""
    return sorted({p.kappa for p in found.points if (p.shape, p.scalar) == (shape, scalar)})[::2]


def _figure(found: WorkPrecision, shape: str, scalar: str) -> Figure:
    conditions = shown(found, shape, scalar)
    own = [p for p in found.points if (p.shape, p.scalar) == (shape, scalar)]
    rows = 2 * -(-len(conditions) // 4)
    columns = min(4, len(conditions))
    figure = Figure(figsize=(3.6 * columns + 0.8, 3.1 * rows + 1.9))
    FigureCanvasAgg(figure)
    panels = figure.subplots(rows, columns, squeeze=False)
    for half, (measure, label) in enumerate((("error", "error / (eps κ ‖τ‖)"), ("relative", "error / ‖τ‖"))):
        limits = _limits([getattr(p, measure) for p in own])
        for k in range(rows // 2 * columns):
            axes = panels[half * rows // 2 + k // columns, k % columns]
            if k >= len(conditions):
                axes.set_visible(False)
                continue
            _panel(axes, [p for p in own if p.kappa == conditions[k]], measure, limits, own)
            axes.set_title(f"κ = {conditions[k]:g}", loc="left", fontsize=10)
            if k % columns == 0:
                axes.set_ylabel(f"largest {label}", fontsize=9)
            if half == 1 and k + columns >= len(conditions):
                axes.set_xlabel("ns a solve", fontsize=9)
    figure.suptitle(
        f"{shape}, {scalar}: run time against error", x=0.01, y=0.995, ha="left", fontsize=13, weight="bold"
    )
    names = [n for n in STYLES if any(p.contender == n for p in own)]
    handles = [_handle(name) for name in names]
    figure.legend(handles=handles, loc="lower center", ncols=5, fontsize=8.5, frameon=False)
    figure.tight_layout(rect=(0, (0.3 + 0.2 * -(-len(names) // 5)) / (3.1 * rows + 1.9), 1, 0.99))
    return figure


def _handle(name: str) -> Line2D:
    marker, colour = STYLES[name]
    return Line2D([], [], linestyle="", marker=marker, color=colour, label=name, markersize=8)


def _limits(errors: Sequence[float]) -> tuple[float, float]:
    finite = [e for e in errors if 0 < e < TOP]
    return min(finite, default=1e-3) / 3, min(max(finite, default=1.0) * 10, TOP)


def _panel(axes: Any, points: Sequence[Point], measure: str, limits: tuple[float, float], own: Sequence[Point]) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlim(min(p.median for p in own) / 1.5, max(p.median for p in own) * 1.5)
    axes.set_ylim(*limits)
    axes.grid(True, which="major", color="#e6e6e6", linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    line = pareto([(p.median, getattr(p, measure)) for p in points if getattr(p, measure) < limits[1]])
    axes.plot(*zip(*line, strict=True) if line else ([], []), color=PARETO, linewidth=1, zorder=2)
    for order, p in enumerate(points):
        marker, colour = STYLES[p.contender]
        y = min(max(getattr(p, measure), limits[0]), limits[1])
        axes.plot([p.median, p.worst], [y, y], color=colour, linewidth=1, alpha=0.6, zorder=3)
        size = 11 if marker == "*" else 7
        axes.plot(
            [p.median],
            [y],
            marker,
            color=colour,
            markersize=size,
            zorder=99 if marker == "*" else 4 + order,
            clip_on=False,
        )
