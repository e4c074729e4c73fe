"""servogen report: everything on one page."""

from pathlib import Path

import click

from servogen.cli.console import (
    FAILED,
    GOOD,
    INTERRUPTED,
    WRONG_INPUT,
    all_option,
    chosen,
    complain,
    emit_json,
    json_option,
    out,
    progress,
    scenes_argument,
    show_verdict,
)
from servogen.interrupt import interrupt_kept
from servogen.report.collect import Report, Wishes, collect
from servogen.report.page import write_page
from servogen.report.scene_work import BOARD
from servogen.tools import ToolMissing
from servogen.verify.harness import require_target


@click.command("report")
@scenes_argument
@all_option
@click.option(
    "--out", "folder", type=click.Path(file_okay=False, path_type=Path), default=Path("report"), show_default=True,
    help="Folder for report.html and the scenes' files.",
)  # fmt: skip
@click.option("--states", type=click.IntRange(1), default=500, show_default=True, help="States of the cross-check.")
@click.option("--rounds", type=click.IntRange(1), default=10, show_default=True, help="Rounds of the benchmark.")
@click.option("--peers", is_flag=True, help="Benchmark against whole rivals, and ours less each pass.")
@click.option(
    "--cap", type=click.FloatRange(min=0, min_open=True), metavar="SECONDS",
    help="Most seconds for each stage of a scene; default by stage, from 120 to 600. What takes longer is skipped.",
)  # fmt: skip
@click.option(
    "--any-verdict", is_flag=True,
    help="Exit code by the code and the page alone: runs may leave their domain, or end by their own stops.",
)  # fmt: skip
@json_option
def report_command(
    scenes: tuple[str, ...],
    every: bool,
    folder: Path,
    states: int,
    rounds: int,
    peers: bool,
    cap: float | None,
    any_verdict: bool,
    as_json: bool,
) -> None:
    """Generate, simulate, cross-check and benchmark SCENE...; one self-contained HTML page, and the files beside it.

    Ctrl-C ends the stage that runs; the page then shows what was done until then, and says what is missing. Exit code 0
    where the generated code is right, nothing failed, and the loop of every scene is held as it is; how many of the
    machines that differ from the model are held as well stands on the page and in --json.
    """
    names = chosen(scenes, every)
    without: tuple[tuple[str, str], ...] = ()
    try:
        require_target(BOARD)
    except ToolMissing as missing:
        without = (("board", f"the cross-check on the emulated Cortex-M4F: {missing}"),)
    page = folder / "report.html"
    with progress(as_json, logged=True) as advance, interrupt_kept() as interrupted:
        wishes = Wishes(folder, states, rounds, peers, without, cap)
        report = collect(names, wishes, advance, interrupted, lambda so_far: write_page(so_far, page))
    if as_json:
        emit_json(_summary(report, page, interrupted.is_set()))
    else:
        for text in report.skipped:
            complain("SKIPPED", text)
        for text in report.problems:
            complain("FAILED", text)
        for scene in report.scenes:
            if scene.loop is not None:
                show_verdict(scene.loop.trajectory.verdict, scene.name)
        out.print(f"wrote {page}", markup=False, soft_wrap=True)
    raise click.exceptions.Exit(exit_code(report, interrupted.is_set(), any_verdict))


def _summary(report: Report, page: Path, interrupted: bool) -> dict[str, object]:
    scenes = {
        s.name: {
            "verdict": None if s.loop is None else s.loop.trajectory.verdict,
            "robustness": None if s.robustness is None else s.robustness.runs.verdicts,
            "check": s.check,
            "board": s.board,
            "missing": s.missing,
        }
        for s in report.scenes
    }
    good = not report.problems and not interrupted
    told = {"page": page, "passed": good, "held": report.held, "problems": report.problems, "skipped": report.skipped}
    return told | {"scenes": scenes}


def exit_code(report: Report, interrupted: bool, any_verdict: bool = False) -> int:
    """Ctrl-C, a scene at fault, a check that failed or a loop that was not held, or good: the first of these that is
    so."""
    if interrupted:
        return INTERRUPTED
    if report.wrong_input:
        return WRONG_INPUT
    return FAILED if report.problems or not (any_verdict or report.held) else GOOD
