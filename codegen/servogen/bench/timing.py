"""Run time: contenders in rounds (A B C A B C ...), so that a machine's noise hits all alike."""

import time
from collections.abc import Callable, Sequence

import numpy as np

from servogen.bench.contenders import PythonContender
from servogen.bench.driver import Driver
from servogen.bench.inputs import Inputs
from servogen.bench.results import Output, Times
from servogen.results import FloatArray

BATCH = 256  # calls of a timed batch of C, each at another state
BATCHES = 100  # of a round
PYTHON_BATCH = 16
PYTHON_BATCHES = 4

Key = tuple[str, Output]
Samples = dict[Key, list[FloatArray]]
"""(contender, output) -> per round the batches' nanoseconds per call."""


def sample(
    driver: Driver | None,
    python: Sequence[PythonContender],
    inputs: Inputs,
    rounds: int,
    advance: Callable[[int], None],
) -> Samples:
    """Time everything `rounds` times; `advance` is told the rounds done. The first in line changes every round."""
    samples: Samples = {}
    states = inputs.keywords()
    for k in range(rounds):
        if driver is not None and driver.tasks:
            measured = driver.times(inputs, min(BATCH, inputs.count), BATCHES, k % len(driver.tasks))
            for task, row in zip(driver.tasks, measured, strict=True):
                samples.setdefault((task.contender.name, task.output), []).append(row)
        for contender in python:
            for output in contender.calls:
                row = _time_in_python(contender, output, states, k)
                samples.setdefault((contender.name, output), []).append(row)
        advance(k + 1)
    return samples


def _time_in_python(
    contender: PythonContender, output: Output, states: list[dict[str, FloatArray]], turn: int
) -> FloatArray:
    call = contender.calls[output]
    call(states[0])
    result = []
    with np.errstate(all="ignore"):
        for k in range(PYTHON_BATCHES):
            first = (turn * PYTHON_BATCHES + k) * PYTHON_BATCH
            chosen = [states[i % len(states)] for i in range(first, first + PYTHON_BATCH)]
            start = time.perf_counter_ns()
            for state in chosen:
                call(state)
            result.append((time.perf_counter_ns() - start) / PYTHON_BATCH)
    return np.array(result)


def summarise(samples: Samples, baseline: str) -> dict[Key, Times]:
    """Median, best and 99.9th percentile over all batches; ratios of the rounds' medians to the baseline's."""
    result = {}
    for (name, output), rows in samples.items():
        table = np.vstack(rows)
        reference = samples.get((baseline, output))
        ratio = float("nan")
        if reference is not None:
            ratio = float(np.median(np.median(table, axis=1) / np.median(np.vstack(reference), axis=1)))
        median, p999 = np.percentile(table, [50, 99.9])
        result[name, output] = Times(float(median), float(table.min()), float(p999), table.size, ratio)
    return result
