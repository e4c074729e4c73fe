"""Error against the 50-digit truth, and what is answered at the boundary."""

from collections.abc import Sequence

import numpy as np

from servogen.bench.inputs import Inputs
from servogen.bench.results import Boundary, Errors, Output
from servogen.compiler import optimised_scene
from servogen.ir.balls import Ball, all_finite, ball, balls, working
from servogen.ir.evaluate import evaluate_exactly
from servogen.law.steps import STATE
from servogen.results import FloatArray
from servogen.scalars import EPSILON, Scalar
from servogen.scene.scene import Scene
from servogen.verify.exact_steps import walk

Truth = dict[Output, list[list[Ball]]]
"""Output -> per state its entries row by row; NaN where the value does not exist or S has not full rank."""


def truth(scene: Scene, inputs: Inputs) -> Truth:
    """S, z (or R) by the unoptimised program's 50-digit interpreter, and tau by the law's steps, exactly."""
    formulation, program = optimised_scene(scene)
    system, control = scene.system, formulation.law.routine("control")
    columns = inputs.columns()
    columns["tau"] = columns.get("tau", np.zeros((1, scene.controls)))  # read by no servo scene, but an input
    result: Truth = {output: [] for output in Output}
    for k, values in enumerate(evaluate_exactly(program.exact, columns)):
        for name, _ in formulation.law.inputs:
            values[STATE + name] = balls(columns[name][k if len(columns[name]) > 1 else 0])
        walk(control.steps, values)
        S, z = values[system.matrix], values[system.right]
        result[Output.MATRIX].append(S)
        result[Output.RIGHT].append(z)
        result[Output.SYSTEM].append([*S, *z])
        result[Output.ANSWER].append(values[control.result])
    return result


def judge(values: FloatArray, exact: Sequence[list[Ball]], scalar: Scalar) -> Errors:
    """values: (N, size). A NaN or an infinity is an infinite error; states without a truth are not judged."""
    worst, scale = [], 0.0
    for row, true in zip(values, exact, strict=True):
        if not all_finite(true):
            continue
        worst.append(_error(row, true))
        scale = max(scale, *(abs(float(x)) for x in true))
    if not worst:
        return Errors(float("nan"), float("nan"), scale, EPSILON[scalar], 0, 0)
    nonfinite = sum(not np.isfinite(e) for e in worst)
    return Errors(max(worst), float(np.median(worst)), scale, EPSILON[scalar], len(worst), nonfinite)


def _error(row: FloatArray, true: list[Ball]) -> float:
    """The worst entry of one state, subtracted before it is rounded."""
    if len(row) != len(true) or not np.all(np.isfinite(row)):
        return float("inf")
    with working():
        return max(abs(float(ball(x) - t)) for x, t in zip(row, true, strict=True))


def count_answers(names: Sequence[str], values: FloatArray, statuses: FloatArray) -> Boundary:
    """How the boundary states were answered: values (N, size), statuses (N,)."""
    kinds: dict[str, list[str]] = {kind: [] for kind in ("good", "remarked", "refused", "nonfinite")}
    for name, row, status in zip(names, values, statuses, strict=True):
        if status < 0:
            kinds["refused"].append(name)
        elif not np.all(np.isfinite(row)):
            kinds["nonfinite"].append(name)
        else:
            kinds["remarked" if status > 0 else "good"].append(name)
    good, remarked, refused = (len(kinds[kind]) for kind in ("good", "remarked", "refused"))
    return Boundary(good, remarked, refused, tuple(kinds["nonfinite"]))
