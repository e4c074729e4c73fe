"""servogen verdicts: what scenes come to on machines that are not their model, as one table."""

import click

from servogen.cli.console import (
    FAILED,
    GOOD,
    all_option,
    chosen,
    emit_json,
    json_option,
    out,
    progress,
    scenes_argument,
    table,
)
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.trials import not_tried, trials
from servogen.simulate.wanted import load_simulation


@click.command("verdicts")
@scenes_argument
@all_option
@json_option
def verdicts_command(scenes: tuple[str, ...], every: bool, as_json: bool) -> None:
    """Run SCENE... as they are and on machines with a flaw each: heavier, noisy, late, weak.

    Exit code 1 unless all are held as they are.
    """
    names = chosen(scenes, every)
    found, missing = {}, {}
    with progress(as_json, logged=True) as advance:
        for k, name in enumerate(names):
            advance(k, len(names), name)
            scene, simulation = load_simulation(name)
            found[scene.name] = trials(ClosedLoop(scene, simulation))
            missing[scene.name] = not_tried(scene)
    if as_json:
        emit_json({n: {t.machine: t.run.verdict for t in tried} for n, tried in found.items()})
    else:
        rows = [
            (n, t.machine, t.run.verdict.word, f"{max(t.run.shares, default=float('nan')):.3g}")
            for n, tried in found.items()
            for t in tried
        ]
        table(
            "Verdicts, and how far psi was off its prescribed decay as a share of its tolerance",
            ("scene", "machine", "verdict", "off"),
            rows,
            right=(3,),
        )
        for name, what in missing.items():
            if what:
                out.print(f"  {name}: {what}", markup=False)
    held = all(tried[0].run.verdict.held for tried in found.values())
    raise click.exceptions.Exit(GOOD if held else FAILED)
