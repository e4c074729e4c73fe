"""A stress run: its tasks, on this machine or on any executor, each written down as it ends."""

import itertools
import math
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path

from servogen.interrupt import interrupt_kept
from servogen.scalars import Scalar
from servogen.tools import find_tool
from servogen.verify.fuzz import Fuzzed, fuzz, require_fuzzer, targets
from servogen.verify.stress.bars import Figure
from servogen.verify.stress.bench import MakeTwin, Task, built
from servogen.verify.stress.families import FAMILIES, SHAPES, run
from servogen.verify.stress.journal import Journal
from servogen.verify.stress.report import StressReport, rows

SCALARS: tuple[Scalar, ...] = ("float64", "float32")

Progress = Callable[[int, int, str], None]


def stress(
    make: MakeTwin | None = None,
    *,
    seed: int = 1,
    systems: int = 1000,
    shapes: Sequence[tuple[int, int]] = SHAPES,
    scalars: Sequence[Scalar] = SCALARS,
    families: Sequence[str] | None = None,
    long: bool = False,
    fuzzing: float = 0,
    jobs: int = 1,
    executor: Executor | None = None,
    journal: Path | None = None,
    progress: Progress | None = None,
) -> StressReport:
    """Every family, `systems` of each in each scalar, shared by its shapes; the same seed gives the same systems.

    make(m, l, scalar, solver) gives the twin under test; by default it is the package of `servogen.build_solver`.
    long: also the families that only a campaign has time for. fuzzing: seconds of it in all.
    The tasks run on `executor` if one is given (dask.distributed's Client.get_executor(), say), else in `jobs`
    processes; in both cases `make` must be picklable. journal: a file in which finished tasks are kept; what is in it
    is not done again. Raises ValueError for an unknown family, ToolMissing for a missing compiler.
    """
    chosen = tuple(name for name, f in FAMILIES.items() if long or not f.long) if families is None else tuple(families)
    unknown = [name for name in chosen if name not in FAMILIES]
    if unknown:
        raise ValueError(f"no family {unknown[0]!r}; choose from {', '.join(FAMILIES)}")
    work = tasks(chosen, shapes, scalars, systems, seed)
    for tool in {tool for name in chosen for tool in FAMILIES[name].tools}:
        find_tool(tool, tool)  # now, not after hours
    if fuzzing > 0:
        require_fuzzer()
    kept = Journal(journal, seed)
    left = [task for task in work if str(task) not in kept.found]
    done = len(work) - len(left)

    def keep(task: Task, figures: list[Figure]) -> None:
        nonlocal done
        kept.write(str(task), [asdict(one) for one in figures])
        done += 1
        if progress is not None:
            progress(done, len(work), f"{task.family} {task.m}x{task.l} {task.scalar}")

    _run_all(left, built if make is None else make, jobs, executor, keep)
    work.sort(key=lambda task: (chosen.index(task.family), scalars.index(task.scalar)))
    found = [(task, [Figure(**one) for one in kept.found[str(task)]]) for task in work]
    return StressReport(seed, systems, rows(found), tuple(_fuzz(fuzzing, seed, jobs, kept, progress)))


def tasks(
    families: Sequence[str],
    shapes: Sequence[tuple[int, int]],
    scalars: Sequence[Scalar],
    systems: int,
    seed: int,
) -> list[Task]:
    """The first part of every family and shape, then the second of every one, and so on: cut short, a run has done
    about as much of each."""
    work = []
    for name, scalar in itertools.product(families, scalars):
        family = FAMILIES[name]
        own = [(m, l) for m, l in family.shapes or shapes if family.applies(m, l)]
        for m, l in own:
            left = 1 if family.finite else math.ceil(systems * family.times / len(own))
            for part in itertools.count():
                if left <= 0:
                    break
                work.append(Task(name, m, l, scalar, min(left, family.part), part, seed))
                left -= family.part
    return sorted(work, key=lambda task: task.part)


def _run_all(
    work: Sequence[Task],
    make: MakeTwin,
    jobs: int,
    executor: Executor | None,
    keep: Callable[[Task, list[Figure]], None],
) -> None:
    """Each task kept as it ends. Interrupted, those that run may end, and the others are not begun."""
    if executor is None and jobs == 1:
        for task in work:
            keep(task, run(task, make))
        return
    with (
        nullcontext(executor) if executor is not None else ProcessPoolExecutor(jobs, initializer=_deaf) as pool,
        interrupt_kept() as interrupted,
    ):
        left = iter(work)
        at_once = 2 * jobs if executor is None else len(work)  # nobody knows how many an executor of others runs
        running: dict[Future[list[Figure]], Task] = {}
        try:
            while True:
                for task in itertools.islice(left, at_once - len(running)):
                    running[pool.submit(run, task, make)] = task
                if not running:
                    return
                for future in wait(running, timeout=0.2, return_when=FIRST_COMPLETED).done:
                    task = running.pop(future)
                    keep(task, future.result())
                if interrupted.is_set():
                    raise KeyboardInterrupt
        except BaseException:
            for future, task in running.items():
                if not future.cancel() and future.exception() is None:
                    keep(task, future.result())
            raise


def _deaf() -> None:
    """A worker leaves Ctrl-C to the process that gave it work."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _fuzz(seconds: float, seed: int, jobs: int, kept: Journal, progress: Progress | None) -> Iterator[Fuzzed]:
    if seconds <= 0:
        return
    every = targets()
    share = max(1, round(seconds / len(every)))
    names = {target: f"fuzzing {target}, {share} s" for target in every}
    left = [target for target in every if names[target] not in kept.found]
    done = len(every) - len(left)
    for target, one in fuzz(share, left, seed=seed, jobs=jobs):
        kept.write(names[target], asdict(one))
        done += 1
        if progress is not None:
            progress(done, len(every), f"fuzzing {target}")
    yield from (Fuzzed(**kept.found[names[target]]) for target in every)
