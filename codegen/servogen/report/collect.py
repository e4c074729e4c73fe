"""Everything the page shows: each scene's stages, and the paper's figures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any, TypeVar

from servogen.loading import load_scene, scene_summary
from servogen.report.inline import inline_svg
from servogen.report.paper import SCENES as PAPER
from servogen.report.paper import TITLES, Sheet, draw_paper, narrow_figures, run_paper, sheets
from servogen.report.scene_work import STAGES, Figure, Generated, Loop, LoopPrecision, Robustness, Speed, Work
from servogen.report.stages import Missing, Stage, run_stages
from servogen.simulate.trajectory import Trajectory
from servogen.verify.check import CheckReport

Progress = Callable[[int, int, str], None]
_Result = TypeVar("_Result")


@dataclass(frozen=True, eq=False)
class SceneReport:
    """One scene: what its stages found, None for those that are missing. `folder` holds its files, relative to the
    page."""

    name: str
    summary: str
    folder: str
    generated: Generated | None
    loop: Loop | None
    robustness: Robustness | None
    check: CheckReport | None
    board: CheckReport | None
    speed: Speed | None
    precision: LoopPrecision | None
    missing: Mapping[str, Missing]  # by stage

    @property
    def problems(self) -> tuple[str, ...]:
        """What a check found, or kept a stage from ending."""
        found = [text for report in (self.check, self.board) if report is not None for text in report.problems]
        return (*dict.fromkeys(found), *(f"{self.name}: {m}" for m in self.missing.values() if m.kind == "failed"))

    @property
    def skipped(self) -> tuple[str, ...]:
        """What is not on the page, and why."""
        found = [text for report in (self.check, self.board) if report is not None for text in report.skipped]
        return (*dict.fromkeys(found), *(f"{self.name}: {m}" for m in self.missing.values() if m.kind != "failed"))


@dataclass(frozen=True)
class PaperSheet:
    """Some of the paper's figures, and what they reproduce."""

    caption: str
    figures: tuple[Figure, ...]


@dataclass(frozen=True, eq=False)
class Report:
    """The page's content."""

    scenes: tuple[SceneReport, ...]
    paper: tuple[PaperSheet, ...] = ()
    remarks: tuple[str, ...] = ()  # what this machine lacks, and the paper's figures where they are missing

    @property
    def problems(self) -> tuple[str, ...]:
        return tuple(text for scene in self.scenes for text in scene.problems)

    @property
    def skipped(self) -> tuple[str, ...]:
        return (*self.remarks, *dict.fromkeys(text for scene in self.scenes for text in scene.skipped))

    @property
    def held(self) -> bool:
        """Whether the loop of every scene was run, and held."""
        return all(scene.loop is not None and scene.loop.trajectory.verdict.held for scene in self.scenes)

    @property
    def wrong_input(self) -> bool:
        """Whether a scene itself was at fault."""
        return any(m.wrong_input for scene in self.scenes for m in scene.missing.values())


@dataclass(frozen=True)
class Wishes:
    """What is asked of a report. folder: of the page; each scene's files go to folder/<scene>/.

    states: of the cross-check; rounds: of the benchmark; peers: whether against whole rivals. without: stages to leave
    out, and why. cap: seconds for each stage instead of its own.
    """

    folder: Path
    states: int = 500
    rounds: int = 10
    peers: bool = False
    without: tuple[tuple[str, str], ...] = ()
    cap: float | None = None


def collect(
    specs: Sequence[str],
    wishes: Wishes,
    progress: Progress = lambda done, total, text: None,
    interrupted: Event | None = None,
    finished: Callable[[Report], None] = lambda report: None,
) -> Report:
    """Run everything for scenes named as on the command line.

    finished: gets the report as it stands after each scene. interrupted: once set, the stage that runs ends, nothing
    more is begun, and the report holds what was done. Raises SceneError where a scene cannot be loaded.
    """
    interrupted = interrupted or Event()
    names = {spec: load_scene(spec).name for spec in specs}
    stages = [s for s in STAGES if s.method not in dict(wishes.without)]
    paper = _PAPER if any(name in PAPER for name in names.values()) else ()
    say = _steps(progress, len(stages) * len(specs) + len(paper))
    report = Report((), remarks=tuple(dict.fromkeys(why for _, why in wishes.without)))
    for spec, name in names.items():
        own = wishes.folder / name
        own.mkdir(parents=True, exist_ok=True)
        work = Work(spec, own, wishes.states, wishes.rounds, wishes.peers)
        found = run_stages(work.begin, _capped(stages, wishes.cap), partial(_say_of, say, name), interrupted)
        report = replace(report, scenes=(*report.scenes, _scene_report(spec, name, found)))
        finished(report)
    if paper:
        known = {s.name: s.loop.trajectory for s in report.scenes if s.loop is not None}
        drawn = run_stages(_Paper(wishes.folder / "paper", known).begin, _capped(paper, wishes.cap), say, interrupted)
        figures = drawn["draw"]
        if isinstance(figures, Missing):
            report = replace(report, remarks=(*report.remarks, str(figures)))
        else:
            report = replace(report, paper=figures)
        finished(report)
    return report


def _say_of(say: Callable[[str], None], name: str, text: str) -> None:
    say(f"{name}: {text}")


def _scene_report(spec: str, name: str, found: Mapping[str, Any]) -> SceneReport:
    def of(method: str, kind: type[_Result]) -> _Result | None:
        result = found.get(method)
        return result if isinstance(result, kind) else None

    return SceneReport(
        name=name,
        summary=scene_summary(spec),
        folder=name,
        generated=of("generate", Generated),
        loop=of("loop", Loop),
        robustness=of("robustness", Robustness),
        check=of("check", CheckReport),
        board=of("board", CheckReport),
        speed=of("speed", Speed),
        precision=of("precision", LoopPrecision),
        missing={method: m for method, m in found.items() if isinstance(m, Missing)},
    )


def _capped(stages: Sequence[Stage], cap: float | None) -> list[Stage]:
    return [s if cap is None else replace(s, cap=cap) for s in stages]


def _steps(progress: Progress, total: int) -> Callable[[str], None]:
    """Counts what is begun."""
    begun = 0

    def say(text: str) -> None:
        nonlocal begun
        progress(begun, total, text)
        begun += 1

    return say


_PAPER = (Stage("draw", "the paper's figures", 300),)


@dataclass(frozen=True, eq=False)
class _Paper:
    """The paper's figures, from runs that are known and others made for them."""

    folder: Path
    known: Mapping[str, Trajectory]

    def begin(self) -> "_Paper":
        return self

    def draw(self) -> tuple[PaperSheet, ...]:
        found = sheets(run_paper(self.known))
        draw_paper(found, self.folder)
        return tuple(PaperSheet(sheet.caption, self._figures(sheet)) for sheet in found)

    def _figures(self, sheet: Sheet) -> tuple[Figure, ...]:
        captions = {number: f"Figure {number}: {TITLES[number]}" for number in TITLES}
        return tuple(
            Figure(inline_svg(figure, captions[number], f"paper-{number}"), captions[number])
            for number, figure in narrow_figures(sheet).items()
        )
