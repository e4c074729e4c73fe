"""What a report says of one scene, computed stage by stage."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from servogen.analysis.analyse import BRIEF, Analysis, analyse
from servogen.bench.peers.peers import bench_peers
from servogen.bench.plot import draw, title
from servogen.bench.plot import narrow_figures as narrow_bench
from servogen.bench.results import Bench
from servogen.bench.run import bench
from servogen.compiler import build, optimised_scene
from servogen.derive.formulation import Quantity
from servogen.derive.lower import lower_quantities
from servogen.ir.program import Program
from servogen.optimise.passes import optimise
from servogen.package import Package
from servogen.report.drawing import Drawing, draw_motion
from servogen.report.equations import Equations, equations
from servogen.report.inline import inline_svg
from servogen.report.sparsity import kinds, picture
from servogen.report.stages import Skipped, Stage
from servogen.scalars import EPSILON
from servogen.scene.samples import draw_samples
from servogen.scene.scene import Scene
from servogen.scene.system import SYSTEMS
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.drawing import motion_of
from servogen.simulate.export import write_csv, write_runs_csv
from servogen.simulate.methods import MethodRun, NotSmooth, draw_methods, measure, methods_figure
from servogen.simulate.plots import narrow_figures, write_plots
from servogen.simulate.robustness import narrow_robustness, write_robustness
from servogen.simulate.runs import Runs
from servogen.simulate.simulation import Simulation
from servogen.simulate.trajectory import Trajectory, with_unit
from servogen.simulate.trials import scattered
from servogen.simulate.wanted import load_simulation
from servogen.verify.check import CheckReport, check

BOARD = "cortex-m4"
"""The emulated board of the report."""

RUNS = 100
"""Of the scene on machines that nobody knows exactly."""

_OF_THE_CONSTRAINT = "Constraint error, and its prescribed decay"

CAPTIONS: dict[str, str] = {
    **{system.constraint: _OF_THE_CONSTRAINT for system in SYSTEMS.values()},
    "controls": "Controls",
    "states": "Configuration and velocity",
    "outputs": "Outputs",
    "margins": "Margins that end the run",
}
"""The figures of a run in words."""

STAGES = (
    Stage("generate", "generate", 600, needed=True),
    Stage("loop", "closed loop", 120),
    Stage("robustness", "closed loop on machines that differ", 120),
    Stage("check", "cross-check on this machine", 300),
    Stage("board", f"cross-check on {BOARD}", 300),
    Stage("speed", "run time against error", 300),
    Stage("precision", "closed loop by step size, method and scalar", 120),
)
"""The stages of a scene: methods of SceneWork, and the seconds each may take."""


@dataclass(frozen=True)
class Figure:
    """A picture as the page holds it: an SVG element and a caption."""

    svg: str
    caption: str


@dataclass(frozen=True)
class Symbol:
    """A parameter or an input of the scene, in words."""

    name: str
    kind: str
    values: str
    unit: str
    text: str


@dataclass(frozen=True, eq=False)
class Generated:
    """The packages of both scalars, and what stands in them."""

    symbols: tuple[Symbol, ...]
    manifests: dict[str, dict[str, Any]]  # by scalar
    equations: Equations
    patterns: tuple[tuple[str, str], ...]  # a matrix with its shape, and an SVG of what its entries are
    mass: str
    call: str
    inside: Analysis


@dataclass(frozen=True, eq=False)
class Loop:
    """A run, and what the page says of it."""

    trajectory: Trajectory
    ending: tuple[tuple[str, str], ...]  # what the margins were at the end, and their extremes along the way
    figures: tuple[Figure, ...]
    drawing: Drawing | None = None


@dataclass(frozen=True, eq=False)
class Robustness:
    """Many runs on machines that differ; varied: in what, in words."""

    runs: Runs
    varied: str
    figures: tuple[Figure, ...]


@dataclass(frozen=True, eq=False)
class Speed:
    """Run time against error of the generated functions beside others'."""

    bench: Bench
    figures: tuple[Figure, ...]


@dataclass(frozen=True, eq=False)
class LoopPrecision:
    """Run time against error of the closed loop; single: what single precision costs."""

    figure: Figure
    single: str


@dataclass(frozen=True)
class Work:
    """How one scene's report is to be made. spec: as on the command line; folder: of its files.

    states: of the cross-check; rounds: of the benchmark; peers: whether against whole rivals.
    """

    spec: str
    folder: Path
    states: int
    rounds: int
    peers: bool = False

    def begin(self) -> "SceneWork":
        """The work itself, in the process that does it."""
        return SceneWork(self)


class SceneWork:
    """The stages of one scene, in any order; what they share is computed once."""

    def __init__(self, work: Work) -> None:
        self._work = work
        self._scene, self._simulation = load_simulation(work.spec)

    def generate(self) -> Generated:
        """Both packages, and the formulas. Raises SceneError for anything wrong with the scene."""
        scene, folder = self._scene, self._work.folder
        packages = {
            "float64": build(scene, folder / "f64", "float64"),
            "float32": build(scene, folder / "f32", "float32"),
        }
        formulation, optimised = optimised_scene(scene)
        return Generated(
            symbols=_symbols(scene, self._simulation.units),
            manifests={scalar: package.manifest for scalar, package in packages.items()},
            equations=equations(scene, formulation, packages["float64"].module),
            patterns=_patterns(scene, optimised.program),
            mass=formulation.mass.reason,
            call=_call(packages["float64"]),
            inside=analyse(scene, BRIEF),
        )

    def loop(self) -> Loop:
        """The run that the scene's file asks for; its rows go to trajectory.csv."""
        scene, simulation, run, folder = self._scene, self._simulation, self._run, self._work.folder
        write_csv(run, folder / "trajectory.csv")
        if not len(run.t):
            return Loop(run, (("why the run ended", str(run.stop)),), ())
        write_plots(scene, simulation, run, folder)
        narrow = narrow_figures(scene, simulation, run)
        return Loop(
            trajectory=run,
            ending=_ending(run, simulation),
            figures=tuple(
                Figure(inline_svg(f, f"{scene.name}: {CAPTIONS[name]}", f"{scene.name}-{name}"), CAPTIONS[name])
                for name, f in narrow.items()
            ),
            drawing=self._drawing(),
        )

    def _drawing(self) -> Drawing | None:
        motion = motion_of(self._scene, self._simulation, self._run)
        if motion is None:
            return None
        label = f"The mechanism of {self._scene.name} from t = {motion.t[0]:g} s to {motion.t[-1]:.4g} s"
        unit = "m" if self._simulation.drawing is None else ""  # a robot's frames are in metres
        return draw_motion(motion, label, self._simulation.units.get("drawing", unit))

    def robustness(self) -> Robustness:
        """Runs with other plants, starts and noise; each run's outcome goes to runs.csv. Skipped where none begins."""
        if not len(self._run.t):
            raise Skipped("the start was refused")
        varied, machine = scattered(self._loop, self._run)
        runs, folder = self._loop.runs(RUNS, **machine), self._work.folder
        write_runs_csv(runs, folder / "runs.csv")
        figures = []
        if write_robustness(runs, folder):
            caption = "Error of each run, and what hurts most"
            drawn = inline_svg(narrow_robustness(runs), f"{self._scene.name}: {caption}", f"{self._scene.name}-runs")
            figures.append(Figure(drawn, caption))
        return Robustness(runs, varied, tuple(figures))

    def check(self) -> CheckReport:
        """The generated C against the 50-digit truth."""
        return check([self._scene], states=self._work.states)

    def board(self) -> CheckReport:
        """The same on the emulated board."""
        return check([self._scene], BOARD, self._work.states)

    def speed(self) -> Speed:
        """Run time against error, beside others."""
        rounds = self._work.rounds
        found = bench_peers(self._work.spec, rounds=rounds) if self._work.peers else bench(self._scene, rounds=rounds)
        draw(found, self._work.folder)
        figures = []
        for output, figure in narrow_bench(found).items():
            caption = title(found, output)
            drawn = inline_svg(figure, f"{caption}: run time against error", f"{self._scene.name}-{output.name}")
            figures.append(Figure(drawn, caption))
        return Speed(found, tuple(figures))

    def precision(self) -> LoopPrecision:
        """The closed loop with every step size, method and scalar. Raises Skipped where that has no meaning."""
        if not self._run.stop.t > 0:
            raise Skipped("the run ended where it began")
        name, duration = self._scene.name, min(2.0, 0.5 * self._run.stop.t)
        steps = [duration / n for n in (20, 40, 80, 160, 320, 640, 1280)]
        try:
            points = measure(self._scene, self._simulation, duration, steps)
        except NotSmooth as why:
            raise Skipped(str(why)) from why
        draw_methods(name, duration, points, self._work.folder / "precision")
        drawn = inline_svg(methods_figure(duration, points), "run time against error", f"{name}-precision")
        return LoopPrecision(
            Figure(drawn, "Each mark a step size, its run time against its error"), _single(points, duration)
        )

    @cached_property
    def _run(self) -> Trajectory:
        return self._loop.run()

    @cached_property
    def _loop(self) -> ClosedLoop:
        return ClosedLoop(self._scene, self._simulation)


def _symbols(scene: Scene, units: Mapping[str, str]) -> tuple[Symbol, ...]:
    """The parameters with their defaults, and the inputs with what they are drawn from; the states' units are given."""

    def numbers(values: Sequence[float]) -> str:
        return ", ".join(f"{x:.4g}" for x in (values[:1] if len(set(values)) == 1 else values))

    rows = [Symbol(f.name, "parameter", numbers(f.default), f.unit, f.text) for f in scene.parameters]
    for name, (low, high) in draw_samples(scene).box.items():
        f = next(f for f in scene.input_fields() if f.name == name)
        kind = "state" if name in ("q", "u", "tau") else "time" if name == "t" else "input"
        unit = f.unit or units.get(name, "")
        rows.append(Symbol(name, kind, f"{numbers(list(low))} to {numbers(list(high))}", unit, f.text))
    return tuple(rows)


def _patterns(scene: Scene, program: Program) -> tuple[tuple[str, str], ...]:
    """Q as the user wrote it, zeros that cancel found; the matrix of the system (and J) as optimised."""
    model = optimise(lower_quantities(scene, [Quantity("Q", scene.mechanism.Q, "", "")]))
    names = dict.fromkeys((scene.system.matrix, scene.system.reach))
    found = [(model, "Q"), *((program, name) for name in names)]
    shown = ((name, kinds(p, name)) for p, name in found)
    return tuple((f"{name}, {len(rows)}×{len(rows[0])}", picture(name, rows)) for name, rows in shown)


def _ending(run: Trajectory, simulation: Simulation) -> tuple[tuple[str, str], ...]:
    """Each margin in words: the reason first, then the numbers a reader wants beside it."""
    units = simulation.units
    last, largest = (with_unit(float(np.max(np.abs(x))), units.get("tau")) for x in (run.tau[-1], run.tau))
    rows = [
        ("why the run ended", str(run.stop)),
        (
            "smallest singular value, or a bound below it",
            f"{run.sigma_min[-1]:.3g} at the end, never below {np.min(run.sigma_min):.3g}",
        ),
        ("largest control", f"{last} at the end, never above {largest}"),
        ("rank", f"{run.rank[-1]} at the end, never below {np.min(run.rank)}"),
    ]
    for name, v in run.outputs.items():
        last, first = (with_unit(float(x), units.get(name), 4) for x in (v[-1], v[0]))
        rows.append((name, f"{last} at the end, {first} at the start"))
    watched = ", ".join(simulation.events)
    return (*rows, ("what would have ended it", watched or "nothing but the time"))


def _single(points: Sequence[MethodRun], duration: float) -> str:
    """The best of all step sizes and methods, in either scalar."""
    best = {scalar: [p.error for p in points if p.scalar == scalar] for scalar in EPSILON}
    if not all(best.values()):
        return "In one of the two scalars no run came to its end."
    double, single = min(best["float64"]), min(best["float32"])
    return (
        f"At best, whatever the step, q and u are off by {double:.2g} in float64 and by {single:.2g} in float32 after "
        f"{duration:.3g} s. Where the curve of float32 turns back, smaller steps only add rounding."
    )


def _call(package: Package) -> str:
    """The statements of the control function's own code, as generated."""
    text = (package.path / f"{package.prefix}.c").read_text()
    kernel = package.module.control.name if package.module.control else ""
    found = re.search(rf"^static (?:\w+ )?void {package.prefix}_eval_{kernel}\(.*?^}}", text, re.MULTILINE | re.DOTALL)
    return found.group(0) if found else ""
