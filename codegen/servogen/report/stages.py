"""Work in a process of its own, stage by stage, each with a cap in time: what is done stays done, and nothing hangs."""

import os
import signal
import subprocess
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import Pipe, Process
from multiprocessing.connection import Connection
from pathlib import Path
from threading import Event, Thread
from typing import Any, Literal

from servogen.errors import SceneError
from servogen.tools import ToolMissing

NOT_BEGUN = "not begun: stopped by Ctrl-C"
_GLANCE = 0.1  # seconds between two looks at the clock and at Ctrl-C


@dataclass(frozen=True)
class Stage:
    """One step: the method of the work that does it, what it is in words, and its cap in seconds.

    needed: whether the stages after it have no meaning without it.
    """

    method: str
    text: str
    cap: float
    needed: bool = False


class Skipped(RuntimeError):  # noqa: N818, the name says it
    """Raised by a stage that has nothing to say here; the message says why."""


@dataclass(frozen=True)
class Missing:
    """A stage without a result, and why. wrong_input: the scene, or what this machine lacks, is at fault."""

    text: str
    kind: Literal["skipped", "failed", "interrupted"]
    why: str
    wrong_input: bool = False

    def __str__(self) -> str:
        return f"{self.text}: {self.why}"


def run_stages(
    make: Callable[[], Any], stages: Sequence[Stage], say: Callable[[str], None], interrupted: Event
) -> dict[str, Any]:
    """method -> what it returned, or Missing; make() makes the work, in the process that does it.

    A stage beyond its cap ends with its process and whatever that has started; the next one begins in a new process.
    Results travel between processes, so they must pickle, and so must `make` where processes do not fork. Once
    `interrupted` is set the stage that runs ends, and those after it are not begun.
    """
    found: dict[str, Any] = {}
    left = list(stages)
    with tempfile.TemporaryDirectory(prefix="servogen-report-", ignore_cleanup_errors=True) as scratch:
        while left and not interrupted.is_set():
            child = _Child(make, [s.method for s in left], Path(scratch))
            try:
                while left and child.alive:
                    stage = left.pop(0)
                    say(stage.text)
                    found[stage.method] = answer = child.answer(stage, interrupted)
                    if stage.needed and isinstance(answer, Missing) and answer.kind != "interrupted":
                        why = f"it needs what is missing: {stage.text}"
                        found |= {s.method: Missing(s.text, "skipped", why) for s in left}
                        left = []
            finally:
                child.end()
    return found | {s.method: Missing(s.text, "interrupted", NOT_BEGUN) for s in left}


class _Child:
    """A process that does some stages in turn."""

    def __init__(self, make: Callable[[], Any], methods: Sequence[str], scratch: Path) -> None:
        self._pipe, theirs = Pipe()
        self._process = Process(target=_serve, args=(make, methods, scratch, self._pipe, theirs))
        self._process.start()
        theirs.close()
        self.alive = True

    def answer(self, stage: Stage, interrupted: Event) -> Any:
        """What the stage returned; Missing where it did not."""
        end = time.monotonic() + stage.cap
        while True:
            left = end - time.monotonic()
            # what has come is taken first, so that Ctrl-C loses nothing that was finished
            if not self._pipe.poll(0 if interrupted.is_set() else min(max(left, 0), _GLANCE)):
                if interrupted.is_set():
                    self.alive = False
                    return Missing(stage.text, "interrupted", "stopped by Ctrl-C before it was done")
                if left <= 0:
                    self.alive = False
                    return Missing(stage.text, "skipped", f"took longer than {stage.cap:g} s; --cap gives it more")
                continue
            try:
                kind, *content = self._pipe.recv()
            except EOFError:
                self.alive = False
                self._process.join()
                return Missing(stage.text, "failed", f"its process ended with exit code {self._process.exitcode}")
            if kind == "remark":
                warnings.warn(content[0], stacklevel=2)
            elif kind == "done":
                return content[0]
            else:
                return Missing(stage.text, kind, *content)

    def end(self) -> None:
        """Ends it and what it has started: compilers, emulators."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid or 0, signal.SIGKILL)
        self._process.kill()
        self._process.join()
        self._pipe.close()


def _serve(
    make: Callable[[], Any], methods: Sequence[str], scratch: Path, others: Connection, pipe: Connection
) -> None:
    """The process: a group of its own, which Ctrl-C does not reach, and which ends when its parent has gone."""
    others.close()
    os.setsid()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_parent, args=(pipe,), daemon=True).start()
    tempfile.tempdir = str(scratch)
    warnings.showwarning = lambda message, *rest, **more: pipe.send(("remark", str(message)))
    work: Any = None
    for method in methods:
        try:
            work = make() if work is None else work
            answer: tuple[Any, ...] = ("done", getattr(work, method)())
        except Exception as error:
            kind = "skipped" if isinstance(error, Skipped) else "failed"
            answer = (kind, _told(error), isinstance(error, SceneError | ToolMissing))
        pipe.send(answer)


def _told(error: Exception) -> str:
    """What went wrong in one line; only what nobody foresaw goes by its type."""
    if isinstance(error, subprocess.CalledProcessError):
        said = error.stderr.decode(errors="replace") if isinstance(error.stderr, bytes) else error.stderr or ""
        text = f"{Path(error.cmd[0]).name} failed with exit code {error.returncode}: {said}"
    else:
        foreseen = isinstance(error, SceneError | RuntimeError)
        text = str(error) if foreseen else f"{type(error).__name__}: {error}"
    return " ".join(text.split())


def _end_with_parent(pipe: Connection) -> None:
    with suppress(OSError, EOFError):
        pipe.recv()  # nobody sends anything: it returns when the other end has gone
    os.killpg(0, signal.SIGKILL)
