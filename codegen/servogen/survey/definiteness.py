"""Q and the weight: regular, symmetric by proof, positive definite at states of the domain."""

from typing import Any

import casadi as ca
import numpy as np

from servogen.derive.formulation import MassFindings
from servogen.errors import SceneError
from servogen.ir.program import Output, Program, live, rebuild
from servogen.optimise.passes import optimise
from servogen.optimise.value_numbering import number_values
from servogen.results import FloatArray
from servogen.scene.convert import is_identity
from servogen.scene.samples import AT_DEFAULTS, Samples

ZERO = 1e-13
"""An eigenvalue or a singular value of a matrix brought to one that is not larger is what rounding leaves of 0."""


def survey_mass(samples: Samples, model: Program) -> MassFindings:
    """What decides how Q is solved with. SceneError where it is singular at every state.

    model: the program with the output Q, as the scene writes it.
    """
    Q = samples.scene.mechanism.Q
    values = samples.values(Q)
    _check_regular(Q, values)
    symmetric = is_symmetric(model, "Q")
    positive = symmetric and all(_smallest_of_scaled(value) > ZERO for value in values)
    return MassFindings(symmetric, positive, _remarks(values[:AT_DEFAULTS]))


def survey_weight(samples: Samples, model: Program) -> None:
    """SceneError unless a weight of the user's is symmetric by proof and positive definite. model: its output is W."""
    W = samples.scene.weight
    if W is None or samples.scene.weighs_by_inverse_mass or is_identity(W):
        return
    if not is_symmetric(model, "W"):
        raise SceneError("weight is not symmetric by proof; write W[j, i] as the same expression as W[i, j]")
    for value in samples.values(W):
        if np.all(np.isfinite(value)) and not _positive_definite(value):
            raise SceneError(
                "weight is not positive definite over the domain: its smallest eigenvalue is "
                f"{_smallest_eigenvalue(value):.4g} at a state of it; add a positive diagonal, or narrow it"
            )


def is_symmetric(program: Program, name: str) -> bool:
    """Whether every pair of entries of an output is one value number after optimisation: a proof, not a comparison."""
    output = program.output(name)
    n = output.rows
    entries = [Output(f"e{i}_{j}", 1, 1, (output.nodes[n * i + j],)) for i in range(n) for j in range(n) if i != j]
    part = rebuild(program, sorted(live(program, (e.nodes[0] for e in entries))), entries)
    node = {o.name: o.nodes[0] for o in number_values(optimise(part)).outputs}
    return all(node[f"e{i}_{j}"] == node[f"e{j}_{i}"] for i in range(n) for j in range(i))


def _check_regular(Q: Any, values: FloatArray) -> None:
    n = Q.size1()
    structural = ca.sprank(ca.sparsify(Q)) < n
    finite = [value for value in values if np.all(np.isfinite(value))]
    if not finite:
        raise SceneError("Q is not finite at any state drawn from the domain; give a domain in which it is")
    generic = all(np.linalg.matrix_rank(_equilibrated(value), rtol=ZERO) < n for value in finite)
    if structural or generic:
        raise SceneError(
            f"Q is structurally singular: its rank is below {n} at every state; "
            "give each velocity parameter an inertia, or remove it from u"
        )


def _remarks(values: FloatArray) -> tuple[str, ...]:
    """On a Q that no kinetic energy has; the method does not mind."""
    finite = [value for value in values if np.all(np.isfinite(value))]
    for value in finite:
        size = np.sqrt(np.abs(np.diag(value)))
        uneven = np.abs(value - value.T) > 1e-9 * np.maximum(np.outer(size, size), np.abs(value))  # in its own units
        if np.any(uneven):
            i, j = np.argwhere(uneven)[0]
            return (f"Q is not symmetric, as a mass matrix is: Q[{i}, {j}] is not Q[{j}, {i}]; check its entries",)
    wrong = sum(_smallest_of_scaled(value) < -ZERO for value in finite)
    if wrong:
        return (
            f"Q is not positive definite at {wrong} of {len(values)} states drawn from the domain, as a mass matrix "
            "is; check its signs, or narrow the domain",
        )
    return ()


def _smallest_of_scaled(value: FloatArray) -> float:
    """Of a symmetric matrix brought to a diagonal of ones, which keeps all signs; NaN where it is not finite."""
    if not np.all(np.isfinite(value)):
        return np.nan
    size = np.sqrt(np.abs(np.diag(value)))
    size[size == 0] = 1
    return float(np.min(np.linalg.eigvalsh(value / size / size[:, None])))


def _equilibrated(value: FloatArray) -> FloatArray:
    """Rows and columns scaled to one, so that units do not look like singularity."""
    rows = np.max(np.abs(value), axis=1, keepdims=True)
    value = value / np.where(rows == 0, 1, rows)
    columns = np.max(np.abs(value), axis=0, keepdims=True)
    return np.asarray(value / np.where(columns == 0, 1, columns))


def _positive_definite(value: FloatArray) -> bool:
    """Rows and columns scaled to a unit diagonal first, so that units do not look like indefiniteness."""
    return bool(np.all(np.diag(value) > 0)) and _smallest_of_scaled(value) > ZERO


def _smallest_eigenvalue(value: FloatArray) -> float:
    """As it is told: 0 for what rounding makes of 0."""
    eigenvalues = np.linalg.eigvalsh(value)
    smallest = float(eigenvalues[0])
    return smallest if abs(smallest) > ZERO * np.max(np.abs(eigenvalues)) else 0.0
