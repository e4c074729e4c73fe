"""The paper's Figures 2-21, redrawn from closed loops of generated C and laid out like them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Canvas

from servogen.results import FloatArray
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.trajectory import Trajectory
from servogen.simulate.wanted import load_simulation

SCENES = (
    "double_pendulum_energy_free_y",
    "double_pendulum_energy",
    "double_pendulum_ideal",
    "spacecraft",
    "spacecraft_smooth",
)
"""The scenes the figures are of."""

TITLES = {
    2: "servo-constraint dynamics",
    3: "configuration, ideal forces",
    4: "velocity, ideal forces",
    5: "torques, ideal forces",
    6: "decay of the kinetic energy",
    **{7 + k: f"angular velocity {axis}, y = 0" for k, axis in enumerate("xyz")},
    **{10 + k: f"control {axis}, y = 0" for k, axis in enumerate("xyz")},
    **{13 + k: f"free vector {axis}, y = -τ" for k, axis in enumerate("xyz")},
    **{16 + k: f"angular velocity {axis}, y = -τ" for k, axis in enumerate("xyz")},
    **{19 + k: f"control {axis}, y = -τ" for k, axis in enumerate("xyz")},
}
"""What each of the paper's figures shows."""

_STYLE = {"font.size": 10, "axes.grid": True, "grid.color": "#dddddd", "grid.linewidth": 0.6, "legend.frameon": False,
          "axes.spines.top": False, "axes.spines.right": False, "svg.hashsalt": "servogen"}  # fmt: skip

Curve = tuple[FloatArray, FloatArray, str]


@dataclass(frozen=True, eq=False)
class Panel:
    """One figure of the paper: its number, the axis' label, and the curves (t, value, name)."""

    number: int
    label: str
    curves: tuple[Curve, ...]


@dataclass(frozen=True, eq=False)
class Sheet:
    """Some figures on one page: the file without its ending, columns, and what they reproduce."""

    stem: str
    columns: int
    panels: tuple[Panel, ...]
    caption: str


def draw_paper(drawn: Sequence[Sheet], folder: Path) -> tuple[Path, ...]:
    """The PNG of each sheet, written to `folder` beside an SVG."""
    folder.mkdir(parents=True, exist_ok=True)
    return tuple(_draw(sheet, folder) for sheet in drawn)


def narrow_figures(sheet: Sheet) -> dict[int, Canvas]:
    """The panels of a sheet by their number, each a figure as wide as a telephone's screen."""
    found = {}
    for panel in sheet.panels:
        with matplotlib.rc_context(_STYLE | {"font.size": 9}):
            found[panel.number] = canvas = Canvas(figsize=(4.0, 2.3), layout="constrained")
            FigureCanvasAgg(canvas)
            axis = canvas.subplots()
            _panel(axis, panel)
            axis.set_title("", loc="left")
    return found


def run_paper(known: Mapping[str, Trajectory]) -> dict[str, Trajectory]:
    """One run of each of SCENES; those that are known need not be made."""
    return {name: known.get(name) or ClosedLoop(*load_simulation(name)).run() for name in SCENES}


def sheets(runs: dict[str, Trajectory]) -> tuple[Sheet, ...]:
    """The sheets, from one run of each of SCENES."""
    return _pendulum(runs), _chatter(runs["spacecraft"]), _smooth(runs["spacecraft_smooth"])


def _pendulum(runs: dict[str, Trajectory]) -> Sheet:
    free, plain, ideal = (runs[f"double_pendulum_{n}"] for n in ("energy_free_y", "energy", "ideal"))
    E0 = free.outputs["E"][0]
    scale = E0 / plain.outputs["E"][0]
    return Sheet(
        "paper_figures_2_to_5",
        2,
        (
            Panel(
                2,
                "E [J]",
                (
                    (free.t, free.outputs["E"], "with a y that keeps it moving"),
                    (plain.t, scale * plain.outputs["E"], f"y = 0, scaled, to t* = {plain.stop.t:.2f} s"),
                ),
            ),
            Panel(3, "configuration parameters [rad]", _columns(ideal, ideal.q, "θ")),
            Panel(4, "velocity parameters [rad/s]", _columns(ideal, ideal.u, "u")),
            Panel(5, "ideal control torques [N m]", _columns(ideal, ideal.tau, "τ")),
        ),
        "Figures 2 to 5, double pendulum (Section 4), Theta = -1 and E_0 = 0 as in the paper. It prints neither "
        f"masses, lengths nor the start; chosen: {_chosen(ideal)}; start {_start(ideal)}, and for the y that keeps "
        f"it moving {_start(free)}. Figure 2 reproduces the decay of E as exp(-t); with y = 0 it holds until the "
        "mechanism stops. Figures 3 to 5, ideal control forces: the mechanism is slowed to rest in finite time "
        f"(t* = {ideal.stop.t:.2f} s, K/E below 1e-3) with potential energy left, and the torques do not vanish with E "
        "as the paper remarks, but grow as 1/sqrt(K): G tau = Theta E Q u / (2 K).",
    )


def _chatter(run: Trajectory) -> Sheet:
    K = Panel(6, "K [J]", ((run.t, run.outputs["K"], ""),))
    return Sheet(
        "paper_figures_6_to_12",
        3,
        (K, *_axes(7, run, run.u, "ω", "rad/s"), *_axes(10, run, run.tau, "τ", "rad/s²")),
        f"Figures 6 to 12, spacecraft with y = 0 (Section 6), the paper's numbers: {_chosen(run)}; "
        f"{_start(run, with_tau=True)}. K "
        "decays as 0.124 exp(-t) while velocities and controls chatter with a frequency that grows without bound. "
        f"Drawn to {run.t[-1]:g} s; later a period is too short for the step. tau_3(0) = -0.3376 is printed rounded "
        "and projected onto phi = 0 first; the controls are torques over inertia, rad/s², not N m as printed.",
    )


def _smooth(run: Trajectory) -> Sheet:
    return Sheet(
        "paper_figures_13_to_21",
        3,
        (
            *_axes(13, run, -run.tau, "y", "rad/s²"),
            *_axes(16, run, run.u, "ω", "rad/s"),
            *_axes(19, run, run.tau, "τ", "rad/s²"),
        ),
        f"Figures 13 to 21, spacecraft with y = -tau, the paper's numbers: {_chosen(run)}; "
        f"{_start(run, with_tau=True)}. The same "
        "decay of K, all curves smooth: the free vector y, the angular velocities and the controls, axis by axis.",
    )


def _chosen(run: Trajectory) -> str:
    """The parameters of a run in words."""
    return ", ".join(f"{name} = {' '.join(f'{x:g}' for x in v)}" for name, v in run.parameters.items())


def _start(run: Trajectory, with_tau: bool = False) -> str:
    """The first state of a run in words; tau belongs to it where the controller advances it."""
    names = ("q", "u", "tau") if with_tau else ("q", "u")
    return ", ".join(f"{name}(0) = ({', '.join(f'{x:.6g}' for x in getattr(run, name)[0])})" for name in names)


def _columns(run: Trajectory, values: FloatArray, symbol: str) -> tuple[Curve, ...]:
    return tuple((run.t, values[:, k], f"${_tex(symbol)}_{k + 1}$") for k in range(values.shape[1]))


def _axes(first: int, run: Trajectory, values: FloatArray, symbol: str, unit: str) -> list[Panel]:
    return [
        Panel(first + k, f"${_tex(symbol)}_{k + 1}$ [{unit}]", ((run.t, values[:, k], ""),))
        for k in range(values.shape[1])
    ]


def _tex(symbol: str) -> str:
    return {"θ": r"\theta", "τ": r"\tau", "ω": r"\omega"}.get(symbol, symbol)


def _draw(sheet: Sheet, folder: Path) -> Path:
    rows = _rows(sheet)
    with matplotlib.rc_context(_STYLE):
        canvas = Canvas(figsize=(4.1 * sheet.columns, 2.7 * len(rows)), layout="constrained")
        FigureCanvasAgg(canvas)
        grid = canvas.add_gridspec(len(rows), sheet.columns)
        for r, row in enumerate(rows):
            for c, panel in enumerate(row):
                place = grid[r, :] if len(row) == 1 else grid[r, c]
                _panel(canvas.add_subplot(place), panel)
        file = folder / f"{sheet.stem}.png"
        canvas.savefig(file, dpi=150, metadata={"Software": None})
        canvas.savefig(file.with_suffix(".svg"), metadata={"Date": None, "Creator": None})
    return file


def _rows(sheet: Sheet) -> list[Sequence[Panel]]:
    """Rows of panels; where they do not fill the last, the first stands alone."""
    alone = len(sheet.panels) % sheet.columns
    rows: list[Sequence[Panel]] = [sheet.panels[:1]] if alone else []
    rest = sheet.panels[1:] if alone else sheet.panels
    return rows + [rest[k : k + sheet.columns] for k in range(0, len(rest), sheet.columns)]


def _panel(axis: Any, panel: Panel) -> None:
    colours = ("#0072B2", "#D55E00")
    coincide = panel.number == 2
    for (t, values, name), colour in zip(panel.curves, colours, strict=False):
        finite = np.isfinite(values)
        dashes = (0, (4, 3)) if coincide and colour == colours[1] else "solid"
        width = 0.7 if len(t) > 20000 else 1.3
        axis.plot(t[finite], values[finite], color=colour, label=name, linewidth=width, linestyle=dashes)
    axis.set_title(f"Figure {panel.number}: {TITLES[panel.number]}", fontsize=9.5, loc="left")
    axis.set_xlabel("t [s]")
    axis.set_ylabel(panel.label)
    axis.set_xlim(left=0.0)
    if any(name for _, _, name in panel.curves):
        axis.legend(fontsize=9)
