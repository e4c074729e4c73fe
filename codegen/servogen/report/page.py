"""The page itself, from a template; no network, one file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from servogen.bench.results import Bench, Measurement, Output
from servogen.plan.module import mix_of
from servogen.report.collect import Report, SceneReport
from servogen.report.scene_work import Robustness
from servogen.report.sparsity import COLOURS, WORDS
from servogen.report.templates import pages
from servogen.results import Status
from servogen.simulate.runs import QUANTILES, Runs
from servogen.verify.answers import BAR
from servogen.verify.check import CheckReport, OutputCheck
from servogen.version import VERSION

HURTS = 0.3
"""Rank correlations below this are not told on a card: with a hundred runs chance alone gives 0.2."""


def write_page(report: Report, file: Path) -> None:
    """Writes the page in one step, so that a reader never finds half of it."""
    half = file.with_suffix(".part")
    half.write_text(render_page(report), encoding="utf-8")
    half.replace(file)


def render_page(report: Report) -> str:
    """The HTML of a report."""
    pages().filters.update(figure=_figure, ulps=_ulps, raised=_raised)
    return (
        pages()
        .get_template("report.html.j2")
        .render(
            report=report,
            version=VERSION,
            bar=BAR,
            mix=mix_of,
            cards=_cards,
            checks=_checks,
            histogram=_histogram,
            bench_rows=_bench_rows,
            quantiles=_quantiles,
            quantile_names=["largest" if q == 1 else f"{100 * q:g} %" for q in QUANTILES],
            solver_text=_solver_text,
            statuses=_statuses,
            legend=[(COLOURS[kind], words) for kind, words in WORDS.items()],
        )
    )


def _figure(value: float | None) -> str:
    """A number with three digits that count."""
    return "" if value is None else f"{value:.3g}"


def _ulps(value: float | None) -> str:
    """An error in ulps; what no reader needs to tell from none is 0."""
    return _figure(0.0 if value is not None and value < 1e-3 else value)


def _raised(text: str) -> str:
    """The powers in a line of words."""
    for power, sign in (("^-1", "⁻¹"), ("^T", "ᵀ"), ("^+", "⁺"), ("^2", "²")):
        text = text.replace(power, sign)
    return text


@dataclass(frozen=True)
class Card:
    """One answer at the top of a scene: what is judged, the judgement in a word, whether it is good, and a sentence.

    good: None where it is neither good nor bad.
    """

    what: str
    word: str
    good: bool | None
    text: str


def _cards(scene: SceneReport) -> list[Card]:
    """The judgements of a scene, the loop's first: what else is judged of a scene stands beside it."""
    cards = []
    if scene.loop is not None:
        verdict = scene.loop.trajectory.verdict
        cards.append(Card("The closed loop", verdict.word, verdict.held, f"{verdict.reason} {verdict.advice}".rstrip()))
    if scene.generated is not None:
        inside = scene.generated.inside
        good = {"none": True, "stable": True, "unstable": False}.get(inside.verdict)
        cards.append(Card("What is left inside", inside.verdict, good, _sentence(inside.meaning)))
    if scene.robustness is not None:
        cards.append(_robustness(scene.robustness))
    if scene.check is not None:
        reports = [r for r in (scene.check, scene.board) if r is not None]
        good = all(r.passed for r in reports)
        text = _accuracy(scene.check) + ("" if scene.board is None else _sameness(scene.board))
        cards.append(Card("The generated code", "right" if good else "wrong", good, text))
    return cards


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def _robustness(found: Robustness) -> Card:
    """How many of the runs were held, what became of the others, and what hurts."""
    runs, total = found.runs, len(found.runs.words)
    held = runs.verdicts.get("held", 0)
    others = ", ".join(f"{word} ({n})" for word, n in runs.verdicts.items() if word != "held")
    text = f"Of {total} runs with {found.varied}."
    text += f" The others: {others}." if others else ""
    hurts = [f"{name} ({rho:+.2f})" for name, rho in runs.correlation.items() if abs(rho) >= HURTS][:3]
    text += f" What hurts most, by rank correlation with the error: {', '.join(hurts)}." if hurts else ""
    return Card("Robustness", f"{held} of {total} held", runs.held, text)


def _quantiles(runs: Runs) -> list[tuple[str, str, Any]]:
    """Each quantity of the runs with its unit and its quantiles."""
    return [(name, unit, values) for unit, (name, values) in zip(runs.units, runs.quantiles().items(), strict=True)]


def _accuracy(check: CheckReport) -> str:
    values = sum(o.compared for o in check.outputs)
    worst = max((o.max_ulps for o in check.outputs), default=float("nan"))
    solve = max((s.max_error for s in check.solves), default=float("nan"))
    return (
        f"{values:,} values against the 50-digit truth, the largest error {_ulps(worst)} ulps; tau against exact "
        f"solutions {_figure(solve)} of at most {BAR:g} eps κ (‖τ‖ + ‖y‖)."
    )


def _sameness(board: CheckReport) -> str:
    values = sum(d.compared for d in board.differences)
    different = sum(d.different for d in board.differences)
    if not different:
        return f" On an emulated Cortex-M4F the same bits, {values:,} values."
    largest = max(d.max_ulps for d in board.differences)
    return f" On an emulated Cortex-M4F {different:,} of {values:,} values differ, by up to {_ulps(largest)} ulps."


def _histogram(check: OutputCheck) -> str:
    """Shares of an output's values by their error, to the last bin that is filled."""
    total = max(sum(check.histogram), 1)
    filled = max((k for k, n in enumerate(check.histogram) if n), default=0)
    shares = [100 * n / total for n in check.histogram[: filled + 1]]
    return " ".join("0" if s == 0 else "<0.1 %" if s < 0.1 else f"{s:.3g} %" for s in shares)


def _checks(check: CheckReport) -> list[OutputCheck]:
    """One row per output and scalar; compilers that agree to the bit are one."""
    rows: dict[tuple[str, str, str], OutputCheck] = {}
    for o in check.outputs:
        key = (o.scalar, o.entry, o.output)
        if key not in rows or o.max_ulps > rows[key].max_ulps:
            rows[key] = o
    return list(rows.values())


def _bench_rows(bench: Bench) -> list[Measurement]:
    return [m for output in Output for m in bench.measurements if m.output is output]


def _solver_text(manifest: dict[str, Any]) -> str:
    solver = manifest["solver"]
    form = {"row": "one row: closed form", "column": "one column: closed form", "full": "certified ladder"}
    return f"{solver['m']}×{solver['l']}, {form[solver['form']]}"


def _statuses(statuses: Any) -> str:
    """How often each status occurred along a run."""
    counted = {Status(int(s)).name: int((statuses == s).sum()) for s in sorted(set(statuses.tolist()))}
    return ", ".join(f"{name} {count:,}" for name, count in counted.items())
