"""servogen simulate: a scene's generated C in closed loop with its plant, as tables, figures and CSV."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.markup import escape

from servogen.cli.console import FAILED, GOOD, emit_json, json_option, out, progress, show_verdict, table
from servogen.cli.generate import scalar_option
from servogen.cli.runs import runs_summary, show_runs
from servogen.errors import SceneError
from servogen.results import FloatArray, Status
from servogen.scalars import Scalar
from servogen.scene.scene import Scene
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.export import write_csv, write_runs_csv
from servogen.simulate.machine import Actuators, machine_in_words, sized_magnitudes
from servogen.simulate.mujoco_plant import MujocoLoop
from servogen.simulate.plots import METHOD_NAMES, write_plots
from servogen.simulate.robustness import write_robustness
from servogen.simulate.simulation import METHODS, Simulation, checked, run_takes, start_values, units_of_entries
from servogen.simulate.trajectory import Trajectory, rows_that_differ, with_unit
from servogen.simulate.wanted import load_simulation
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
@click.option(
    "--hold", type=float, metavar="SECONDS", help="Between two ticks of the controller, tau held, as in firmware."
)
@click.option(
    "--start", "start", multiple=True, metavar="NAME=NUMBERS", help="q, u or tau at t = 0, say u=0.1,0.1,0.1."
)
@click.option("--reference", "references", multiple=True, metavar="NAME=NUMBERS", help="A reference, or y; constant.")
@click.option("--parameter", "parameters", multiple=True, metavar="NAME=NUMBERS", help="A parameter of the model.")
@click.option(
    "--plant", multiple=True, metavar="NAME=NUMBERS", help="A parameter of the plant, unlike the controller's."
)
@click.option("--limit", metavar="NUMBERS", help="Largest magnitude of each control; one number stands for all.")
@click.option("--rate", metavar="NUMBERS", help="Largest change of each control per second.")
@click.option("--lag", metavar="NUMBERS", help="Time constant of each control's actuator, seconds.")
@click.option(
    "--noise", multiple=True, metavar="NAME=NUMBERS", help="Standard deviation of readings, q=1e-4 or u=1e-3."
)
@click.option("--quantise", multiple=True, metavar="NAME=NUMBERS", help="Steps that readings come in, q=1e-3.")
@click.option("--delay", type=float, metavar="SECONDS", help="From reading to acting.")
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), help="Of the noise; of many runs, the first one's.")
@click.option("--runs", type=click.IntRange(1), metavar="N", help="So many runs of what the spread and the seeds draw.")
@click.option(
    "--spread",
    multiple=True,
    metavar="NAME=NUMBERS",
    help="What runs draw, either way: a share of a parameter (m=0.1); of q and u at the start, in their unit (q=0.05).",
)
@click.option(
    "--mujoco",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="An MJCF or URDF file: MuJoCo's physics as the plant, with one tick of the controller a step.",
)
@click.option(
    "--replay", type=click.IntRange(0, 2**32 - 1), metavar="SEED", help="One of the runs again, with its rows."
)
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
    hold: float | None,
    start: Sequence[str],
    references: Sequence[str],
    parameters: Sequence[str],
    plant: Sequence[str],
    limit: str | None,
    rate: str | None,
    lag: str | None,
    noise: Sequence[str],
    quantise: Sequence[str],
    delay: float | None,
    seed: int | None,
    mujoco: Path | None,
    runs: int | None,
    spread: Sequence[str],
    replay: int | None,
    no_project: bool,
    out: Path | None,
    no_plots: bool,
    as_json: bool,
) -> None:
    """Run SCENE in closed loop: its controller and its plant, both generated C, by fixed steps.

    Where it starts, how long it runs, what is drawn and what stops it comes from the variable `simulation`
    (sg.Simulation) of the scene's file, and so does the machine: its plant, actuators, sensors and delay. Exit code 0
    where the constraints were held, 1 where they were not (the verdict says what happened and what to try) or a board's
    rows are not the host's.
    """
    loaded, simulation = load_simulation(scene)
    takes = run_takes(loaded)
    changed = {
        "start": _assignments(start, "--start", takes["start"]),
        "references": _assignments(references, "--reference", takes["references"]),
        "parameters": _assignments(parameters, "--parameter", takes["parameters"]),
        "plant": _assignments(plant, "--plant", takes["parameters"]),
    }
    readings = {n: takes["start"][n] for n in ("q", "u")}
    machine: dict[str, Any] = {
        "actuators": _actuators(simulation, loaded.controls, {"limit": limit, "rate": rate, "lag": lag}),
        "noise": dict(simulation.noise) | _assignments(noise, "--noise", readings),
        "quantise": dict(simulation.quantise) | _assignments(quantise, "--quantise", readings),
        "delay": delay,
        "seed": seed,
    }
    simulation = simulation.holding(changed["references"])
    on = replace(simulation, **{n: v for n, v in machine.items() if v is not None})
    drawn = dict(simulation.spread) | _assignments(spread, "--spread", takes["parameters"] | readings)
    if runs is not None and replay is not None:
        raise SceneError("--runs and --replay: leave out --runs; --replay SEED does that one of them, with its rows")
    if runs is not None and target != "host":
        raise SceneError("--runs go on this machine; leave out --target, or replay one of them there: --replay SEED")
    if spread and runs is None and replay is None:
        raise SceneError("--spread is what --runs draw; add --runs N, or --replay SEED for one of them")
    if replay is not None:
        on = replace(on, seed=replay)
    folder = out or Path("simulation") / loaded.name
    with progress(as_json) as advance:
        advance(0, 1, f"{loaded.name}: compiling")
        given: dict[str, Any] = changed | {
            "duration": duration,
            "step": step,
            "hold": hold,
            "method": method,
            "project": not no_project,
            "spread": drawn,
            **machine,
        }
        loop = _loop(loaded, simulation, scalar, mujoco, method, target)
        for line in () if as_json else _differences(loop):
            click.echo(f"MuJoCo: {line}")
        if runs is not None:
            many = loop.runs(runs, **given, progress=lambda done, n: advance(done, n, f"{loaded.name}: runs"))
            folder.mkdir(parents=True, exist_ok=True)
            files = [write_runs_csv(many, folder / f"{loaded.name}_runs.csv")]
            files += [] if no_plots else write_robustness(many, folder)
        else:
            given["replay"] = replay
            trajectory = loop.run(**given, progress=lambda done, total: advance(done, total, f"{loaded.name}: steps"))
    if runs is not None:
        if as_json:
            emit_json(runs_summary(many) | {"machine": machine_in_words(on), "files": files})
        else:
            show_runs(many, machine_in_words(on), files)
        click.get_current_context().exit(GOOD if many.held else FAILED)
    with progress(as_json) as advance:
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
        "drawn_at_the_start": [n for n in ("q", "u") if n not in changed["start"] and n not in simulation.start],
        "moved_at_the_start": {} if replay is not None else _moved(loaded, simulation, changed, trajectory),
        "target": target,
        "rows_unlike_the_hosts": differing,
        "mujoco": None if mujoco is None else {"model": str(mujoco), "differences": _differences(loop)},
        "units": dict(simulation.units),
        "machine": machine_in_words(on),
    }
    if as_json:
        emit_json(summary | {"files": files})
    else:
        _show(trajectory, summary, changed, files)
    click.get_current_context().exit(GOOD if trajectory.verdict.held and not differing else FAILED)


def _loop(
    scene: Scene, simulation: Simulation, scalar: Scalar, mujoco: Path | None, method: str | None, target: str
) -> ClosedLoop:
    """The loop of generated C, or with MuJoCo as its plant, and then what differs is told before it runs."""
    if mujoco is None:
        return ClosedLoop(scene, simulation, scalar)
    if target != "host":
        raise SceneError(f"--mujoco runs on this machine; leave out --target {target}")
    if method is not None:
        raise SceneError("--mujoco integrates as its model says (<option integrator>); leave out --method")
    return MujocoLoop(scene, simulation, mujoco, scalar)


def _differences(loop: ClosedLoop) -> tuple[str, ...]:
    return loop.differences if isinstance(loop, MujocoLoop) else ()


def _assignments(given: Sequence[str], option: str, sizes: Mapping[str, int]) -> dict[str, FloatArray]:
    """NAME=1,2,3 as {NAME: array of 1, 2, 3}, for the names and sizes that the option takes."""
    values: dict[str, FloatArray] = {}
    for text in given:
        name, _, listed = (part.strip() for part in text.partition("="))
        try:
            parsed = [float(x) for x in listed.split(",")]
        except ValueError:
            if name in sizes:
                example = ",".join(["0.1"] * sizes[name])
                raise SceneError(f"{option} {text!r}; write NAME=NUMBERS, as in {name}={example}") from None
            parsed = []
        one_for_all = option in ("--noise", "--quantise", "--spread") and len(parsed) == 1
        values |= checked({name: parsed * sizes.get(name, 1) if one_for_all else parsed}, sizes, option)
    return values


def _actuators(simulation: Simulation, controls: int, given: Mapping[str, str | None]) -> Actuators | None:
    """The simulation's actuators, and what the command says of them before it."""
    stated = {}
    for name, text in given.items():
        if text is None:
            continue
        try:
            stated[name] = sized_magnitudes([float(x) for x in text.split(",")], controls, f"--{name}")
        except ValueError as error:
            told = str(error) if isinstance(error, SceneError) else f"--{name} {text!r}; write a number, or {controls}"
            raise SceneError(told) from None
        if not np.all(stated[name] >= 0):
            raise SceneError(f"--{name} {text}: give numbers that are not negative")
    return replace(simulation.actuators or Actuators(), **stated) if stated else simulation.actuators


def _summary(trajectory: Trajectory, scalar: Scalar) -> dict[str, Any]:
    """The run in numbers."""
    statuses, counts = np.unique(trajectory.status, return_counts=True)
    some = len(trajectory.t) > 0
    return {
        "scene": trajectory.scene,
        "scalar": scalar,
        "step": trajectory.step,
        "hold": trajectory.hold,
        "plant": {n: v for n, v in trajectory.plant.items() if not np.array_equal(v, trajectory.parameters[n])},
        "rows_limited": int(np.count_nonzero(trajectory.limited)),
        "rows": len(trajectory.t),
        "verdict": trajectory.verdict,
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
        "largest_drift": float(np.max(trajectory.drift)) if trajectory.drift.size else None,
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


def _moved(
    scene: Scene, simulation: Simulation, changed: Mapping[str, Any], trajectory: Trajectory
) -> dict[str, float]:
    """By how much the start of q and u was moved onto the passive constraints; empty where it was not."""
    if not scene.mechanism.passive or not len(trajectory.t):
        return {}
    wanted = start_values(scene, simulation, changed["start"], changed["references"])
    moved = {n: float(np.max(np.abs(getattr(trajectory, n)[0] - wanted[n]))) for n in ("q", "u")}
    return {n: x for n, x in moved.items() if x > 1e-6 * (1 + np.max(np.abs(wanted[n])))}


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
        _show_changes(changed)
    show_verdict(trajectory.verdict)
    for file in files:
        out.print(f"  wrote  {file}", markup=False, soft_wrap=True)


def _show_changes(changed: Mapping[str, Mapping[str, FloatArray]]) -> None:
    """Beside a start that was refused: what of the scene's own values was changed."""
    for what, values in changed.items():
        if values:
            told = "; ".join(f"{n} = {_numbers(v)}" for n, v in values.items())
            out.print(f"  {what} changed: {told}", markup=False)


def _show_run(trajectory: Trajectory, summary: Mapping[str, Any], title: str) -> None:
    units = summary["units"]
    rows = [_row(n, summary["start"][n], summary["end"][n], units.get(n)) for n in summary["start"]]
    table(title, ("quantity", "start", "end"), rows)
    way = "controller in every stage" if trajectory.hold is None else f"controller ticks every {trajectory.hold:g} s"
    out.print(
        f"  {METHOD_NAMES[trajectory.method]}, step {trajectory.step:g} s, {way}, {summary['rows']} rows", markup=False
    )
    if summary["drawn_at_the_start"]:
        names = " and ".join(summary["drawn_at_the_start"])
        own = " ".join(f"--start {n}=..." for n in summary["drawn_at_the_start"])
        out.print(f"  {names} at the start drawn from the domain, for nothing gives it ({own})", markup=False)
    if summary["plant"]:
        told = "; ".join(
            f"{n} = {_numbers(v)}, not {_numbers(trajectory.parameters[n])}" for n, v in summary["plant"].items()
        )
        out.print(f"  in the plant {told}", markup=False)
    if summary["moved_at_the_start"]:
        moved = " and ".join(f"{n} by at most {x:.3g}" for n, x in summary["moved_at_the_start"].items())
        out.print(f"  the start was brought onto the passive constraints, which moved {moved}", markup=False)
    if summary["machine"]:
        out.print(f"  the machine: {summary['machine']}", markup=False)
    if summary["target"] != "host":
        differing = summary["rows_unlike_the_hosts"]
        same = "bit for bit the host's" if not differing else f"[bold red]{differing} unlike the host's[/]"
        out.print(f"  run on {summary['target']}: rows {same}")
    if summary["largest_drift"] is not None:
        out.print(f"  passive constraints off by at most {summary['largest_drift']:.3g}", markup=False)
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
