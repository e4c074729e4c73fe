"""Are the constraints numbers, and do they reach the controls?

Found are values that exist nowhere, and rows of S (or A) that vanish identically or can never be independent.
"""

from typing import Any

import casadi as ca
import numpy as np

from servogen.derive.formulation import Formulation
from servogen.derive.lower import parameter_defaults
from servogen.errors import SceneError
from servogen.ir.evaluate import evaluate
from servogen.ir.program import Program, only
from servogen.ir.rounding import rounding_bounds
from servogen.optimise.passes import optimise
from servogen.optimise.value_numbering import number_values
from servogen.results import FloatArray
from servogen.scene.constraints import expression_of
from servogen.scene.samples import Samples
from servogen.scene.scene import Scene


def survey_reach(samples: Samples, formulation: Formulation, lowered: Program) -> tuple[str, ...]:
    """SceneError naming a constraint whose row is identically zero; a remark naming rows that are never independent.

    A row is identically zero when it is within its own rounding error of zero at every state drawn. lowered: the
    formulation's program.
    """
    scene, name = formulation.scene, formulation.scene.system.reach
    labels = _row_labels(scene)
    owners = [c for c in scene.constraints for _ in range(c.size)]
    program = number_values(optimise(only(lowered, name)))
    states = samples.examined | parameter_defaults(scene)
    values = evaluate(program, states)[name]
    bounds = rounding_bounds(program, states, "float64")[name].reshape(-1, *formulation[name].shape)
    good = np.all(np.isfinite(values), axis=(1, 2)) & np.all(np.isfinite(bounds), axis=(1, 2))
    if not np.any(good):
        raise SceneError(f"{name} is not finite at any state drawn from the domain; give a domain in which it is")
    values, bounds = values[good], bounds[good]
    for i, label in enumerate(labels):
        if np.all(np.abs(values[:, i, :]) <= 2 * bounds[:, i, :]):
            raise SceneError(
                f"{label} does not reach the controls: its row of {name} is identically zero. "
                + _remedy(scene, owners[i])
            )
    return _dependence(name, labels, values) if scene.rows <= formulation[name].size2() else ()


def _remedy(scene: Scene, constraint: Any) -> str:
    expression, mech = expression_of(constraint), scene.mechanism
    moving = [s for s in (mech.q, mech.u, mech.t) if s is not None]
    if not any(ca.depends_on(expression, s) for s in (*moving, mech.tau)):
        return "It depends on no state: write it as a function of q and u"
    if constraint.order == 1 and not ca.depends_on(expression, ca.vertcat(mech.u, mech.tau)):
        return "It is a function of q alone: declare it as sg.Holonomic, whose second derivative the controls reach"
    return (
        "Its relative degree is higher, or no control moves it at all; constrain a quantity that the controls change "
        "sooner, such as its derivative"
    )


def survey_values(samples: Samples, formulation: Formulation) -> None:
    """SceneError naming the constraint, or else the quantity, that is a finite number at no state drawn."""
    scene = formulation.scene
    symbol = scene.system.constraint
    named = [(f"constraint {c.name!r}: {symbol}", expression_of(c)) for c in scene.constraints]
    named += [(q.name, q.expression) for q in formulation.quantities if q.name not in (symbol, scene.system.reach)]
    for what, expression in named:
        if not np.any(np.all(np.isfinite(samples.values(expression)), axis=(1, 2))):
            raise SceneError(f"{what} is not finite at any state drawn from the domain; give a domain in which it is")


def _row_labels(scene: Scene) -> list[str]:
    labels = []
    for c in scene.constraints:
        labels += [f"constraint {c.name!r}" + (f", row {k}" if c.size > 1 else "") for k in range(c.size)]
    return labels


def _dependence(name: str, labels: list[str], values: FloatArray) -> tuple[str, ...]:
    norms = np.linalg.norm(values, axis=2, keepdims=True)
    rows = values / np.where(norms == 0, 1, norms)
    m = len(labels)
    if max(np.linalg.matrix_rank(value, tol=1e-9) for value in rows) == m:
        return ()
    cosines = np.abs(np.einsum("nik,njk->nij", rows, rows))
    parallel = [
        f"{labels[i]} and {labels[j]}"
        for i in range(m)
        for j in range(i + 1, m)
        if np.min(cosines[:, i, j]) > 1 - 1e-12
    ]
    which = "; ".join(parallel) if parallel else ", ".join(labels)
    return (f"the rows of {name} can never be independent ({which}): drop one, or accept the least-squares answer",)
