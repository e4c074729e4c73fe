"""servogen bench: run time against error, ours beside what one would otherwise use."""

import json
import re
import shlex
from pathlib import Path

import click

from servogen.bench.peers.peers import bench_peers
from servogen.bench.plot import draw
from servogen.bench.results import Bench, Built, Instructions, Measurement, Output
from servogen.bench.run import ROUNDS, bench
from servogen.bench.solver.plot import draw as draw_precision
from servogen.bench.solver.work_precision import SHAPES, Point, measure
from servogen.cli.console import (
    FAILED,
    all_option,
    chosen,
    complain,
    emit_json,
    err,
    json_option,
    out,
    progress,
    scenes_argument,
    table,
    to_jsonable,
)
from servogen.loading import load_scene
from servogen.report.solver_page import render_solver_page

HEADER = ("", "contender", "ns", "best", "99.9 %", "ratio", "max ulp", "med ulp", "max abs", "instr", "+libm",
          "NaN", "refused", "remark", "of")  # fmt: skip

SUBJECTS = (HEADER.index("max ulp"), HEADER.index("NaN"))
"""Times first; errors and instructions; the boundary states."""

BUILDS = ("contender", "operations of both", "bytes of code", "compile s")

NOTES = (
    "ns      of a call: median, best and 99.9th percentile of batches;",
    "        ratio to the baseline in the same rounds",
    "ulp     of the output's largest magnitude, in the contender's own number type;",
    "        abs in the output's unit",
    "instr   executed by the function called and what it calls,",
    "        without and with the maths library",
    "NaN     answers that are not finite and say nothing, of the boundary states",
    "        (rest, tiny, huge, quarter turns) with finite inputs;",
    "        refused: by a negative status; remark: answered, with a positive one",
)


@click.command("bench")
@scenes_argument
@all_option
@click.option(
    "--out", "folder", type=click.Path(file_okay=False, path_type=Path), default=Path("bench"), show_default=True,
    help="Folder for plots and results, in DIR/<scene>/.", metavar="DIR",
)  # fmt: skip
@click.option(
    "--rounds", type=click.IntRange(min=1), default=ROUNDS, show_default=True, help="Turns of each contender."
)
@click.option("--compiler", help="C compiler; default $CC, else cc.")
@click.option("--flags", default="-O2", show_default=True, help="Flags of the compiler, the same for all.")
@click.option(
    "--peers", is_flag=True,
    help="Whole rivals, S and z at once and tau: adam, SymPy, Pinocchio; and ours less each pass.",
)  # fmt: skip
@click.option("--solver", is_flag=True, help="The pseudo-inverse alone, at conditions 1 to 1e14, in DIR/solver/.")
@click.option("--shape", "shapes", multiple=True, metavar="MxL", help="With --solver: only this one; may be repeated.")
@json_option
def bench_command(
    scenes: tuple[str, ...],
    every: bool,
    folder: Path,
    rounds: int,
    compiler: str | None,
    flags: str,
    peers: bool,
    solver: bool,
    shapes: tuple[str, ...],
    as_json: bool,
) -> None:
    """Run time against error of SCENE's S, z and tau, for servogen and others in one run on the same states.

    Exit code 1 if code of ours hands out a NaN or an infinity without a word.
    """
    if solver and (scenes or every or peers or compiler):
        raise click.UsageError("--solver is of no scene: leave out SCENE, --all, --peers and --compiler")
    if shapes and not solver:
        raise click.UsageError("--shape belongs to --solver; add it, or leave --shape out")
    if solver:
        bench_solver(folder / "solver", shapes, rounds, as_json)
        return
    try:
        words = tuple(shlex.split(flags))
    except ValueError as error:
        raise click.BadParameter(f"{flags!r}: {error}", param_hint="--flags") from None
    results = []
    for spec in chosen(scenes, every):
        with progress(as_json) as advance:
            if peers:
                result = bench_peers(spec, words, rounds=rounds, compiler=compiler, progress=advance)
            else:
                result = bench(load_scene(spec), rounds=rounds, compiler=compiler, flags=words, progress=advance)
        results.append(result)
        paths = write(result, folder / result.scene)
        if not as_json:
            _show(result, paths)
    if as_json:
        emit_json([document(result) for result in results])
    if any(_silent(m) for result in results for m in result.measurements if m.ours):
        raise click.exceptions.Exit(FAILED)


def bench_solver(folder: Path, shapes: tuple[str, ...], rounds: int, as_json: bool) -> None:
    """The work-precision diagrams of the solver alone: solver.json, solver.html and the plots in `folder`."""
    chosen_shapes = [_shape(text) for text in shapes] or SHAPES
    with progress(as_json) as advance:
        found = measure(chosen_shapes, rounds=rounds, progress=advance)
    figures = draw_precision(found, folder)
    (folder / "solver.json").write_text(json.dumps(to_jsonable(found), indent=1) + "\n")
    (folder / "solver.html").write_text(render_solver_page(found, figures), encoding="utf-8")
    for text in found.missing:
        complain("MISSING RIVAL", text)
    if as_json:
        emit_json(found)
        return
    for shape, scalar in figures:
        for kappa in (1.0, 1e8 if scalar == "float64" else 1e4):
            table(
                f"{shape} {scalar}, kappa {kappa:g}: ns a solve, largest error",
                ("contender", "median", "99.9 %", "worst", "/ (eps kappa)", "relative"),
                [_point(p) for p in found.facet(shape, scalar, kappa)],
                right=range(1, 6),
            )
    out.print(f"wrote {folder / 'solver.html'}, solver.json and the plots", markup=False, soft_wrap=True)


def _point(p: Point) -> tuple[str, ...]:
    times = (f"{t:.0f}" for t in (p.median, p.p999, p.worst))
    return (p.contender, *times, f"{p.error:.3g}", f"{p.relative:.2g}")


def _shape(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d+)x(\d+)", text)
    if found is None or not 2 <= int(found[1]) <= int(found[2]) <= 12:
        raise click.BadParameter(f"{text!r}: give 2 to 12 rows and no fewer columns, like 3x7", param_hint="--shape")
    return int(found[1]), int(found[2])


def document(result: Bench) -> dict[str, object]:
    """results.json: the bench, and the derived figures of its measurements."""
    plain: dict[str, object] = to_jsonable(result)
    rows = []
    for m in result.measurements:
        derived = {"largest_ulps": m.errors.largest_ulps, "median_ulps": m.errors.median_ulps}
        rows.append({**to_jsonable(m), "errors": to_jsonable(m.errors) | to_jsonable(derived)})
    return plain | {"measurements": rows}


def write(result: Bench, folder: Path) -> tuple[Path, ...]:
    """results.json, bench.svg and bench.png in `folder`, made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "results.json"
    path.write_text(json.dumps(document(result), indent=2) + "\n")
    return (path, *draw(result, folder))


def _silent(m: Measurement) -> bool:
    return m.errors.nonfinite > 0 or m.boundary.nonfinite > 0


def _show(result: Bench, paths: tuple[Path, ...]) -> None:
    title = (
        f"{result.scene}: {result.compiler}, {' '.join(result.flags)}; {result.states} states, "
        f"{result.rounds} rounds; ratio to {result.baseline}"
    )
    rows = [_row(m) for output in Output for m in result.measurements if m.output is output]
    table(title, HEADER, rows, right=range(2, len(HEADER)), apart=SUBJECTS)
    table("compiled by itself", BUILDS, [_built(b) for b in result.builds], right=range(1, len(BUILDS)))
    for note in NOTES:
        out.print(f"  {note}", markup=False, soft_wrap=True)
    for path in paths:
        out.print(f"  wrote    {path}", markup=False, soft_wrap=True)
    for remark in result.remarks:
        err.print(f"[yellow]note:[/] {remark}", soft_wrap=True)


def _row(m: Measurement) -> tuple[object, ...]:
    edge = m.boundary
    return (
        m.label,
        m.contender,
        *(f"{t:.3g}" if t < 1000 else f"{t:.0f}" for t in (m.times.median, m.times.best, m.times.p999)),
        f"{m.times.ratio:.2f}" if m.times.ratio < 100 else f"{m.times.ratio:.0f}",
        f"{m.errors.largest_ulps:.2f}",
        f"{m.errors.median_ulps:.2f}",
        f"{m.errors.largest:.1e}",
        *_instructions(m.instructions),
        edge.nonfinite,
        edge.refused,
        edge.remarked,
        edge.states,
    )


def _built(b: Built) -> tuple[object, ...]:
    return b.contender, "" if b.operations is None else b.operations, f"{b.text}", f"{b.seconds:.2f}"


def _instructions(counted: Instructions | None) -> tuple[str, str]:
    return ("", "") if counted is None else (f"{counted.outside_libm:.0f}", f"{counted.total:.0f}")
