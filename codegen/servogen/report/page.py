"""The page itself, from a template; no network, one file."""

from pathlib import Path
from typing import Any

from servogen.bench.results import Bench, Measurement, Output
from servogen.plan.module import mix_of
from servogen.report.collect import Report
from servogen.report.sparsity import COLOURS, WORDS
from servogen.report.templates import pages
from servogen.results import Status
from servogen.verify.check import CheckReport, OutputCheck
from servogen.verify.truth import BAR
from servogen.version import VERSION


def write_page(report: Report, file: Path) -> None:
    """Writes the page in one step, so that a reader never finds half of it."""
    half = file.with_suffix(".part")
    half.write_text(render_page(report), encoding="utf-8")
    half.replace(file)


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


def _summary(report: Report) -> list[tuple[str, str, bool]]:
    """(what, figure, good) for the top of the page."""
    rows = []
    for scene in report.scenes:
        if scene.loop is not None:
            stop = scene.loop.trajectory.stop
            rows.append((f"{scene.name} in closed loop", f"{stop}; {scene.loop.off_decay}", not stop.failed))
    checks = [s.check for s in report.scenes if s.check is not None]
    if checks:
        outputs = [o for check in checks for o in check.outputs]
        worst = max((o.max_ulps for o in outputs), default=float("nan"))
        solve = max((s.max_error for check in checks for s in check.solves), default=float("nan"))
        values = sum(o.compared for o in outputs)
        rows += [
            (
                "Generated C against the 50-digit truth",
                f"{values:,} values, largest error {worst:.3g} ulps of its output's scale",
                all(check.passed for check in checks),
            ),
            (
                "tau against the exact solution of its system",
                f"{solve:.3g} of at most {BAR:g} u κ (‖τ‖ + ‖y‖), u the unit roundoff, κ the condition of S",
                solve <= BAR,
            ),
        ]
    boards = [s.board for s in report.scenes if s.board is not None]
    if boards:
        differences = [d for board in boards for d in board.differences]
        different = sum(d.different for d in differences)
        largest = max((d.max_ulps for d in differences), default=0.0)
        values = sum(d.compared for d in differences)
        text = f"{values:,} values, {different:,} not bit-equal, largest difference {largest:.3g} ulps"
        rows.append(("The same vectors on an emulated Cortex-M4F", text, all(board.passed for board in boards)))
    return rows


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
    kind = {"row": "one row: closed form", "column": "one column: closed form", "full": "certified ladder"}
    return f"{solver['m']}×{solver['l']}, {kind[solver['kind']]}"


def _statuses(statuses: Any) -> str:
    """How often each status occurred along a run."""
    counted = {Status(int(s)).name: int((statuses == s).sum()) for s in sorted(set(statuses.tolist()))}
    return ", ".join(f"{name} {count:,}" for name, count in counted.items())
