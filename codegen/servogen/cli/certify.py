"""servogen certify: what a scene's C costs on a board, held to its budget."""

from pathlib import Path

import click

from servogen.cli.console import (
    FAILED,
    GOOD,
    all_option,
    chosen,
    emit_json,
    err,
    json_option,
    out,
    progress,
    scenes_argument,
    table,
)
from servogen.loading import load_scene, scene_folder
from servogen.verify import budget
from servogen.verify.certificate import Certificate, certify
from servogen.verify.harness import targets

BOARDS = [name for name in targets() if name != "host"]


@click.command("certify")
@scenes_argument
@all_option
@click.option("--target", "boards", type=click.Choice(BOARDS), multiple=True, help="A board; default cortex-m4.")
@click.option(
    "--budget",
    "file",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The budgets; default budget.toml beside each scene.",
)
@click.option("--accept", is_flag=True, help="Write the measured figures into the budget.")
@json_option
def certify_command(
    scenes: tuple[str, ...], every: bool, boards: tuple[str, ...], file: Path | None, accept: bool, as_json: bool
) -> None:
    """Measure the generated C of SCENE... on emulated boards, in both scalars: instructions of each function (not
    cycles), flash, stack, symbols, errors; and hold them to budget.toml, with 3 % of slack."""
    names = chosen(scenes, every)
    work = [(name, board) for name in names for board in boards or ("cortex-m4",)]
    found: list[Certificate] = []
    over: list[str] = []
    with progress(as_json) as advance:
        for done, (name, board) in enumerate(work):
            advance(done, len(work), f"{name} on {board}")
            certificates = certify(load_scene(name), board)
            found += certificates
            path = file or scene_folder(name) / budget.FILE
            if accept:
                budget.accept(path, certificates)
            over += [text for c in certificates for text in budget.exceeded(c, budget.read(path))]
    problems = [f"{c.prefix} on {c.target}: {text}" for c in found for text in c.problems] + over
    if as_json:
        emit_json({"passed": not problems, "problems": problems, "certificates": found})
    else:
        show(found, problems)
    raise click.exceptions.Exit(FAILED if problems else GOOD)


def show(found: list[Certificate], problems: list[str]) -> None:
    """The certificates as tables."""
    table(
        "Memory, in bytes: the package's code and constants, the compiler's arithmetic it calls, variables, stack",
        ("scene", "scalar", "board", "flash", "library", "RAM", "stack"),
        [(c.scene, c.scalar, c.target, c.flash, c.library, c.ram, c.stack) for c in found],
        right=(3, 4, 5, 6),
    )
    rows = [
        (c.scene, c.scalar, c.target, e.name, e.instructions, e.instructions_mean, e.stack, f"{e.ulps:.3g}")
        for c in found
        for e in c.entries
    ]
    table(
        "Instructions of one call, the worst and the mean over the states; they are not cycles",
        ("scene", "scalar", "board", "function", "worst", "mean", "stack", "ulps"),
        rows,
        right=(4, 5, 6, 7),
    )
    for text in problems:
        err.print(f"[bold red]FAILED:[/] {text}", soft_wrap=True)
    out.print("[bold red]not certified[/]" if problems else "[bold green]certified[/]")
