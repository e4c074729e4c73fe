"""Stages in a process of their own: caps, failures, and Ctrl-C at any moment."""

import os
import subprocess
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread

import pytest
import servogen as sg
from servogen.report.stages import Missing, Stage, run_stages

STAGES = [Stage(name, f"stage {name}", 20.0) for name in ("first", "second", "third", "fourth", "fifth")]


class Work:
    """Stages that end at once, but for those that a test slows down or breaks."""

    def __init__(self, slow: str = "", folder: Path | None = None, fails: Exception | None = None) -> None:
        self.slow, self.folder, self.fails = slow, folder, fails

    def __getattr__(self, name: str):
        return lambda: self._do(name)

    def _do(self, name: str) -> str:
        if name == self.slow and self.fails is not None:
            raise self.fails
        if name == self.slow and self.folder is not None:
            sleeper = subprocess.Popen(["sleep", "600"])
            (self.folder / "half").write_text(f"{os.getpid()} {sleeper.pid}")
            (self.folder / "half").rename(self.folder / "pids")
        if name == self.slow:
            time.sleep(600)
        return f"{name} done"


def wait_until(true: Callable[[], bool]) -> bool:
    end = time.monotonic() + 20.0
    while not true() and time.monotonic() < end:
        time.sleep(0.02)
    return true()


def ended(folder: Path) -> bool:
    """Whether the processes that the slow stage has told of end: gone, or zombies."""
    stats = [Path(f"/proc/{pid}/stat") for pid in (folder / "pids").read_text().split()]

    def gone(stat: Path) -> bool:
        try:
            return stat.read_text().rpartition(")")[2].split()[0] == "Z"
        except OSError:
            return True

    return len(stats) == 2 and wait_until(lambda: all(map(gone, stats)))


@pytest.mark.parametrize("at", range(5))
def test_ctrl_c_loses_nothing_that_was_finished(at: int, tmp_path: Path) -> None:
    told: list[str] = []
    interrupted = Event()

    def press() -> None:
        wait_until((tmp_path / "pids").exists)
        interrupted.set()

    Thread(target=press).start()
    found = run_stages(lambda: Work(STAGES[at].method, tmp_path), STAGES, told.append, interrupted)
    assert list(found.values())[:at] == [f"{s.method} done" for s in STAGES[:at]]
    rest = list(found.values())[at:]
    assert len(rest) == 5 - at
    assert all(isinstance(m, Missing) and m.kind == "interrupted" for m in rest)
    assert told == [s.text for s in STAGES[: at + 1]]
    assert ended(tmp_path)


def test_a_stage_beyond_its_cap_ends_with_what_it_started_and_the_others_are_done(tmp_path: Path) -> None:
    stages = [STAGES[0], Stage("second", "stage second", 3.0), *STAGES[2:]]
    began = time.monotonic()
    found = run_stages(lambda: Work("second", tmp_path), stages, lambda text: None, Event())
    assert time.monotonic() - began < 60
    assert str(found["second"]) == "stage second: took longer than 3 s; --cap gives it more"
    assert [found[s.method] for s in stages if s.method != "second"] == [
        f"{s.method} done" for s in stages if s.method != "second"
    ]
    assert ended(tmp_path)


def test_a_stage_that_fails_is_told_and_stops_only_those_that_need_it() -> None:
    found = run_stages(lambda: Work("third", fails=OSError("no\nspace")), STAGES, lambda text: None, Event())
    assert (found["third"].kind, found["third"].why) == ("failed", "OSError: no space")
    assert found["fifth"] == "fifth done"
    needed = [Stage("third", "stage third", 20.0, needed=True), *STAGES[3:]]
    found = run_stages(lambda: Work("third", fails=sg.SceneError("odd")), needed, lambda text: None, Event())
    assert found["third"] == Missing("stage third", "failed", "odd", wrong_input=True)
    assert found["fourth"].kind == found["fifth"].kind == "skipped"
    assert "stage third" in found["fourth"].why


def test_a_process_that_dies_is_told_and_its_remarks_arrive() -> None:
    class Dies:
        def first(self) -> str:
            warnings.warn("a remark", stacklevel=1)
            return "first done"

        def second(self) -> None:
            os._exit(9)

    with pytest.warns(match="a remark"):
        found = run_stages(Dies, STAGES[:2], lambda text: None, Event())
    assert found["first"] == "first done"
    assert found["second"].why == "its process ended with exit code 9"
