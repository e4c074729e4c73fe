"""The relative degree of a constraint's rows: which of their time derivatives is the first that the controls reach."""

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from servogen.derive.formulation import MassFindings, Quantity
from servogen.derive.lie import Drift
from servogen.derive.lower import lower_quantities, parameter_defaults
from servogen.derive.passive import respond
from servogen.derive.rows import Behind, behind
from servogen.errors import SceneError
from servogen.ir.evaluate import evaluate
from servogen.ir.program import Program
from servogen.ir.rounding import rounding_bounds
from servogen.optimise.passes import optimise
from servogen.optimise.value_numbering import number_values
from servogen.results import FloatArray
from servogen.scene.constraints import Constraint, Output, expression_of
from servogen.scene.samples import Samples

LARGEST = 20_000
"""CasADi operations of a derivative beyond which nobody looks for the next one."""


def survey_degree(samples: Samples, found: MassFindings) -> None:
    """SceneError naming a row of an sg.Output whose derivatives below the order of its Theta reach the controls."""
    apart = behind(samples, found)
    for c in samples.scene.constraints:
        if not isinstance(c, Output) or c.order == 1:
            continue
        own = apart if apart is not None and c.name in apart.names else None
        for label, degree in zip(labels_of(c), row_degrees(samples, found, c, c.order - 1, own), strict=True):
            if degree is not None:
                way = "" if own is None else ", even with the other rows taken out"
                raise SceneError(
                    f"{label}: Theta has {c.order} entries, but the controls reach its {ordinal(degree)} derivative "
                    f"already{way}: its relative degree is {degree}; give Theta={thetas_of(degree)}, in an sg.Output "
                    "of its own where other rows have another degree"
                )


def row_degrees(
    samples: Samples, found: MassFindings, constraint: Constraint, most: int, apart: Behind | None = None
) -> tuple[int | None, ...]:
    """The relative degree of each row, up to `most`; None for one that no control reaches until then.

    apart: the motion in which other rows are taken out; None: the scene's own.

    The rates of references count as far as they are declared; no control reaches a row sooner or later for them.
    Nor is a row followed beyond LARGEST operations.
    """
    what = f"constraint {constraint.name!r}"
    G = samples.scene.mechanism.G if apart is None else apart.G
    drift = Drift(samples, found, undeclared_rest=True) if apart is None else apart.drift
    value = expression_of(constraint)
    degrees: list[int | None] = [None] * constraint.size
    for k in range(1, most + 1):
        W, *_ = respond(samples, found, drift.gradient(value))
        gone = vanishing(samples, ca.mtimes(W, G))
        for row in range(constraint.size):
            if degrees[row] is None and not gone[row]:
                degrees[row] = k
        if None not in degrees or k == most:
            break
        value = drift.rate(value, what)
        if ca.Function("size", ca.symvar(value), [value]).n_instructions() > LARGEST:
            break
    return tuple(degrees)


def vanishing(samples: Samples, matrix: Any) -> NDArray[np.bool_]:
    """Which rows of an SX are identically zero."""
    program = lower_quantities(samples.scene, [Quantity("reach", matrix, "", "")])
    values, bounds = values_and_bounds(samples, number_values(optimise(program)), "reach", matrix.shape)
    return vanishing_rows(values, bounds)


def values_and_bounds(
    samples: Samples, program: Program, name: str, shape: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """An output at the states examined, and its rounding errors: (N, rows, columns) of the N where both are finite."""
    states = samples.examined | parameter_defaults(samples.scene)
    values = evaluate(program, states)[name]
    bounds = rounding_bounds(program, states, "float64")[name].reshape(-1, *shape)
    good = np.all(np.isfinite(values), axis=(1, 2)) & np.all(np.isfinite(bounds), axis=(1, 2))
    return values[good], bounds[good]


def vanishing_rows(values: FloatArray, bounds: FloatArray) -> NDArray[np.bool_]:
    """Rows that are within their own rounding error of zero at every state."""
    gone: NDArray[np.bool_] = np.all(np.abs(values) <= 2 * bounds, axis=(0, 2))
    return gone


def labels_of(constraint: Constraint) -> list[str]:
    """What each of its rows is called in a message."""
    return [f"constraint {constraint.name!r}" + (f", row {k}" if constraint.size > 1 else "")
            for k in range(constraint.size)]  # fmt: skip


def ordinal(k: int) -> str:
    """1st, 2nd, 3rd, 4th, ..."""
    return f"{k}{('th', 'st', 'nd', 'rd')[k if k < 4 else 0]}"


def thetas_of(degree: int) -> str:
    """What to write for Theta."""
    return f"[{', '.join(f'T{k}' for k in range(degree))}]"
