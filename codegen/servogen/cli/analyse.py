"""servogen analyse: relative degree, dynamic extension, and what the constraints leave to itself."""

import click

from servogen.analysis.analyse import Analysis, analyse
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
)
from servogen.loading import load_scene


@click.command("analyse")
@scenes_argument
@all_option
@json_option
def analyse_command(scenes: tuple[str, ...], every: bool, as_json: bool) -> None:
    """Relative degree of SCENE... row by row, integrators needed, and the stability of the internal dynamics.

    Exit code 1 where what the constraints leave free runs away, or where they can never be independent.
    """
    names = chosen(scenes, every)
    found = []
    with progress(as_json) as advance:
        for k, name in enumerate(names):
            advance(k, len(names), name)
            found.append(analyse(load_scene(name)))
    if as_json:
        emit_json({a.scene: summary(a) for a in found})
    else:
        for a in found:
            _show(a)
    bad = any(a.verdict == "unstable" or a.extension is None for a in found)
    raise click.exceptions.Exit(FAILED if bad else GOOD)


def summary(a: Analysis) -> dict[str, object]:
    """The analysis for --json; eigenvalues as pairs (real, imaginary)."""
    return {
        "relative_degree": a.relative_degree,
        "rank": a.rank,
        "rows": a.rows,
        "controls": a.controls,
        "extension": a.extension,
        "exchanged": a.exchanged,
        "extended_degree": a.extended_degree,
        "internal_dimension": a.internal_dimension,
        "flat": a.flat,
        "equilibrium": a.equilibrium,
        "zero_dynamics": None if a.zero_dynamics is None else [(v.real, v.imag) for v in a.zero_dynamics.tolist()],
        "verdict": a.verdict,
        "meaning": a.meaning,
        "reason": a.reason,
    }


def _show(a: Analysis) -> None:
    out.print(a.scene, style="bold", markup=False)
    for subject, text in a.lines():
        out.print(f"  {subject}: {text}", markup=False, soft_wrap=True)
