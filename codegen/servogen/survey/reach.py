"""Are the constraints numbers, and do they reach the controls?

Found are values that exist nowhere, and rows of S (or A) that vanish identically or can never be independent.
"""

from collections.abc import Iterator, Sequence

import casadi as ca
import numpy as np

from servogen.derive.formulation import Formulation, MassFindings
from servogen.errors import SceneError
from servogen.ir.program import Program, only
from servogen.optimise.passes import optimise
from servogen.optimise.value_numbering import number_values
from servogen.results import FloatArray
from servogen.scene.constraints import Constraint, expression_of
from servogen.scene.samples import Samples
from servogen.scene.scene import Scene
from servogen.survey.degree import labels_of, ordinal, row_degrees, thetas_of, values_and_bounds, vanishing_rows
from servogen.survey.extension import extend


def survey_reach(samples: Samples, formulation: Formulation, lowered: Program, found: MassFindings) -> tuple[str, ...]:
    """SceneError naming a constraint whose row is identically zero; a remark naming rows that are never independent.

    lowered: the formulation's program. found: of Q.
    """
    scene, name = formulation.scene, formulation.scene.system.reach
    labels = [label for c in scene.constraints for label in labels_of(c)]
    program, shape = number_values(optimise(only(lowered, name))), formulation[name].shape
    values, bounds = values_and_bounds(samples, program, name, shape)
    if len(values) == 0:
        raise SceneError(f"{name} is not finite at any state drawn from the domain; give a domain in which it is")
    gone = np.flatnonzero(vanishing_rows(values, bounds))
    if len(gone):
        raise SceneError(
            f"{labels[gone[0]]} does not reach the controls: its row of {name} is identically zero. "
            + _remedy(samples, found, int(gone[0]))
        )
    return _dependence(scene, labels, values) if scene.rows <= shape[1] else ()


def _remedy(samples: Samples, found: MassFindings, row: int) -> str:
    """What to do about a row, counted through all constraints."""
    scene = samples.scene
    constraint, row = next(_owners(scene.constraints, row))
    expression, mech = expression_of(constraint), scene.mechanism
    moving = [s for s in (mech.q, mech.u, mech.t) if s is not None]
    if not any(ca.depends_on(expression, s) for s in (*moving, mech.tau)):
        return "It depends on no state: write it as a function of q and u"
    if not scene.system.of_outputs:
        free = constraint.order == 1 and not ca.depends_on(expression, ca.vertcat(mech.u, mech.tau))
        return "It is a function of q alone: declare it as sg.Holonomic" if free else "Constrain what does change"
    most = mech.q.size1() + mech.u.size1()
    degree = row_degrees(samples, found, constraint, most)[row]
    if degree is None:
        held = ", or the passive constraints leave it no motion" if mech.passive else ""
        return f"No control moves it, however often it is differentiated{held}; constrain what the controls change"
    if degree == 2 and not ca.depends_on(expression, mech.u):  # what a beginner does, in words without degrees
        return "It is a function of q alone: declare it as sg.Holonomic, whose second derivative the controls reach"
    return (
        f"Its relative degree is {degree}, not {constraint.order}: the controls reach its {ordinal(degree)} derivative "
        f"first; make it an sg.Output with Theta={thetas_of(degree)}, or constrain a quantity that they change sooner"
    )


def _owners(constraints: Sequence[Constraint], row: int) -> Iterator[tuple[Constraint, int]]:
    """The constraint of a row, and the row's place in it."""
    for c in constraints:
        if row < c.size:
            yield c, row
            return
        row -= c.size


def survey_values(samples: Samples, formulation: Formulation) -> None:
    """SceneError naming the constraint, or else the quantity, that is a finite number at no state drawn."""
    scene = formulation.scene
    symbol = scene.system.constraint
    named = [(f"constraint {c.name!r}: {symbol}", expression_of(c)) for c in scene.constraints]
    named += [(q.name, q.expression) for q in formulation.quantities if q.name not in (symbol, scene.system.reach)]
    for what, expression in named:
        if not np.any(np.all(np.isfinite(samples.values(expression)), axis=(1, 2))):
            raise SceneError(f"{what} is not finite at any state drawn from the domain; give a domain in which it is")


def _dependence(scene: Scene, labels: list[str], values: FloatArray) -> tuple[str, ...]:
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
    told = f"the rows of {scene.system.reach} can never be independent ({which}): "
    if scene.system.of_outputs:
        found = extend(scene)
        if not found.reason:
            remedies = [f"{labels[k]} an sg.Output with Theta={thetas_of(found.degrees[k] or 0)}"
                        for k in sorted(found.dependent)]  # fmt: skip
            return (
                f"{told}the controls reach some by way of others alone; make {' and '.join(remedies)}, of its own "
                "beside the rest, or accept the least-squares answer",
            )
    return (f"{told}drop one, or accept the least-squares answer",)
