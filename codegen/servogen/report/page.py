"""The page itself, from a template; no network, one file."""

from typing import Any

from servogen.bench.results import Bench, Measurement, Output
from servogen.plan.module import mix_of
from servogen.report.collect import Report
from servogen.report.sparsity import COLOURS, WORDS
from servogen.report.templates import pages
from servogen.results import Status
from servogen.verify.answers import BAR
from servogen.verify.check import OutputCheck
from servogen.version import VERSION


def render_page(report: Report) -> str:
    """The HTML of a report."""
    pages().filters["figure"] = _figure
    return (
        pages()
        .get_template("report.html.j2")
        .render(
            report=report,
            version=VERSION,
            bar=BAR,
            mix=mix_of,
            summary=_summary(report),
            checks=_checks,
            histogram=_histogram,
            bench_rows=_bench_rows,
            solver_text=_solver_text,
            statuses=_statuses,
            legend=[(COLOURS[kind], words) for kind, words in WORDS.items()],
        )
    )


def _figure(value: float | None) -> str:
    """A number with three digits that count."""
    return "" if value is None else f"{value:.3g}"


def _summary(report: Report) -> list[tuple[str, str, str, bool]]:
    """(what, figure, in a word, good) for the top of the page."""
    check = report.check
    worst = max((o.max_ulps for o in check.outputs), default=float("nan"))
    solve = max((s.max_error for s in check.solves), default=float("nan"))
    rows = [
        (
            "Generated C against the 50-digit truth",
            f"{sum(o.compared for o in check.outputs):,} values, largest error {worst:.3g} ulps of its output's scale",
            check.passed,
        ),
        (
            "tau against the exact solution of its system",
            f"{solve:.3g} of at most {BAR:g} u κ (‖τ‖ + ‖y‖), u the unit roundoff, κ the condition of S",
            solve <= BAR,
        ),
    ]
    if report.board is not None:
        different = sum(d.different for d in report.board.differences)
        largest = max((d.max_ulps for d in report.board.differences), default=0.0)
        values = sum(d.compared for d in report.board.differences)
        text = f"{values:,} values, {different:,} not bit-equal, largest difference {largest:.3g} ulps"
        rows.append(("The same vectors on an emulated Cortex-M4F", text, report.board.passed))
    verdicts = [(s.name, s.trajectory.verdict) for s in report.scenes]
    return [
        *((what, text, "passed" if good else "failed", good) for what, text, good in rows),
        *((f"{name} in closed loop", f"{v.reason} {v.advice}", v.word, v.held) for name, v in verdicts),
    ]


def _histogram(check: OutputCheck) -> str:
    """Shares of an output's values by their error, to the last bin that is filled."""
    total = max(sum(check.histogram), 1)
    filled = max((k for k, n in enumerate(check.histogram) if n), default=0)
    shares = [100 * n / total for n in check.histogram[: filled + 1]]
    return " ".join("0" if s == 0 else "<0.1 %" if s < 0.1 else f"{s:.3g} %" for s in shares)


def _checks(report: Report, scene: str) -> list[OutputCheck]:
    """One row per output and scalar; compilers that agree to the bit are one."""
    rows: dict[tuple[str, str, str], OutputCheck] = {}
    for o in report.check.outputs:
        key = (o.scalar, o.entry, o.output)
        if o.scene == scene and (key not in rows or o.max_ulps > rows[key].max_ulps):
            rows[key] = o
    return list(rows.values())


def _bench_rows(bench: Bench) -> list[Measurement]:
    return [m for output in Output for m in bench.measurements if m.output is output]


def _solver_text(manifest: dict[str, Any]) -> str:
    solver = manifest["solver"]
    kind = {"row": "one row: closed form", "column": "one column: closed form", "full": "certified ladder"}
    return f"{solver['m']}×{solver['l']}, {kind[solver['kind']]}"


def _statuses(statuses: Any) -> str:
    """How often each status occurred along a run."""
    counted = {Status(int(s)).name: int((statuses == s).sum()) for s in sorted(set(statuses.tolist()))}
    return ", ".join(f"{name} {count:,}" for name, count in counted.items())
