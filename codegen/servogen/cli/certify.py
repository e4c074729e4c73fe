"""servogen certify: what a scene's C costs on boards, proven and seen, held to its budget."""

import json
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
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
    table,
    to_jsonable,
)
from servogen.errors import SceneError
from servogen.loading import load_scene, scene_folder
from servogen.report.board_page import render_board_page
from servogen.verify import budget
from servogen.verify.board_certificate import BoardCertificate, certify
from servogen.verify.harness import require_target, targets

BOARDS = tuple(name for name in targets() if name != "host")


@click.command("certify")
@scenes_argument
@all_option
@click.option(
    "--target", "boards", type=click.Choice([*BOARDS, "all"]), multiple=True, help="A board; default cortex-m4."
)
@click.option(
    "--budget",
    "file",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The budgets; default budget.toml beside each scene.",
)
@click.option("--accept", is_flag=True, help="Write the measured figures into the budget.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Processes, a scene each.")
@click.option(
    "--out", "folder", type=click.Path(file_okay=False, path_type=Path), help="Folder for certificates.json and .html."
)
@json_option
def certify_command(
    scenes: tuple[str, ...],
    every: bool,
    boards: tuple[str, ...],
    file: Path | None,
    accept: bool,
    jobs: int,
    folder: Path | None,
    as_json: bool,
) -> None:
    """Certify the generated C of SCENE... on emulated boards, in both scalars: instructions of each function (not
    cycles), worst seen and proven, flash, stack, symbols, errors; and hold them to budget.toml, with 3 % of slack.
    A line names what has no entry there."""
    names = chosen(scenes, every)
    if file is not None and not accept and not file.is_file():
        raise SceneError(f"no budget {file}: name one that exists, or write it with --accept")
    where = BOARDS if "all" in boards else boards or ("cortex-m4",)
    for board in where:
        require_target(board)
    found: list[BoardCertificate] = []
    over: list[str] = []
    unheld: list[str] = []
    with progress(as_json) as advance, ProcessPoolExecutor(jobs) as pool:
        work = map(_certified, names, repeat(where)) if jobs == 1 else pool.map(_certified, names, repeat(where))
        for done, (name, certificates) in enumerate(zip(names, work, strict=True), start=1):
            advance(done, len(names), name)
            found += certificates
            path = file or scene_folder(name) / budget.FILE
            if accept:
                budget.accept(path, certificates)
            budgets = budget.read(path)
            over += [text for c in certificates for text in budget.exceeded(c, budgets)]
            free = [c for c in certificates if not budget.limits_of(c, budgets)]
            unheld += [f"{budget.name_of(c)} is not in {path}" for c in free]
    problems = [f"{c.prefix} on {c.target}: {text}" for c in found for text in c.problems] + over
    result = {"passed": not problems, "problems": problems, "no_budget": unheld, "certificates": found}
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "certificates.json").write_text(json.dumps(to_jsonable(result), indent=2) + "\n")
        (folder / "certificates.html").write_text(render_board_page(found, problems))
    if as_json:
        emit_json(result)
    else:
        show(found, problems, unheld)
    raise click.exceptions.Exit(FAILED if problems else GOOD)


def _certified(name: str, boards: tuple[str, ...]) -> list[BoardCertificate]:
    return certify(load_scene(name), boards)


def show(found: list[BoardCertificate], problems: list[str], unheld: list[str]) -> None:
    """The certificates as tables."""
    table(
        "Memory, in bytes: the package's code and constants, the compiler's arithmetic it calls, variables, stack",
        ("scene", "scalar", "board", "flash", "library", "RAM", "stack"),
        [(c.scene, c.scalar, c.target, c.flash, c.library, c.ram, c.stack) for c in found],
        right=(3, 4, 5, 6),
    )
    rows = [
        (c.scene, c.scalar, c.target, e.name, e.instructions, e.instructions_mean, e.bound, e.stack_seen, e.stack,
         f"{e.ulps:.3g}")
        for c in found
        for e in c.entries
    ]  # fmt: skip
    table(
        "Instructions of one call (not cycles) and stack in bytes: seen over the states, and proven to be the most",
        ("scene", "scalar", "board", "function", "worst", "mean", "proven", "stack", "proven", "ulps"),
        rows,
        right=(4, 5, 6, 7, 8, 9),
    )
    for text in problems:
        complain("FAILED", text)
    for text in unheld:
        complain("no budget held", f"{text}; --accept writes it")
    out.print("[bold red]not certified[/]" if problems else "[bold green]certified[/]")
