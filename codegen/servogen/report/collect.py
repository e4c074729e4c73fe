"""Everything the page shows, computed: generation, cross-check, closed loop, run time against error."""

import base64
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from servogen.bench.peers.peers import bench_peers
from servogen.bench.plot import draw
from servogen.bench.results import Bench
from servogen.bench.run import bench
from servogen.compiler import build, optimised_scene
from servogen.derive.formulation import Quantity
from servogen.derive.lower import lower_quantities
from servogen.errors import SceneError
from servogen.ir.program import Program
from servogen.loading import load_simulation, scene_summary
from servogen.optimise.passes import optimise
from servogen.package import Package
from servogen.report.equations import Equations, equations
from servogen.report.paper import SCENES as PAPER
from servogen.report.paper import draw_paper
from servogen.report.sparsity import kinds, picture
from servogen.results import STATUS_MEANING
from servogen.scalars import EPSILON
from servogen.scene.domain import domain_box, draw_states
from servogen.scene.scene import Scene
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.export import write_csv
from servogen.simulate.plots import write_plots
from servogen.simulate.precision import Precision, draw_precision, measure
from servogen.simulate.simulation import Simulation
from servogen.simulate.trajectory import Trajectory, with_unit
from servogen.verify.check import CheckReport, check

Progress = Callable[[int, int, str], None]

STATES_OF_A_BOX = 200
"""States from which the domain of a scene that draws its own is read off."""


@dataclass(frozen=True, eq=False)
class Figure:
    """A picture as the page holds it: a data URI and a caption."""

    uri: str
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
class SceneReport:
    """One scene: what was generated, and its figures. `folder` holds the files, relative to the page."""

    name: str
    summary: str
    scene: Scene
    symbols: tuple[Symbol, ...]
    manifests: dict[str, dict[str, Any]]  # by scalar
    equations: Equations
    patterns: tuple[tuple[str, str], ...]  # a matrix with its shape, and an SVG of what its entries are
    mass: str
    call: str
    trajectory: Trajectory
    off_decay: str  # how far the constraints were off their prescribed decay, and when
    ending: tuple[tuple[str, str], ...]  # what the margins were at the end, and their extremes along the way
    decay_error: dict[str, float]
    motion: tuple[Figure, ...]
    bench: Bench
    speed: Figure
    precision: Figure
    single: str  # what single precision costs in closed loop
    folder: str


@dataclass(frozen=True, eq=False)
class Report:
    """The page's content."""

    scenes: tuple[SceneReport, ...]
    check: CheckReport
    board: CheckReport | None
    skipped: tuple[str, ...]
    paper: tuple[Figure, ...] = ()


def collect(
    specs: Sequence[str],
    folder: Path,
    board: str | None,
    states: int,
    rounds: int,
    skipped: Sequence[str],
    progress: Progress,
    peers: bool = False,
) -> Report:
    """Run everything for scenes named as on the command line; their files go to folder/<scene>/.

    board: a target to repeat the cross-check on, or None. peers: bench against whole rivals.
    """
    loaded = [(spec, *load_simulation(spec)) for spec in specs]
    steps = 4 * len(loaded) + 2 + (board is not None)
    done = 0

    def say(text: str) -> None:
        nonlocal done
        progress(done, steps, text)
        done += 1

    scenes = [_scene_report(spec, scene, simulation, folder, rounds, peers, say) for spec, scene, simulation in loaded]
    say("cross-check on this machine")
    host = check([scene for _, scene, _ in loaded], states=states)
    emulated = None
    if board is not None:
        say(f"cross-check on {board}")
        emulated = check([scene for _, scene, _ in loaded], board, states)
    paper: tuple[Figure, ...] = ()
    if any(s.name in PAPER for s in scenes):
        say("the paper's figures")
        known = {s.name: s.trajectory for s in scenes}
        drawn = draw_paper(folder / "paper", lambda name: known.get(name) or ClosedLoop(*load_simulation(name)).run())
        paper = tuple(Figure(_data_uri(file), caption) for file, caption in drawn)
    return Report(tuple(scenes), host, emulated, (*skipped, *host.skipped), paper)


def _symbols(scene: Scene, units: Mapping[str, str]) -> tuple[Symbol, ...]:
    """The parameters with their defaults, and the inputs with what they are drawn from; the states' units are given."""

    def numbers(values: Sequence[float]) -> str:
        return ", ".join(f"{x:.4g}" for x in (values[:1] if len(set(values)) == 1 else values))

    rows = [Symbol(f.name, "parameter", numbers(f.default), f.unit, f.text) for f in scene.parameters]
    for name, (low, high) in domain_box(scene, draw_states(scene, STATES_OF_A_BOX)).items():
        f = next(f for f in scene.input_fields() if f.name == name)
        kind = "state" if name in ("q", "u", "tau") else "time" if name == "t" else "input"
        unit = f.unit or units.get(name, "")
        rows.append(Symbol(name, kind, f"{numbers(list(low))} to {numbers(list(high))}", unit, f.text))
    return tuple(rows)


def _scene_report(
    spec: str,
    scene: Scene,
    simulation: Simulation,
    folder: Path,
    rounds: int,
    peers: bool,
    say: Callable[[str], None],
) -> SceneReport:
    own = folder / scene.name
    say(f"{scene.name}: generate")
    packages = {
        "float64": build(scene, own / "f64", "float64"),
        "float32": build(scene, own / "f32", "float32"),
    }
    say(f"{scene.name}: closed loop")
    trajectory = ClosedLoop(scene, simulation).run()
    if not len(trajectory.t):
        why = STATUS_MEANING[trajectory.stop.status]
        raise SceneError(f"{scene.name}: the {trajectory.stop.reason} refused the simulation's start: {why}")
    write_csv(trajectory, own / "trajectory.csv")
    pictures = [p for p in write_plots(scene, simulation, trajectory, own) if p.suffix == ".png"]
    say(f"{scene.name}: run time against error")
    measured = bench_peers(spec, rounds=rounds) if peers else bench(scene, rounds=rounds)
    drawn = next(p for p in draw(measured, own) if p.suffix == ".png")
    say(f"{scene.name}: step size, method and scalar against error")
    duration = min(2.0, 0.5 * trajectory.stop.t)
    steps = [duration / n for n in (20, 40, 80, 160, 320, 640, 1280)]
    points = measure(scene, simulation, duration, steps)
    precision = draw_precision(scene.name, duration, points, own / "precision")
    formulation, optimised = optimised_scene(scene)
    return SceneReport(
        name=scene.name,
        summary=scene_summary(spec),
        symbols=_symbols(scene, simulation.units),
        scene=scene,
        manifests={scalar: package.manifest for scalar, package in packages.items()},
        equations=equations(scene, formulation, packages["float64"].module),
        patterns=_patterns(scene, optimised.program),
        mass=formulation.mass.reason,
        call=_call(packages["float64"]),
        trajectory=trajectory,
        off_decay=trajectory.off_decay(simulation.units.get(trajectory.constraint_name)),
        ending=_ending(trajectory, simulation),
        decay_error=trajectory.decay_error,
        motion=tuple(Figure(_data_uri(p), f"{scene.name}: {p.stem.replace('_', ' ')}") for p in pictures),
        bench=measured,
        speed=Figure(_data_uri(drawn), f"{scene.name}: run time against error"),
        precision=Figure(_data_uri(precision), f"{scene.name}: closed loop, run time against error"),
        single=_single(points, duration),
        folder=scene.name,
    )


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
        ("smallest singular value", f"{run.sigma_min[-1]:.3g} at the end, never below {np.min(run.sigma_min):.3g}"),
        ("largest control", f"{last} at the end, never above {largest}"),
        ("rank", f"{run.rank[-1]} at the end, never below {np.min(run.rank)}"),
    ]
    for name, v in run.outputs.items():
        last, first = (with_unit(float(x), units.get(name), 4) for x in (v[-1], v[0]))
        rows.append((name, f"{last} at the end, {first} at the start"))
    watched = ", ".join(simulation.events)
    return (*rows, ("what would have ended it", watched or "nothing but the time"))


def _single(points: Sequence[Precision], duration: float) -> str:
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


def _data_uri(path: Path) -> str:
    """A PNG in a palette of 128 colours: a third of its bytes, and no difference to see in line drawings."""
    small = io.BytesIO()
    with Image.open(path) as drawn:
        drawn.convert("RGB").quantize(128, dither=Image.Dither.NONE).save(small, "PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(small.getvalue()).decode()}"
