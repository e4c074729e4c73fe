"""Ideal control forces: G tau = R with the reaction R of an ideal passive constraint, Eqs. (13)-(17), (26)."""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from servogen.derive.answer import controlling
from servogen.derive.formulation import Formulation, MassFindings, Quantity
from servogen.derive.mass import solve_square, solve_with_mass
from servogen.derive.rows import constraint_rows
from servogen.derive.servo import free_quantities
from servogen.derive.weight import weigh
from servogen.law.law import Routine
from servogen.law.steps import Evaluate, React
from servogen.scene.samples import Samples

_REACT = React("R", "reaction", "reaction_matrix", "reaction_right", "J")
_REACTION = ("reaction_matrix", "reaction_right", "J")


def derive_ideal(samples: Samples, found: MassFindings) -> Formulation:
    """psi, T and F (for verification), and what R and tau are computed from."""
    scene = samples.scene
    mech = scene.mechanism
    rows = constraint_rows(scene)
    psi, J = rows.psi, rows.J
    b = rows.prescribed - rows.X
    W_transposed, mass = solve_with_mass(scene, found, J.T, transposed=True)
    W = W_transposed.T
    T, F = nonminimal_form(mech.Q, mech.P, J, b, dependent_columns(samples, J))
    weight = weigh(scene, mass)
    quantities = [
        Quantity("psi", psi, "Eqs. (3), (11)", "psi(q, u, t)"),
        Quantity("T", T, "Eqs. (15), (26)", "[I A^T] Q over the constraint rows"),
        Quantity("F", F, "Eqs. (15), (26)", "[I A^T] P over the right side of the constraint rows"),
        Quantity("reaction_matrix", ca.mtimes(W, J.T), "Eq. (17)", "J Q^-1 J^T", needs_mass=True),
        Quantity("reaction_right", b - ca.mtimes(W, mech.P), "Eq. (17)", "b - J Q^-1 P", needs_mass=True),
        Quantity("J", J, "Eqs. (5), (12)", "psi_u, or psi_q C"),
        Quantity("G", mech.G, "Eq. (2)", "G"),
        *free_quantities(scene, mech.G, "G", "Eq. (16)", weight),
    ]
    reaction = Routine("R", (Evaluate(_REACTION), _REACT), "R", info=False)
    entries = (("psi",), ("T",), ("F",))
    law = controlling(scene, quantities, weight, entries, before=(_REACT,), routines=(reaction,))
    law = replace(law, solvers=(*law.solvers, ("reaction", (scene.rows, scene.rows))))
    return Formulation(scene, tuple(quantities), mass, law, weight)


_EVEN = 1e-9
"""Columns whose scores differ by less, relative to the larger, are even: rounding does not choose among them."""


def dependent_columns(samples: Samples, J: Any) -> tuple[int, ...]:
    """The m entries of u taken as dependent, Eq. (26): by pivoting over states of the domain, all at once.

    At each step the column whose part outside those taken is largest over the states.
    """
    values = samples.values(J)
    values = values[np.all(np.isfinite(values), axis=(1, 2))]
    size = np.linalg.norm(values, axis=(1, 2), keepdims=True)
    rest = values / np.where(size == 0, 1, size)
    taken: list[int] = []
    for _ in range(J.size1()):
        lengths = np.sqrt(np.sum(rest**2, axis=1))  # (states, columns)
        score = np.exp(np.mean(np.log(lengths + 1e-12), axis=0))
        score[taken] = -1.0
        best = int(np.argmax(score > (1 - _EVEN) * np.max(score)))  # the first of those that are even
        taken.append(best)
        column = rest[:, :, best]
        column = column / np.maximum(np.linalg.norm(column, axis=1, keepdims=True), 1e-300)
        rest = rest - column[:, :, None] * np.einsum("si,sij->sj", column, rest)[:, None, :]
    return tuple(sorted(taken))


def nonminimal_form(Q: Any, P: Any, J: Any, b: Any, dependent: tuple[int, ...]) -> tuple[Any, Any]:
    """T (n x n) and F (n) of T u' = F, Eqs. (15), (26), with u_D' = A u_I' + B, A = -J_D^-1 J_I."""
    n = Q.size1()
    independent = [j for j in range(n) if j not in dependent]
    Z = ca.SX(n, len(independent))  # u' = Z u_I' + ...
    for k, j in enumerate(independent):
        Z[j, k] = 1
    if independent:
        A = -solve_square(J[:, list(dependent)], J[:, independent])
        for k, j in enumerate(dependent):
            Z[j, :] = A[k, :]
    T = ca.vertcat(ca.mtimes(Z.T, Q), J)
    F = ca.vertcat(ca.mtimes(Z.T, P), b)
    return T, F
