"""servogen simulate: a scene's generated C in closed loop with its plant, as tables, figures and CSV."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click
import numpy as np

from servogen.cli.console import FAILED, GOOD, emit_json, json_option, out, progress, table
from servogen.cli.generate import scalar_option
from servogen.errors import SceneError
from servogen.loading import load_simulation
from servogen.results import Status
from servogen.scalars import Scalar
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.export import write_csv
from servogen.simulate.plots import METHOD_NAMES, write_plots
from servogen.simulate.simulation import METHODS
from servogen.simulate.trajectory import Trajectory, rows_that_differ
from servogen.verify.harness import targets


@click.command("simulate")
@click.argument("scene")
@scalar_option
@click.option("--duration", type=float, help="Seconds; default as in the scene's file, else 10.")
@click.option("--step", type=float, help="Seconds between rows; default as in the scene's file, else 0.001.")
@click.option("--method", type=click.Choice(METHODS), help="Of the integration; default as in the scene's file.")
@click.option(
    "--target",
    type=click.Choice(targets()),
    default="host",
    show_default=True,
    help="Where the loop runs; on a board the rows are also held to the host's, bit for bit.",
)
@click.option("--hold", is_flag=True, help="One tick of the controller a step, tau held in between, as in firmware.")
@click.option(
    "--start", "start", multiple=True, metavar="NAME=NUMBERS", help="q, u or tau at t = 0, say u=0.1,0.1,0.1."
)
@click.option("--reference", "references", multiple=True, metavar="NAME=NUMBERS", help="A reference, or y; constant.")
@click.option("--parameter", "parameters", multiple=True, metavar="NAME=NUMBERS", help="A parameter of the model.")
@click.option("--no-project", is_flag=True, help="Start from tau as given, even if phi is not zero there.")
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), help="Folder; default ./simulation/<scene's name>/."
)
@click.option("--no-plots", is_flag=True, help="Only the CSV.")
@json_option
def simulate_command(
    scene: str,
    scalar: Scalar,
    duration: float | None,
    step: float | None,
    method: str | None,
    target: str,
    hold: bool,
    start: Sequence[str],
    references: Sequence[str],
    parameters: Sequence[str],
    no_project: bool,
    out: Path | None,
    no_plots: bool,
    as_json: bool,
) -> None:
    """Run SCENE in closed loop: its controller and its plant, both generated C, by fixed steps.

    Where it starts, how long it runs, what is drawn and what stops it comes from the variable `simulation`
    (sg.Simulation) of the scene's file. Exit code 1 where a negative status ended the run, or where a board's rows are
    not the host's.
    """
    loaded, simulation = load_simulation(scene)
    folder = out or Path("simulation") / loaded.name
    with progress(as_json) as advance:
        advance(0, 1, f"{loaded.name}: compiling")
        given: dict[str, Any] = {
            "start": _assignments(start, "--start"),
            "duration": duration,
            "step": step,
            "references": _assignments(references, "--reference"),
            "parameters": _assignments(parameters, "--parameter"),
            "hold": hold,
            "method": method,
            "project": not no_project,
        }
        trajectory = ClosedLoop(loaded, simulation, scalar).run(
            **given, progress=lambda done, total: advance(done, total, f"{loaded.name}: steps")
        )
        differing = 0
        if target != "host":
            advance(0, 1, f"{loaded.name}: the same on {target}")
            here, trajectory = trajectory, ClosedLoop(loaded, simulation, scalar, target=target).run(**given)
            differing = rows_that_differ(here, trajectory)
        advance(0, 1, f"{loaded.name}: writing")
        folder.mkdir(parents=True, exist_ok=True)
        files = [write_csv(trajectory, folder / f"{loaded.name}.csv")]
        if not no_plots and len(trajectory.t):
            files += write_plots(loaded, simulation, trajectory, folder)
    summary = _summary(trajectory, scalar) | {"target": target, "rows_unlike_the_hosts": differing}
    if as_json:
        emit_json(summary | {"files": files})
    else:
        _show(trajectory, summary, files)
    click.get_current_context().exit(FAILED if trajectory.stop.failed or differing else GOOD)


def _assignments(given: Sequence[str], option: str) -> dict[str, list[float]]:
    """NAME=1,2,3 as {NAME: [1.0, 2.0, 3.0]}."""
    values: dict[str, list[float]] = {}
    for text in given:
        name, equals, numbers = text.partition("=")
        try:
            values[name.strip()] = [float(x) for x in numbers.split(",")]
        except ValueError:
            equals = ""
        if not equals:
            raise SceneError(f"{option} {text!r}; write NAME=NUMBERS, as in u=0.1,0.1,0.1")
    return values


def _summary(trajectory: Trajectory, scalar: Scalar) -> dict[str, Any]:
    """The run in numbers."""
    statuses, counts = np.unique(trajectory.status, return_counts=True)
    some = len(trajectory.t) > 0
    return {
        "scene": trajectory.scene,
        "scalar": scalar,
        "step": trajectory.step,
        "hold": trajectory.hold,
        "rows": len(trajectory.t),
        "stop": {
            "reason": trajectory.stop.reason,
            "t": trajectory.stop.t,
            "event": trajectory.stop.event,
            "status": trajectory.stop.status,
        },
        "start": _ends(trajectory, 0) if some else {},
        "end": _ends(trajectory, -1) if some else {},
        "largest_tau": float(np.max(np.abs(trajectory.tau))) if some else 0.0,
        "smallest_sigma_min": float(np.min(trajectory.sigma_min)) if some else 0.0,
        "constraint_error": float(np.max(np.abs(trajectory.constraint - trajectory.ideal))) if some else 0.0,
        "decay_error": trajectory.decay_error,
        "statuses": {Status(int(s)).name: int(n) for s, n in zip(statuses, counts, strict=True)},
    }


def _ends(trajectory: Trajectory, row: int) -> dict[str, Any]:
    vectors = {
        "q": trajectory.q,
        "u": trajectory.u,
        "tau": trajectory.tau,
        trajectory.constraint_name: trajectory.constraint,
    }
    return {n: v[row] for n, v in vectors.items()} | {n: float(v[row]) for n, v in trajectory.outputs.items()}


def _show(trajectory: Trajectory, summary: Mapping[str, Any], files: Sequence[Path]) -> None:
    names = list(summary["start"])
    rows = [(n, _numbers(summary["start"][n]), _numbers(summary["end"][n])) for n in names]
    table(f"{trajectory.scene} ({summary['scalar']}): {trajectory.stop}", ("quantity", "start", "end"), rows)
    way = "one controller tick a step" if trajectory.hold else "controller in every stage"
    out.print(
        f"  {METHOD_NAMES[trajectory.method]}, step {trajectory.step:g} s, {way}, {summary['rows']} rows", markup=False
    )
    if summary["target"] != "host":
        differing = summary["rows_unlike_the_hosts"]
        same = "bit for bit the host's" if not differing else f"[bold red]{differing} unlike the host's[/]"
        out.print(f"  run on {summary['target']}: rows {same}")
    psi = trajectory.constraint_name
    out.print(f"  {psi} off its prescribed decay by at most {summary['constraint_error']:.3g}", markup=False)
    for name, error in summary["decay_error"].items():
        out.print(f"  {name} off its ideal decay by at most {error:.3g} of it", markup=False)
    out.print(
        f"  largest |tau| {summary['largest_tau']:.4g}, smallest sigma_min {summary['smallest_sigma_min']:.4g}, "
        f"statuses {', '.join(f'{n} ({c})' for n, c in summary['statuses'].items()) or 'none'}",
        markup=False,
    )
    for file in files:
        out.print(f"  wrote  {file}", markup=False, soft_wrap=True)


def _numbers(values: Any) -> str:
    return ", ".join(f"{x:.6g}" for x in np.atleast_1d(values))
