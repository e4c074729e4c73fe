"""Everything the page shows, computed: generation, cross-check, closed loop, run time against error."""

import base64
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from servogen.bench.peers.peers import bench_peers
from servogen.bench.plot import draw
from servogen.bench.results import Bench
from servogen.bench.run import bench
from servogen.compiler import build, optimised_scene
from servogen.package import Package
from servogen.report.paper import SCENES as PAPER
from servogen.report.paper import draw_paper
from servogen.scene.constraints import expression_of, theta_parts
from servogen.scene.loading import builtin_names, builtin_summary, load_simulation
from servogen.scene.scene import Scene
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.export import write_csv
from servogen.simulate.plots import write_plots
from servogen.simulate.precision import draw_precision, measure
from servogen.simulate.simulation import Simulation
from servogen.simulate.trajectory import Trajectory
from servogen.verify.check import CheckReport, check

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, eq=False)
class Figure:
    """A picture as the page holds it: a data URI and a caption."""

    uri: str
    caption: str


@dataclass(frozen=True, eq=False)
class SceneReport:
    """One scene: what was generated, and its figures. `folder` holds the files, relative to the page."""

    name: str
    summary: str
    scene: Scene
    manifests: dict[str, dict[str, Any]]  # by scalar
    quantities: tuple[tuple[str, str, str, str], ...]  # name, shape, equation, formula
    constraints: tuple[tuple[str, str, str], ...]  # name, kind, the expression and its Theta as written
    patterns: tuple[tuple[str, list[list[bool]]], ...]  # name of a matrix, and where it is not identically zero
    mass: str
    call: str
    trajectory: Trajectory
    decay_error: dict[str, float]
    motion: tuple[Figure, ...]
    bench: Bench | None
    speed: Figure | None
    precision: Figure
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
    write_csv(trajectory, own / "trajectory.csv")
    pictures = [p for p in write_plots(scene, simulation, trajectory, own) if p.suffix == ".png"]
    say(f"{scene.name}: run time against error")
    measured = None
    if scene.kind != "ideal":
        measured = bench_peers(spec, rounds=rounds) if peers else bench(scene, rounds=rounds)
    drawn = next(p for p in draw(measured, own) if p.suffix == ".svg") if measured else None
    say(f"{scene.name}: step size, method and scalar against error")
    duration = min(2.0, 0.5 * trajectory.stop.t)
    steps = [duration / n for n in (20, 40, 80, 160, 320, 640, 1280)]
    precision = draw_precision(scene.name, duration, measure(scene, simulation, duration, steps), own / "precision")
    formulation, _ = optimised_scene(scene)
    return SceneReport(
        name=scene.name,
        summary=builtin_summary(spec) if spec in builtin_names() else f"From {Path(spec).name}.",
        scene=scene,
        manifests={scalar: package.manifest for scalar, package in packages.items()},
        quantities=tuple(
            (q.name, f"{q.expression.size1()}×{q.expression.size2()}", q.equation, q.formula)
            for q in formulation.quantities
        ),
        constraints=tuple(_constraint(c) for c in scene.constraints),
        patterns=(_pattern("Q", scene.mechanism.Q), _pattern(formulation.reach, formulation[formulation.reach])),
        mass=formulation.mass.reason,
        call=_call(packages["float64"]),
        trajectory=trajectory,
        decay_error={n: _relative(trajectory.outputs[n], ideal) for n, ideal in trajectory.decay.items()},
        motion=tuple(Figure(_data_uri(p), f"{scene.name}: {p.stem.replace('_', ' ')}") for p in pictures),
        bench=measured,
        speed=Figure(_data_uri(drawn), f"{scene.name}: run time against error") if drawn else None,
        precision=Figure(_data_uri(precision), f"{scene.name}: closed loop, run time against error"),
        folder=scene.name,
    )


def _constraint(constraint: Any) -> tuple[str, str, str]:
    """A constraint in CasADi's words, cut where it is long."""
    texts = {"psi" if hasattr(constraint, "psi") else "phi": expression_of(constraint), **theta_parts(constraint)}
    words = "; ".join(f"{name} = {_short(str(sx))}" for name, sx in texts.items())
    return constraint.name, type(constraint).__name__, words


def _short(text: str, length: int = 400) -> str:
    return text if len(text) <= length else f"{text[:length]} ..."


def _pattern(name: str, matrix: Any) -> tuple[str, list[list[bool]]]:
    rows, columns = matrix.shape
    return name, [[not matrix[i, j].is_zero() for j in range(columns)] for i in range(rows)]


def _relative(values: Any, ideal: Any) -> float:
    """Largest relative deviation from the ideal decay."""
    scale = np.maximum(np.abs(ideal), np.finfo(float).tiny)
    return float(np.max(np.abs(values - ideal) / scale))


def _call(package: Package) -> str:
    """The statements of the control function's own code, as generated."""
    text = (package.path / f"{package.prefix}.c").read_text()
    kernel = package.module.control.kernel.name if package.module.control else ""
    found = re.search(rf"^static void {package.prefix}_eval_{kernel}\(.*?^}}", text, re.MULTILINE | re.DOTALL)
    return found.group(0) if found else ""


def _data_uri(path: Path) -> str:
    kind = {".png": "image/png", ".svg": "image/svg+xml"}[path.suffix]
    return f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode()}"
