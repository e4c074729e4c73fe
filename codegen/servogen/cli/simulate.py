"""servogen simulate: a scene's generated C in closed loop with its plant, as tables, figures and CSV."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.markup import escape

from servogen.cli.console import FAILED, GOOD, emit_json, json_option, out, progress, table
from servogen.cli.generate import scalar_option
from servogen.errors import SceneError
from servogen.loading import load_simulation
from servogen.results import STATUS_MEANING, FloatArray, Status
from servogen.scalars import Scalar
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.export import write_csv
from servogen.simulate.plots import METHOD_NAMES, write_plots
from servogen.simulate.simulation import METHODS, checked, run_takes, units_of_entries
from servogen.simulate.trajectory import Trajectory, rows_that_differ, with_unit
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
    takes = run_takes(loaded)
    changed = {
        "start": _assignments(start, "--start", takes["start"]),
        "references": _assignments(references, "--reference", takes["references"]),
        "parameters": _assignments(parameters, "--parameter", takes["parameters"]),
    }
    simulation = simulation.holding(changed["references"])
    folder = out or Path("simulation") / loaded.name
    with progress(as_json) as advance:
        advance(0, 1, f"{loaded.name}: compiling")
        given: dict[str, Any] = changed | {
            "duration": duration,
            "step": step,
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
    summary = _summary(trajectory, scalar) | {
        "target": target,
        "rows_unlike_the_hosts": differing,
        "units": dict(simulation.units),
    }
    if as_json:
        emit_json(summary | {"files": files})
    else:
        _show(trajectory, summary, changed, files)
    click.get_current_context().exit(FAILED if trajectory.stop.failed or differing else GOOD)


def _assignments(given: Sequence[str], option: str, sizes: Mapping[str, int]) -> dict[str, FloatArray]:
    """NAME=1,2,3 as {NAME: array of 1, 2, 3}, for the names and sizes that the option takes."""
    values: dict[str, FloatArray] = {}
    for text in given:
        name, _, numbers = (part.strip() for part in text.partition("="))
        try:
            parsed = [float(x) for x in numbers.split(",")]
        except ValueError:
            if name in sizes:
                example = ",".join(["0.1"] * sizes[name])
                raise SceneError(f"{option} {text!r}; write NAME=NUMBERS, as in {name}={example}") from None
            parsed = []
        values |= checked({name: parsed}, sizes, option)
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
        "largest_tau": float(np.max(np.abs(trajectory.tau))) if some else None,
        "smallest_sigma_min": float(np.min(trajectory.sigma_min)) if some else None,
        "constraint_error": trajectory.constraint_error[0] if some else None,
        "constraint_error_t": trajectory.constraint_error[1] if some else None,
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


def _show(
    trajectory: Trajectory,
    summary: Mapping[str, Any],
    changed: Mapping[str, Mapping[str, FloatArray]],
    files: Sequence[Path],
) -> None:
    title = f"{trajectory.scene} ({summary['scalar']}): {trajectory.stop}"
    if summary["rows"]:
        _show_run(trajectory, summary, title)
    else:
        out.print(title, markup=False)
        _show_refusal(trajectory, changed)
    for file in files:
        out.print(f"  wrote  {file}", markup=False, soft_wrap=True)


def _show_refusal(trajectory: Trajectory, changed: Mapping[str, Mapping[str, FloatArray]]) -> None:
    """A run without a row: whose status, and what of the scene's own values was changed."""
    stop = trajectory.stop
    out.print(f"  the {stop.reason} refused its start: {STATUS_MEANING[stop.status]}", markup=False)
    for what, values in changed.items():
        if values:
            told = "; ".join(f"{n} = {_numbers(v)}" for n, v in values.items())
            out.print(f"  {what} changed: {told}", markup=False)


def _show_run(trajectory: Trajectory, summary: Mapping[str, Any], title: str) -> None:
    units = summary["units"]
    rows = [_row(n, summary["start"][n], summary["end"][n], units.get(n)) for n in summary["start"]]
    table(title, ("quantity", "start", "end"), rows)
    way = "one controller tick a step" if trajectory.hold else "controller in every stage"
    out.print(
        f"  {METHOD_NAMES[trajectory.method]}, step {trajectory.step:g} s, {way}, {summary['rows']} rows", markup=False
    )
    if summary["target"] != "host":
        differing = summary["rows_unlike_the_hosts"]
        same = "bit for bit the host's" if not differing else f"[bold red]{differing} unlike the host's[/]"
        out.print(f"  run on {summary['target']}: rows {same}")
    out.print(f"  {trajectory.off_decay(units.get(trajectory.constraint_name))}", markup=False)
    for name, error in summary["decay_error"].items():
        out.print(f"  {name} off its ideal decay by at most {error:.3g} of it", markup=False)
    largest = with_unit(summary["largest_tau"], units.get("tau"), 4)
    statuses = ", ".join(f"{n} ({c})" for n, c in summary["statuses"].items())
    out.print(
        f"  largest |tau| {largest}, smallest sigma_min {summary['smallest_sigma_min']:.4g}, statuses {statuses}",
        markup=False,
    )


def _row(name: str, start: Any, end: Any, unit: str | None) -> tuple[str, str, str]:
    """A unit stands with the name where it is one, else behind the numbers that have it: "0.1, 0.2 m, 0.3 rad"."""
    units = units_of_entries(unit, np.size(start))
    if len(set(units)) == 1:
        return escape(f"{name} [{unit}]") if unit else name, _numbers(start), _numbers(end)

    def told(values: Any) -> str:
        pairs = groupby(zip(units, np.atleast_1d(values), strict=True), key=lambda pair: pair[0])
        return ", ".join(f"{_numbers([x for _, x in group])} {one}".rstrip() for one, group in pairs)

    return name, told(start), told(end)


def _numbers(values: Any) -> str:
    return ", ".join(f"{x:.6g}" for x in np.atleast_1d(values))
