"""How the command speaks: tables and progress for a person, JSON for programs."""

import dataclasses
import enum
import json
import math
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import groupby, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.measure import Measurement
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from servogen.errors import SceneError
from servogen.loading import builtin_names

if TYPE_CHECKING:
    from servogen.simulate.verdict import Verdict

out = Console(highlight=False, width=None if sys.stdout.isatty() else 140)
err = Console(stderr=True, highlight=False)

GOOD, FAILED, WRONG_INPUT, INTERNAL, INTERRUPTED, UNREAD = 0, 1, 2, 3, 130, 141

scenes_argument = click.argument("scenes", nargs=-1, metavar="SCENE...")
all_option = click.option("--all", "every", is_flag=True, help="All built-in scenes.")
json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object instead of tables.")

Advance = Callable[[int, int, str], None]


@contextmanager
def progress(quiet: bool, logged: bool = False) -> Iterator[Advance]:
    """A bar on stderr: call the result with (done, total, what). Nothing where quiet; off a terminal a line a call if
    logged, else nothing."""
    if quiet or not err.is_terminal:
        lines = logged and not quiet
        yield lambda done, total, text: complain(f"{done + 1} of {total}", text, "bold") if lines else None
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=err, transient=True) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, total, text: bar.update(task, completed=done, total=total, description=text)


def table(
    title: str,
    header: Sequence[str],
    rows: Sequence[Sequence[object]],
    right: Sequence[int] = (),
    apart: Sequence[int] = (),
) -> None:
    """Print a table; `right` are the columns of numbers, at `apart` begin those of another subject.

    Where it is too wide, each subject gets a table, with the columns of words again; where that is too wide, as few of
    the first columns as will do become headings of smaller tables: no word is split.
    """
    cells = [[str(cell) for cell in row] for row in rows]

    def grid(depth: int, rows: Sequence[Sequence[str]], title: str) -> Table:
        shown = Table(title=title, title_justify="left")
        for k, name in enumerate(header[depth:], start=depth):
            prose = any(" " in row[k] for row in rows)
            shown.add_column(name, justify="right" if k in right else "left", overflow="fold", no_wrap=not prose)
        for row in rows:
            shown.add_row(*row[depth:])
        return shown

    def fits(depth: int) -> bool:
        return Measurement.get(out, unbounded, grid(depth, cells, "")).minimum <= out.width

    unbounded = out.options.update(max_width=10_000)
    if apart and not fits(0):
        words = min(right)
        for k, (start, stop) in enumerate(pairwise([words, *apart, len(header)])):
            columns = [*range(words), *range(start, stop)]
            chosen_rows = [[row[c] for c in columns] for row in cells]
            table("" if k else title, [header[c] for c in columns], chosen_rows, range(words, len(columns)))
        return
    depth = next(filter(fits, range(min(right, default=1))), 0)
    if depth == 0:
        out.print(grid(0, cells, title))
        return
    if title:
        out.print(title, style="table.title", markup=False)
    for heading, group in groupby(cells, key=lambda row: row[:depth]):
        out.print(grid(depth, list(group), ", ".join(heading)))


def emit_json(value: Any) -> None:
    """One JSON document on stdout; numbers that are not finite become strings."""
    print(json.dumps(to_jsonable(value), indent=2))


def to_jsonable(value: Any) -> Any:
    """Dataclasses, enums, paths and arrays as plain JSON values."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: to_jsonable(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, dict):
        return {str(k): to_jsonable(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return to_jsonable(value.tolist())
    if isinstance(value, list | tuple):
        return [to_jsonable(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else str(float(value))
    if isinstance(value, np.integer):
        return int(value)
    return str(value) if isinstance(value, Path) else value


def complain(kind: str, text: str, style: str = "bold red") -> None:
    """One line on stderr: what kind of remark it is, then its words as they are."""
    err.print(f"[{style}]{kind}:[/] {escape(text)}", soft_wrap=True)


def show_verdict(verdict: "Verdict", scene: str = "") -> None:
    """The word, what happened and what to try."""
    style = "bold green" if verdict.held else "bold red"
    named = f"{scene}: " if scene else ""
    out.print(f"  {escape(named)}[{style}]{escape(verdict.word)}[/]: {escape(verdict.reason)}")
    if verdict.advice:
        out.print(f"  {verdict.advice}", markup=False)


def show_warnings() -> None:
    """Warnings in one line each, without the source of servogen; what several stages find is said once."""
    said: set[str] = set()

    def show(message: Warning | str, *rest: object, **more: object) -> None:
        if str(message) not in said:
            said.add(str(message))
            complain("warning", str(message), "bold yellow")

    warnings.showwarning = show


def chosen(scenes: tuple[str, ...], every: bool) -> tuple[str, ...]:
    """The scenes named, and with --all the built-in ones; SceneError where there are none."""
    names = (*scenes, *(n for n in builtin_names() if n not in scenes)) if every else scenes
    if not names:
        raise SceneError(f"name a scene ({', '.join(builtin_names())}, or a file), or say --all")
    return names
