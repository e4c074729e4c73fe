"""The weight W of the minimum: what turns (tau - y)^T W (tau - y) into a plain sum of squares."""

from typing import Any

import casadi as ca

from servogen.derive.formulation import MassFactor, MassTreatment, Weight
from servogen.errors import SceneError
from servogen.scene.convert import is_identity
from servogen.scene.scene import Scene


def weigh(scene: Scene, mass: MassTreatment) -> Weight | None:
    """The factor of the scene's weight, or None. A W of the user's was found symmetric and positive definite.

    mass: how Q is solved with; W = Q^-1 takes its factors. SceneError where Q has none.
    """
    if scene.weighs_by_inverse_mass:
        return _weigh_by_inverse_mass(mass)
    W = scene.weight
    if W is None or is_identity(W):
        return None
    L = _cholesky(W)
    N = _inverse_transpose(L)
    entries, pattern = _nonzeros(N)
    diagonal = len(entries) == W.size1()
    reason = "weight: diagonal, one factor a control" if diagonal else "weight: one Cholesky factor, no inverse of W"
    return Weight(N, lambda X: ca.mtimes(L.T, X), ca.vertcat(*entries), pattern, reason)


def _weigh_by_inverse_mass(mass: MassTreatment) -> Weight | None:
    """W = Q^-1 = N^-T N^-1 with N = L sqrt(D) from Q = L D L^T: neither Q nor W is inverted or factorised again."""
    if mass.factor is None:
        raise SceneError(
            f"weight='inverse_mass' needs a Q that is symmetric and positive definite; {mass.reason.split(':')[0]}. "
            "Write Q[j, i] as the same expression as Q[i, j], narrow the domain, or give a weight of your own"
        )
    factor = mass.factor
    if mass.method == "identity":
        return None
    root = [ca.sqrt(d) for d in factor.D]
    n = len(root)
    N = ca.SX(n, n)
    for i, row in enumerate(factor.L):
        for j in range(i + 1):
            if not row[j].is_zero():
                N[factor.order[i], factor.order[j]] = row[j] * root[j]
    entries, pattern = _nonzeros(N)
    reason = f"W = Q^-1, its factor is that of Q: {'a diagonal' if mass.method == 'diagonal' else 'L sqrt(D)'}"
    return Weight(N, lambda X: _solve_half(factor, root, X), ca.vertcat(*entries), pattern, reason, of_mass=True)


def _solve_half(factor: MassFactor, root: list[Any], right: Any) -> Any:
    """N^-1 right by substitution: L first, as the solve with Q does, then sqrt(D)."""
    dense = ca.densify(right)
    rows: list[Any] = []
    for i, k in enumerate(factor.order):
        row = dense[k, :]
        for j in range(i):
            if not factor.L[i][j].is_zero():
                row = row - factor.L[i][j] * rows[j]
        rows.append(row)
    solution = [row / root[i] for i, row in enumerate(rows)]
    return ca.vertcat(*(row for _, row in sorted(zip(factor.order, solution, strict=True), key=lambda pair: pair[0])))


def _cholesky(W: Any) -> Any:
    """L, lower triangular, with L L^T = W; structural zeros stay zeros."""
    l = W.size1()
    L = ca.SX(l, l)
    for j in range(l):
        pivot = W[j, j] - sum((L[j, k] ** 2 for k in range(j) if not L[j, k].is_zero()), ca.SX(0))
        L[j, j] = ca.sqrt(pivot)
        for i in range(j + 1, l):
            products = [L[i, k] * L[j, k] for k in range(j) if not (L[i, k].is_zero() or L[j, k].is_zero())]
            entry = W[i, j] - sum(products, ca.SX(0))
            if not entry.is_zero():
                L[i, j] = entry / L[j, j]
    return ca.sparsify(L)


def _inverse_transpose(L: Any) -> Any:
    """L^-T, upper triangular, by substitution."""
    l = L.size1()
    inverse = ca.SX(l, l)  # L^-1, column by column
    for j in range(l):
        inverse[j, j] = 1 / L[j, j]
        for i in range(j + 1, l):
            products = [
                L[i, k] * inverse[k, j] for k in range(j, i) if not (L[i, k].is_zero() or inverse[k, j].is_zero())
            ]
            if products:
                inverse[i, j] = -sum(products, ca.SX(0)) / L[i, i]
    return ca.sparsify(inverse).T


def _nonzeros(N: Any) -> tuple[list[Any], tuple[tuple[tuple[int, int], ...], ...]]:
    entries: list[Any] = []
    pattern = []
    for i in range(N.size1()):
        row = []
        for j in range(N.size2()):
            if not N[i, j].is_zero():
                row.append((len(entries), j))
                entries.append(N[i, j])
        pattern.append(tuple(row))
    return entries, tuple(pattern)
