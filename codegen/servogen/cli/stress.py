"""servogen stress: the solver on random and singular matrices against exact rationals."""

import json
from pathlib import Path

import click

from servogen.cli.console import FAILED, GOOD, emit_json, json_option, out, progress, table
from servogen.verify.stress import StressReport, stress

CAMPAIGN_SYSTEMS = 5000


@click.command("stress")
@click.option("--systems", type=click.IntRange(1), default=100, show_default=True, help="Per family, shape and scalar.")
@click.option("--campaign", is_flag=True, help=f"The long run: {CAMPAIGN_SYSTEMS} systems, or --systems if more.")
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Of all matrices.")
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, help="Processes.")
@click.option("--out", "folder", type=click.Path(file_okay=False, path_type=Path), help="Folder for stress.json.")
@json_option
def stress_command(systems: int, campaign: bool, seed: int, jobs: int, folder: Path | None, as_json: bool) -> None:
    """Stress the generated solver: families of full-rank, graded, singular and extreme matrices."""
    count = max(systems, CAMPAIGN_SYSTEMS) if campaign else systems
    with progress(as_json) as advance:
        report = stress(systems=count, seed=seed, jobs=jobs, progress=advance)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "stress.json").write_text(json.dumps(report.to_json(), indent=2) + "\n")
    if as_json:
        emit_json(report.to_json())
    else:
        show_stress(report)
    raise click.exceptions.Exit(GOOD if report.passed else FAILED)


def show_stress(report: StressReport) -> None:
    """The report as a table."""
    table(
        f"Solver against exact rationals, {report.systems} systems a family, shape and scalar; seed {report.seed}",
        ("family", "scalar", "quantity", "systems", "largest", "bar", "at", ""),
        [
            (
                r.family,
                r.scalar,
                r.quantity,
                r.systems,
                f"{r.largest:.3g}",
                f"{r.bar:g}",
                r.shape,
                "ok" if r.passed else "[bold red]FAILED[/]",
            )
            for r in report.rows
        ],
        right=(3, 4, 5),
    )
    failed = sum(not r.passed for r in report.rows)
    out.print(f"[bold red]{failed} figures beyond their bars[/]" if failed else "[bold green]all within their bars[/]")
