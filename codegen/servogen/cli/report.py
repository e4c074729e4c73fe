"""servogen report: everything on one page."""

from pathlib import Path

import click

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
)
from servogen.report.collect import collect
from servogen.report.page import render_page
from servogen.tools import ToolMissing
from servogen.verify.harness import require_target

BOARD = "cortex-m4"


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
@json_option
def report_command(
    scenes: tuple[str, ...], every: bool, folder: Path, states: int, rounds: int, peers: bool, as_json: bool
) -> None:
    """Generate, cross-check, simulate and benchmark SCENE...; one self-contained HTML page, and the files beside it."""
    names = chosen(scenes, every)
    board: str | None = BOARD
    skipped = []
    try:
        require_target(BOARD)
    except ToolMissing as missing:
        board = None
        skipped.append(f"the cross-check on the emulated Cortex-M4F: {missing}")
    with progress(as_json, logged=True) as advance:
        report = collect(names, folder, board, states, rounds, skipped, advance, peers)
    page = folder / "report.html"
    page.write_text(render_page(report), encoding="utf-8")
    passed = report.check.passed and (report.board is None or report.board.passed)
    if as_json:
        emit_json({"page": page, "passed": passed, "check": report.check, "board": report.board})
    else:
        for text in report.skipped:
            complain("SKIPPED", text)
        for text in (*report.check.problems, *(report.board.problems if report.board else ())):
            complain("FAILED", text)
        out.print(f"wrote {page}", markup=False, soft_wrap=True)
    raise click.exceptions.Exit(GOOD if passed else FAILED)
