"""A trajectory as figures: states, controls, constraints and outputs beside what they ought to be."""

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from servogen.results import FloatArray
from servogen.scene.scene import Scene
from servogen.simulate.simulation import Simulation, units_of_entries
from servogen.simulate.trajectory import Trajectory

_GREEK = dict(
    zip(
        """alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi pi rho sigma tau phi chi psi
        omega""".split(),
        "αβγδεζηθικλμνξπρστφχψω",
        strict=True,
    )
)
_LOWERED = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#555555")  # told apart by all eyes
_IDEAL = {"color": "black", "linestyle": (0, (4, 3)), "linewidth": 1.2}
STYLE = {
    "font.size": 11,
    "axes.labelsize": 11,
    "axes.titlesize": 12,
    "legend.fontsize": 10,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.5,
    "legend.frameon": False,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-3, 4),
    "svg.hashsalt": "servogen",  # the same bytes for the same figure
}

NARROW = STYLE | {
    "font.size": 9,
    "axes.labelsize": 9,
    "axes.titlesize": 9,
    "legend.fontsize": 9,
    "lines.linewidth": 1.3,
}
"""At 4 inches: text that can be read on a telephone, where such a figure is as wide as the screen."""

METHOD_NAMES = {"rk4": "RK4", "dop8": "Dormand-Prince 8", "mujoco": "MuJoCo"}

Panel = Callable[[Any], None]


def write_plots(scene: Scene, simulation: Simulation, trajectory: Trajectory, out: Path) -> tuple[Path, ...]:
    """states, controls, psi or phi, outputs and margins (where there are any), as PNG and SVG in the folder `out`."""
    files: list[Path] = []
    for name, panels in _panels(scene, simulation, trajectory).items():
        with matplotlib.rc_context(STYLE):
            figure = _figure(trajectory, panels, (7.2, 1.1 + (2.5 if len(panels) < 3 else 1.9) * len(panels)))
            figure.suptitle(_title(trajectory), fontsize=11, x=0.02, ha="left")
            png, svg = (out / f"{name}.{ending}" for ending in ("png", "svg"))
            figure.savefig(png, dpi=160, metadata={"Software": None})
            figure.savefig(svg, metadata={"Date": None, "Creator": None})
        files += [png, svg]
    return tuple(files)


def narrow_figures(scene: Scene, simulation: Simulation, trajectory: Trajectory) -> dict[str, Figure]:
    """The same by name, as wide as a telephone's screen and without a title: for the columns of a page."""
    with matplotlib.rc_context(NARROW):
        panels = _panels(scene, simulation, trajectory)
        return {name: _figure(trajectory, own, (4.0, 0.6 + 1.9 * len(own))) for name, own in panels.items()}


def _panels(scene: Scene, simulation: Simulation, trajectory: Trajectory) -> dict[str, list[Panel]]:
    """The figures by name, the constraint's first: that is what the loop is for."""
    units = simulation.units
    mech = scene.mechanism
    psi = trajectory.constraint_name
    figures = {
        psi: _constraint_panels(scene, trajectory, units.get(psi)),
        "controls": _curves(trajectory, trajectory.tau, _symbol_names(mech.tau), "controls τ", units.get("tau")),
        "states": [
            *_curves(trajectory, trajectory.q, _symbol_names(mech.q), "configuration q", units.get("q")),
            *_curves(trajectory, trajectory.u, _symbol_names(mech.u), "velocity u", units.get("u")),
        ],
    }
    if trajectory.outputs:
        figures["outputs"] = _output_panels(trajectory, units)
    if simulation.sigma_min is not None or simulation.tau_max is not None:
        figures["margins"] = _margin_panels(simulation, trajectory, units.get("tau"))
    return figures


def _figure(trajectory: Trajectory, panels: Sequence[Panel], size: tuple[float, float]) -> Figure:
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    for panel, axis in zip(panels, axes, strict=True):
        panel(axis)
        _mark_stop(trajectory, axis)
    axes[-1].set_xlabel("time t [s]")
    figure.align_ylabels(axes)
    return figure


def _title(trajectory: Trajectory) -> str:
    way = f"{METHOD_NAMES[trajectory.method]}, h = {trajectory.step:g} s"
    if trajectory.hold:
        way = f"tau held for {trajectory.hold:g} s"
    return f"{trajectory.scene}: generated C in closed loop, {way}"


def _mark_stop(trajectory: Trajectory, axis: Any) -> None:
    """Where the run ended before its time, and why."""
    if trajectory.stop.reason == "finished":
        return
    end = trajectory.stop.t
    axis.axvline(end, color="#888888", linewidth=1.0)
    axis.set_xlim(0.0, max(end * 1.2, 1e-9))
    if axis.get_subplotspec().is_first_row():
        why = trajectory.stop.event or trajectory.stop.status.name
        text = f"{why}\nt* = {end:.4g} s"
        axis.annotate(text, (end, 1.0), (4, -2), xycoords=("data", "axes fraction"), textcoords="offset points",
                      va="top", fontsize=9, color="#444444")  # fmt: skip


def _curves(
    trajectory: Trajectory, values: FloatArray, names: Sequence[str], what: str, unit: str | None
) -> list[Panel]:
    """All curves of one unit in one panel; one panel each where they chatter and would cover one another."""
    units = units_of_entries(unit, len(names))
    if len(set(units)) > 1:
        panels: list[Panel] = []
        for one_unit in dict.fromkeys(units):
            mine = [k for k, of_entry in enumerate(units) if of_entry == one_unit]
            of_unit = [names[k] for k in mine]
            told = ", ".join(of_unit) if len(of_unit) <= 3 else what
            panels += _curves(trajectory, values[:, mine], of_unit, told, one_unit)
        return panels
    unit = units[0]
    if not _chatters(values):
        return [partial(_together, trajectory.t, values, names, _axis(what, unit))]
    columns = np.split(values, values.shape[1], axis=1)
    one = [[name] for name in names]
    return [partial(_together, trajectory.t, v, n, _axis(n[0], unit)) for v, n in zip(columns, one, strict=True)]


def _together(t: FloatArray, values: FloatArray, names: Sequence[str], label: str, axis: Any) -> None:
    width = 1.5 if len(names) > 1 else 0.9
    for k, name in enumerate(names):
        axis.plot(t, values[:, k], color=COLOURS[k % len(COLOURS)], label=name, linewidth=width)
    axis.set_ylabel(label)
    _legend(axis, len(names))


def _chatters(values: FloatArray) -> bool:
    """Whether some column turns round more than 60 times."""
    slopes = np.sign(np.diff(values, axis=0))
    turns = np.sum(slopes[1:] * slopes[:-1] < 0, axis=0)
    return values.shape[1] > 1 and bool(np.any(turns > 60))


def _constraint_panels(scene: Scene, trajectory: Trajectory, unit: str | None) -> list[Panel]:
    """One panel a row: the servo-constraint and its prescribed decay."""
    names = [f"{c.name} {k}" if c.size > 1 else c.name for c in scene.constraints for k in range(c.size)]
    symbol = {"psi": "ψ", "phi": "φ"}[trajectory.constraint_name]

    def row(k: int, name: str) -> Panel:
        def panel(axis: Any) -> None:
            axis.plot(trajectory.t, trajectory.constraint[:, k], color=COLOURS[0], label=f"{symbol}, {name}")
            axis.plot(trajectory.t, trajectory.ideal[:, k], label="prescribed by Θ", **_IDEAL)
            axis.set_ylabel(_axis(f"constraint {symbol}", unit))
            _legend(axis, 2)

        return panel

    return [row(k, name) for k, name in enumerate(names)]


def _output_panels(trajectory: Trajectory, units: Mapping[str, str]) -> list[Panel]:
    """Each output beside its ideal decay, and below it how far it is off."""
    panels: list[Panel] = []
    for name, values in trajectory.outputs.items():
        ideal = trajectory.decay.get(name)
        panels.append(_output(trajectory, name, values, ideal, units.get(name)))
        if ideal is not None:
            panels.append(_deviation(trajectory, name, values, ideal))
    return panels


def _output(trajectory: Trajectory, name: str, values: FloatArray, ideal: FloatArray | None, unit: str | None) -> Panel:
    def panel(axis: Any) -> None:
        axis.plot(trajectory.t, values, color=COLOURS[0], label=name)
        if ideal is not None:
            axis.plot(trajectory.t, ideal, label="ideal decay", **_IDEAL)
            _legend(axis, 2)
        if _spans_decades(values):
            axis.set_yscale("log")
        axis.set_ylabel(_axis(name, unit))

    return panel


def _deviation(trajectory: Trajectory, name: str, values: FloatArray, ideal: FloatArray) -> Panel:
    scale = np.maximum(np.abs(ideal), np.finfo(float).tiny)
    error = np.abs(values - ideal) / scale
    positive = error > 0

    def panel(axis: Any) -> None:
        axis.plot(trajectory.t[positive], error[positive], color=COLOURS[1], linewidth=1.0)
        axis.set_yscale("log")
        axis.set_ylabel(f"|{name} − ideal| / ideal")

    return panel


def _margin_panels(simulation: Simulation, trajectory: Trajectory, unit: str | None) -> list[Panel]:
    """What is watched, and where it would end the run."""
    watched = [
        ("σ_min, or a bound", trajectory.sigma_min, simulation.sigma_min),
        (_axis("largest |τ|", unit), np.max(np.abs(trajectory.tau), axis=1), simulation.tau_max),
    ]

    def margin(label: str, values: FloatArray, limit: float) -> Panel:
        def panel(axis: Any) -> None:
            axis.plot(trajectory.t, values, color=COLOURS[0], label=label.partition(" [")[0])
            axis.axhline(limit, label=f"limit {limit:g}", **_IDEAL)
            axis.set_yscale("log")
            axis.set_ylabel(label)
            _legend(axis, 2)

        return panel

    return [margin(label, values, limit) for label, values, limit in watched if limit is not None]


def _spans_decades(values: FloatArray) -> bool:
    finite = values[np.isfinite(values)]
    return bool(len(finite)) and bool(np.min(finite) > 0) and bool(np.max(finite) > 30 * np.min(finite))


def _legend(axis: Any, count: int) -> None:
    """Above the panel, in as many columns as its width has room for."""
    if count > 1:
        above = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.1}
        size = matplotlib.rcParams["legend.fontsize"]
        letters = 72 * axis.figure.get_figwidth() / (0.6 * size) - 8  # of a row, less the axis
        longest = max(len(label) for label in axis.get_legend_handles_labels()[1])
        if count * (longest + 5) > 2 * letters:
            size, letters = size - 2, letters * size / (size - 2)
        columns = max(1, min(count, int(letters / (longest + 5))))
        axis.legend(ncols=columns, fontsize=size, handlelength=1.6, columnspacing=1.2, **above)


def _axis(name: str, unit: str | None) -> str:
    """ "K [J]", powers in the unit raised."""
    if not unit:
        return name
    raised = re.sub(r"\^(-?[0-9]+)", lambda power: power[1].translate(_RAISED), unit)
    return f"{name} [{raised}]"


def _symbol_names(symbols: Any) -> list[str]:
    """theta_0 as a Greek letter with an index, other names as they are; of long ones only the words that differ."""
    names = [s.name() for s in symbols.nonzeros()]
    words = [name.split("_") for name in names]
    if len(names) > 1 and max(map(len, names)) > 12:
        lead, trail = _common(words), _common([w[::-1] for w in words])
        told = [" ".join(w[lead : len(w) - trail]) for w in words]
        if all(told) and len(set(told)) == len(told):
            return told
    return [_symbol(name) for name in names]


def _common(words: Sequence[Sequence[str]]) -> int:
    """With how many words all begin."""
    return sum(1 for _ in takewhile(lambda column: len(set(column)) == 1, zip(*words, strict=False)))


def _symbol(name: str) -> str:
    base, _, index = name.rpartition("_")
    if not base or not index.isdigit():
        base, index = name, ""
    return _GREEK.get(base, base.replace("_", " ")) + index.translate(_LOWERED)
