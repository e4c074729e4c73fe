"""servogen check: the cross-check."""

import dataclasses
from collections.abc import Mapping, Sequence

import click

from servogen.analysis.analyse import BRIEF, Analysis, analyse
from servogen.cli.console import (
    FAILED,
    GOOD,
    all_option,
    chosen,
    complain,
    emit_json,
    json_option,
    out,
    progress,
    scenes_argument,
    table,
)
from servogen.cli.generate import CORE
from servogen.loading import load_scene
from servogen.verify.answers import BAR
from servogen.verify.campaign import VECTORS
from servogen.verify.check import STATES, CheckReport, OutputCheck, check
from servogen.verify.harness import targets


@click.command("check")
@scenes_argument
@all_option
@click.option("--target", type=click.Choice(targets()), default="host", show_default=True, help="Where the C runs.")
@click.option(
    "--states", type=click.IntRange(1), help=f"States drawn a scene; default {STATES}, fewer on small boards."
)
@click.option(
    "--vectors",
    type=click.IntRange(100),
    default=VECTORS,
    show_default=True,
    help="States made on the board itself, answered by board and host bit for bit.",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Of the states drawn.")
@click.option("--core", is_flag=True, help="Check the C as generate --core makes it: all packages share one core.")
@json_option
def check_command(
    scenes: tuple[str, ...],
    every: bool,
    target: str,
    states: int | None,
    vectors: int,
    seed: int,
    core: bool,
    as_json: bool,
) -> None:
    """Cross-check the generated C of SCENE... in float64 and float32 against reference and truth.

    On the host gcc and clang build it; on a board it runs in the emulator and is also compared with the host.
    """
    found = [load_scene(n) for n in chosen(scenes, every)]
    with progress(as_json) as advance:
        report = check(found, target, states, seed, advance, vectors, CORE if core else None)
    inside = {scene.name: analyse(scene, BRIEF) for scene in found}
    if as_json:
        told = {name: {"verdict": a.verdict, "meaning": a.meaning} for name, a in inside.items()}
        emit_json({"passed": report.passed, "report": report, "internal_dynamics": told})
    else:
        show(report)
        show_inside(inside)
    raise click.exceptions.Exit(GOOD if report.passed else FAILED)


def show_inside(inside: Mapping[str, Analysis]) -> None:
    """What the constraints leave to itself: no matter of the code's correctness, but of what it is asked to do."""
    for name, a in inside.items():
        if a.verdict == "unstable" or a.extension is None:
            complain("INSIDE", f"{name}: {a.meaning}", "bold yellow")
        else:
            out.print(f"inside {name}: {a.verdict}; {a.meaning}", markup=False, soft_wrap=True)


def show(report: CheckReport) -> None:
    """The report as tables."""
    rows = [_row(same) for same in _alike(report.outputs)]
    table(
        f"Against the 50-digit truth: {report.states} states of the domain and {len(report.boundary)} boundary states",
        ("scene", "scalar", "built by", "function", "output", "values", "ulps", "reference", "of bound", ""),
        rows,
        right=(5, 6, 7, 8),
    )
    out.print(
        "  ulps: largest error over the domain in units in the last place of the output's largest magnitude\n"
        "  reference: the same of the textbook formulas in numpy, float64 rounded to the scalar at the end\n"
        "  built by: two names where all bits agree\n"
        "  of bound: largest error, boundary states included, over the rounding bound of the operations; 1 fails\n",
        markup=False,
    )
    table(
        f"tau against the exact solution of the code's own system, in eps kappa (|tau| + |y|); the bar is {BAR:g}",
        ("scene", "scalar", "built by", "systems", "error", ""),
        [
            (s.scene, s.scalar, s.compiler, s.solved, f"{s.max_error:.3g}", "ok" if s.passed else "FAILED")
            for s in report.solves
        ],
        right=(3, 4),
    )
    if report.differences:
        table(
            "Host against board, value by value",
            ("scene", "scalar", "function", "output", "values", "not bit-equal", "largest, ulps", "statuses differ"),
            [
                (d.scene, d.scalar, d.entry, d.output, d.compared, d.different, f"{d.max_ulps:.3g}", d.statuses_differ)
                for d in report.differences
            ],
            right=(4, 5, 6, 7),
        )
    if report.campaigns:
        table(
            "Host against board, at states made on the target: one hash of all statuses, answers and infos",
            ("scene", "scalar", "states", "hash", "statuses of the last function", ""),
            [
                (c.scene, c.scalar, c.vectors, c.hash.split("-")[-1], _counted(c.statuses), c.problem or "ok")
                for c in report.campaigns
            ],
            right=(2,),
        )
    for text in report.skipped:
        complain("SKIPPED", text)
    for text in report.problems:
        complain("FAILED", text)
    out.print("[bold green]check passed[/]" if report.passed else "[bold red]check failed[/]")


def _counted(statuses: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in statuses.items())


def _alike(outputs: Sequence[OutputCheck]) -> list[list[OutputCheck]]:
    """Outputs whose figures and bits agree between targets, together: one row each."""
    groups: dict[OutputCheck, list[OutputCheck]] = {}
    for o in outputs:
        groups.setdefault(dataclasses.replace(o, target=""), []).append(o)
    return list(groups.values())


def _row(same: list[OutputCheck]) -> tuple[object, ...]:
    o = same[0]
    reference = "" if o.reference_ulps is None else f"{o.reference_ulps:.3g}"
    targets = ", ".join(x.target for x in same)
    figures = (o.compared, f"{o.max_ulps:.3g}", reference, f"{o.max_ratio:.3g}")
    return (o.scene, o.scalar, targets, o.entry, o.output, *figures, o.problem or "ok")
