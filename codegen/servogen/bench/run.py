"""The bench of one scene, on one page: inputs, contenders, values, errors, times, instructions."""

import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from servogen.bench import instructions
from servogen.bench.contenders import (
    BASELINE,
    CContender,
    Contender,
    PythonContender,
    default_contenders,
    output_sizes,
)
from servogen.bench.driver import Driver, built, compile_driver, compiler_version
from servogen.bench.error import count_answers, judge, truth
from servogen.bench.inputs import Inputs, at_the_boundary, drawn
from servogen.bench.results import Bench, Instructions, Measurement, labels
from servogen.bench.timing import BATCH, Key, sample, summarise
from servogen.results import FloatArray
from servogen.scene.scene import Scene
from servogen.tools import c_compiler

STATES = 1024
ROUNDS = 20

Progress = Callable[[int, int, str], None]
Answers = dict[Key, tuple[FloatArray, FloatArray]]
Choose = Callable[[Scene, Inputs, int], Sequence[Contender]]


def bench(
    scene: Scene,
    rounds: int = ROUNDS,
    states: int = STATES,
    seed: int = 0,
    compiler: str | None = None,
    flags: Sequence[str] = ("-O2",),
    contenders: Choose = default_contenders,
    baseline: str = BASELINE,
    count_instructions: bool = True,
    progress: Progress = lambda done, total, text: None,
) -> Bench:
    """Run time against error of the scene's matrix, right side and answer, all contenders in one run.

    states: drawn from the scene's domain by `seed`, the same for all. compiler: default $CC, else cc.
    contenders: (scene, inputs, capacity) -> who is measured; baseline: of the ratios.
    Raises ToolMissing without a C compiler.
    """
    command = shlex.join(c_compiler(compiler))
    version = compiler_version(command)
    names, edge = at_the_boundary(scene)
    inputs = drawn(scene, states, seed)
    capacity = max(inputs.count, edge.count)
    count = count_instructions and instructions.available()
    steps = _Steps(progress, 4 + rounds)

    steps.say(f"{scene.name}: generate")
    chosen = tuple(contenders(scene, inputs, capacity))
    in_c = [c for c in chosen if isinstance(c, CContender)]
    in_python = [c for c in chosen if isinstance(c, PythonContender)]
    with TemporaryDirectory(prefix="servogen-bench-") as folder:
        steps.say(f"{scene.name}: compile")
        driver = compile_driver(in_c, output_sizes(scene), inputs, capacity, Path(folder), command, flags)
        builds = tuple(built(c, Path(folder), command, flags) for c in in_c)
        steps.expect(len(driver.tasks) if count else 0)
        steps.say(f"{scene.name}: evaluate")
        answers = _answers(driver, in_python, inputs, scene)
        at_edge = _answers(driver, in_python, edge, scene)
        steps.say(f"{scene.name}: 50-digit truth")
        truths = {s: truth(scene, inputs.rounded(s)) for s in {c.scalar for c in chosen}}
        samples = sample(driver, in_python, inputs, rounds, lambda k: steps.say(f"{scene.name}: round {k}"))
        counts: dict[Key, Instructions] = {}
        for k, task in enumerate(driver.tasks if count else ()):
            steps.say(f"{scene.name}: instructions of {task.contender.name}")
            counts[task.contender.name, task.output] = instructions.count(driver, inputs, k)
    times = summarise(samples, baseline)
    measurements = [
        Measurement(
            contender=c.name,
            scalar=c.scalar,
            ours=c.ours,
            output=output,
            label=labels(scene.system)[output],
            times=times[c.name, output],
            errors=judge(answers[c.name, output][0], truths[c.scalar][output], c.scalar),
            instructions=counts.get((c.name, output)),
            boundary=count_answers(names, *at_edge[c.name, output]),
            aside=isinstance(c, CContender) and c.aside,
        )
        for c in chosen
        for output in c.calls
    ]
    return Bench(
        scene=scene.name,
        kind=scene.kind,
        compiler=version,
        flags=tuple(flags),
        states=states,
        batch=min(BATCH, states),
        rounds=rounds,
        seed=seed,
        baseline=baseline,
        measurements=tuple(measurements),
        remarks=(instructions.MISSING,) if count_instructions and not count else (),
        builds=builds,
    )


class _Steps:
    """Progress: four steps, the rounds, and the profiles; the profiles are known once the contenders are."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def expect(self, more: int) -> None:
        self._total += more

    def say(self, text: str) -> None:
        self._done += 1
        self._progress(self._done, self._total, text)


def _answers(driver: Driver, in_python: Sequence[PythonContender], inputs: Inputs, scene: Scene) -> Answers:
    """(contender, output) -> outputs (N, size) and statuses (N,) at every state."""
    answers: Answers = {}
    for task, answer in zip(driver.tasks, driver.values(inputs), strict=True):
        answers[task.contender.name, task.output] = answer
    sizes = output_sizes(scene)
    with np.errstate(all="ignore"):
        for c in in_python:
            for output, call in c.calls.items():
                pairs = [call(state) for state in inputs.keywords()]
                rows = [value if status >= 0 else np.full(sizes[output], np.nan) for status, value in pairs]
                answers[c.name, output] = np.array(rows, dtype=float), np.array([status for status, _ in pairs])
    return answers
