"""servogen stress: the solver on random and singular matrices against exact rationals."""

import json
from pathlib import Path

import click

from servogen.cli.console import FAILED, GOOD, emit_json, err, json_option, out, progress, table, to_jsonable
from servogen.report.stress import render_stress
from servogen.verify.stress import FAMILIES, StressReport, stress

CAMPAIGN_SYSTEMS = 100_000
CAMPAIGN_FUZZING = 1800


@click.command("stress")
@click.option("--systems", type=click.IntRange(1), help="Of each family in each scalar; default 1000.")
@click.option(
    "--campaign", is_flag=True,
    help=f"The long run: {CAMPAIGN_SYSTEMS:,} systems, certificates by the million, every shape, and "
    f"{CAMPAIGN_FUZZING} s of fuzzing; some two hours of one core.",
)  # fmt: skip
@click.option("--family", "families", multiple=True, metavar="NAME", help="Only this one; may be repeated.")
@click.option("--fuzz", "fuzzing", type=click.FloatRange(0), metavar="SECONDS", help="Also fuzz the solver, so long.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Of all matrices.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Processes.")
@click.option(
    "--out", "folder", type=click.Path(file_okay=False, path_type=Path), default=Path("stress"), show_default=True,
    help="Folder for stress.json, stress.html and the journal, from which an interrupted run goes on.",
)  # fmt: skip
@json_option
def stress_command(
    systems: int | None,
    campaign: bool,
    families: tuple[str, ...],
    fuzzing: float | None,
    seed: int,
    jobs: int,
    folder: Path,
    as_json: bool,
) -> None:
    """Stress the generated solver: families of full-rank, graded, singular and extreme matrices.

    Ctrl-C loses nothing that was finished: the same command goes on from there.
    """
    unknown = [name for name in families if name not in FAMILIES]
    if unknown:
        raise click.BadParameter(f"no family {unknown[0]!r}; choose from: {'; '.join(FAMILIES)}", param_hint="--family")
    count = systems or (CAMPAIGN_SYSTEMS if campaign else 1000)
    seconds = fuzzing if fuzzing is not None else CAMPAIGN_FUZZING if campaign and not families else 0.0
    journal = folder / "journal.jsonl"
    err.print(f"seed {seed}, {count:,} systems of each family; journal {journal}", soft_wrap=True)
    with progress(as_json) as advance:
        report = stress(
            seed=seed,
            systems=count,
            families=families or None,
            long=campaign,
            fuzzing=seconds,
            jobs=jobs,
            journal=journal,
            progress=advance,
        )
    (folder / "stress.json").write_text(json.dumps(to_jsonable(report.to_json()), indent=2) + "\n")
    (folder / "stress.html").write_text(render_stress(report), encoding="utf-8")
    if as_json:
        emit_json(report.to_json())
    else:
        show_stress(report)
        out.print(f"wrote {folder / 'stress.html'} and stress.json", markup=False, soft_wrap=True)
    raise click.exceptions.Exit(GOOD if report.passed else FAILED)


def show_stress(report: StressReport) -> None:
    """The report as a table."""
    table(
        f"Solver against exact rationals, {report.systems:,} systems of each family and scalar; seed {report.seed}",
        ("family", "scalar", "quantity", "systems", "largest", "bar", "at", ""),
        [
            (
                r.family,
                r.scalar,
                r.quantity,
                f"{r.systems:,}",
                f"{r.largest:.3g}",
                f"{r.bar:g}",
                r.shape,
                "ok" if r.passed else "[bold red]FAILED[/]",
            )
            for r in report.rows
        ],
        right=(3, 4, 5),
    )
    for one in report.fuzzed:
        if not one.passed:
            where = f"{one.m}x{one.l} {one.scalar} {one.policy}"
            err.print(f"fuzzing {where}: input {one.input}\n{one.words}", markup=False)
    if report.fuzzed:
        executions = sum(one.executions for one in report.fuzzed)
        minutes = sum(one.seconds for one in report.fuzzed) / 60
        out.print(f"fuzzing: {executions:,} inputs in {minutes:.0f} min on {len(report.fuzzed)} targets")
    failed = sum(not r.passed for r in report.rows) + sum(not one.passed for one in report.fuzzed)
    out.print(f"[bold red]{failed} figures beyond their bars[/]" if failed else "[bold green]all within their bars[/]")
