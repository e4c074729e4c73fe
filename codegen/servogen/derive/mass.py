"""Solving with the mass matrix Q: never its inverse, only one factorisation of what is structurally there.

LDL^T where Q was found symmetric and positive definite over the domain (survey/definiteness.py), LU with pivoting
otherwise.
"""

from typing import Any

import casadi as ca

from servogen.derive.formulation import MassFactor, MassFindings, MassTreatment
from servogen.errors import SceneError
from servogen.scene.scene import Scene

Rows = list[list[Any]]


def solve_with_mass(
    scene: Scene, found: MassFindings, right: Any, transposed: bool = False
) -> tuple[Any, MassTreatment]:
    """X with Q X = right (Q^T X = right if transposed), and how it was found. right: SX, n_u x k."""
    Q = scene.mechanism.Q
    diagonal = _is_diagonal(Q)
    if not diagonal and not found.symmetric:
        return _solve_lu(Q.T if transposed else Q, right, "Q is not symmetric by proof")
    if diagonal:
        return _solve_diagonal(Q, right, found.positive_definite)
    if not found.positive_definite:
        return _solve_lu(Q, right, "Q is symmetric but not positive definite over the domain")
    return _solve_ldlt(Q, right)


def solve_definite(matrix: Any, right: Any) -> tuple[Any, MassTreatment]:
    """X with matrix X = right by one LDL^T, for a matrix known to be symmetric and positive definite; its pivots."""
    return _solve_ldlt(matrix, right)


def solve_semidefinite(matrix: Any, right: Any, rank: int, weights: list[float]) -> tuple[Any, Any, list[Any]]:
    """An X with matrix X = right for a symmetric positive semidefinite matrix of that rank everywhere, a basis of its
    range (n x rank), and the pivots.

    Each pivot is the largest diagonal entry left, times its row's weight, chosen by selection so that the code has no
    branches; which entry that is may change from state to state. right: in the matrix's range. The pivots are relative.
    """
    n, rest, columns = matrix.size1(), ca.densify(matrix), []
    chosen: list[list[Any]] = []
    shares, pivots, relative = [], [], []
    for _ in range(rank):
        size, which = rest[0, 0] * weights[0], [ca.SX(int(i == 0)) for i in range(n)]
        for i in range(1, n):
            larger = rest[i, i] * weights[i] > size
            size = ca.if_else(larger, rest[i, i] * weights[i], size)
            which = [ca.if_else(larger, int(k == i), e) if k <= i else e for k, e in enumerate(which)]
        column = ca.vertcat(*(_chosen(which, rest[i, :]) for i in range(n)))
        pivot = _chosen(which, column)
        share = ca.horzcat(*(_chosen(which, right[:, c]) for c in range(right.size2()))) / pivot
        right = right - ca.mtimes(column, share)
        rest = ca.triu2symm(ca.triu(rest - ca.mtimes(column, column.T) / pivot))
        chosen.append(which)
        columns.append(column)
        shares.append(share)
        pivots.append(pivot)
        relative.append(size)
    entries: list[Any] = []
    for k in range(rank - 1, -1, -1):  # the unknowns of the rows chosen, the last first
        later = zip(chosen[k + 1 :], entries, strict=True)
        known = sum((_chosen(which, columns[k]) / pivots[k] * x for which, x in later), ca.SX.zeros(shares[k].shape))
        entries.insert(0, shares[k] - known)
    solution = sum(ca.mtimes(ca.vertcat(*which), x) for which, x in zip(chosen, entries, strict=True))
    return solution, ca.horzcat(*columns), relative


def _chosen(which: list[Any], values: Any) -> Any:
    """The value whose flag in `which` is one."""
    return sum(ca.if_else(flag, value, 0) for flag, value in zip(which, ca.vec(values).elements(), strict=True))


def solve_square(matrix: Any, right: Any) -> Any:
    """X with matrix X = right for any square matrix, without a test of its pivots."""
    if _is_diagonal(matrix):
        return _matrix([[_over(e, matrix[k, k]) for e in row] for k, row in enumerate(_entries(right))])
    return _solve_lu(matrix, right, "")[0]


def _is_diagonal(Q: Any) -> bool:
    return all(Q[i, j].is_zero() for i in range(Q.size1()) for j in range(Q.size2()) if i != j)


def _entries(matrix: Any) -> Rows:
    dense = ca.densify(matrix)
    return [[dense[i, j] for j in range(dense.size2())] for i in range(dense.size1())]


def _matrix(rows: Rows) -> Any:
    return ca.vertcat(*(ca.horzcat(*row) for row in rows))


def _minus(a: Any, b: Any, c: Any) -> Any:
    """a - b c, without a trace where b or c is zero."""
    return a if b.is_zero() or c.is_zero() else a - b * c


def _over(a: Any, b: Any) -> Any:
    return a if a.is_zero() else a / b


def _guards(pivots: list[Any], scales: list[Any], positive: bool) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """The pivots that can only be judged at run time; constant ones are judged here."""
    kept = []
    for k, (pivot, scale) in enumerate(zip(pivots, scales, strict=True)):
        if pivot.is_constant() and scale.is_constant():
            if float(pivot) <= 0 and positive:
                raise SceneError(f"Q is singular or not positive definite: pivot {k} is {float(pivot)}")
        else:
            kept.append((pivot, scale))
    return tuple(p for p, _ in kept), tuple(s for _, s in kept)


def _solve_diagonal(Q: Any, right: Any, positive: bool) -> tuple[Any, MassTreatment]:
    diagonal = [Q[k, k] for k in range(Q.size1())]
    if all(d.is_one() for d in diagonal):
        return right, MassTreatment("identity", "Q is the identity: no solve", factor=_diagonal_factor(diagonal))
    solution = [[_over(e, d) for e in row] for row, d in zip(_entries(right), diagonal, strict=True)]
    for k, d in enumerate(diagonal):
        if d.is_constant() and float(d) == 0:
            raise SceneError(f"Q is structurally singular: its diagonal entry {k} is zero")
    signed = diagonal if positive else [ca.fabs(d) for d in diagonal]
    pivots, scales = _guards(signed, [ca.SX(0)] * len(diagonal), positive)
    reason = "Q is diagonal: one division per row"
    factor = _diagonal_factor(diagonal) if positive else None
    return _matrix(solution), MassTreatment("diagonal", reason, pivots, scales, positive, factor=factor)


def _diagonal_factor(diagonal: list[Any]) -> MassFactor:
    n = len(diagonal)
    unit = tuple(tuple(ca.SX(int(i == j)) for j in range(n)) for i in range(n))
    return MassFactor(tuple(range(n)), unit, tuple(diagonal))


def _solve_ldlt(Q: Any, right: Any) -> tuple[Any, MassTreatment]:
    n = Q.size1()
    order = _elimination_order(Q, right)
    q, x = _entries(Q[order, order]), _entries(right[order, :])
    L: Rows = [[ca.SX(0)] * n for _ in range(n)]
    weighted: Rows = [[ca.SX(0)] * n for _ in range(n)]  # L D
    d: list[Any] = []
    for j in range(n):
        pivot = q[j][j]
        for k in range(j):
            pivot = _minus(pivot, L[j][k], weighted[j][k])
        d.append(pivot)
        for i in range(j + 1, n):
            entry = q[i][j]
            for k in range(j):
                entry = _minus(entry, L[i][k], weighted[j][k])
            weighted[i][j] = entry
            L[i][j] = _over(entry, pivot)
    for c in range(right.size2()):
        for i in range(n):
            for k in range(i):
                x[i][c] = _minus(x[i][c], L[i][k], x[k][c])
        for i in range(n):
            x[i][c] = _over(x[i][c], d[i])
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                x[i][c] = _minus(x[i][c], L[k][i], x[k][c])
    pivots, scales = _guards(d, [q[k][k] for k in range(n)], positive=True)
    reason = "Q is symmetric by proof and positive definite over the domain: one LDL^T"
    if order != list(range(n)):
        reason += ", the last velocity parameter eliminated first"
    solution: list[Any] = [row for _, row in sorted(zip(order, x, strict=True), key=lambda pair: pair[0])]
    unit = tuple(tuple(ca.SX(1) if i == j else L[i][j] for j in range(n)) for i in range(n))
    factor = MassFactor(tuple(order), unit, tuple(d))
    return _matrix(solution), MassTreatment("LDL^T", reason, pivots, scales, True, factor=factor)


def _elimination_order(Q: Any, right: Any) -> list[int]:
    """First to last, or last to first, whichever takes fewer operations.

    Of a tree numbered from the root, the latter fills no zero entry: Featherstone (2008), Section 6.5.
    """
    n = Q.size1()
    forward = list(range(n))
    return min((forward, forward[::-1]), key=lambda order: _ldlt_operations(Q, right, order))


def _ldlt_operations(Q: Any, right: Any, order: list[int]) -> int:
    """Multiplications of the factorisation and the solves, from the zero pattern alone."""
    n = len(order)
    filled = [[not Q[i, j].is_zero() for j in order] for i in order]
    count = 0
    for k in range(n):
        below = [i for i in range(k + 1, n) if filled[i][k]]
        count += len(below) + len(below) * (len(below) + 1) // 2
        for i in below:
            for j in below:
                filled[i][j] = True
    for c in range(right.size2()):
        x = [not right[i, c].is_zero() for i in order]
        for k in range(n):
            below = [i for i in range(k + 1, n) if filled[i][k]]
            count += (len(below) if x[k] else 0) + len(below)
            for i in below:
                x[i] = x[i] or x[k]
    return count


def _solve_lu(Q: Any, right: Any, reason: str) -> tuple[Any, MassTreatment]:
    """Gaussian elimination, rows exchanged by selection so that the code has no branches."""
    n = Q.size1()
    a = [q + r for q, r in zip(_entries(Q), _entries(right), strict=True)]
    width = len(a[0])
    pivots, scales = [], []
    for k in range(n):
        for i in range(k + 1, n):
            if a[i][k].is_zero():
                continue
            swap = ca.fabs(a[i][k]) > ca.fabs(a[k][k])
            for c in range(k, width):
                upper, lower = a[k][c], a[i][c]
                a[k][c], a[i][c] = ca.if_else(swap, lower, upper), ca.if_else(swap, upper, lower)
        scale = ca.SX(0)
        for i in range(n):
            scale = ca.fmax(scale, ca.fabs(Q[i, k])) if not Q[i, k].is_zero() else scale
        pivots.append(ca.fabs(a[k][k]))
        scales.append(scale)
        for i in range(k + 1, n):
            factor = _over(a[i][k], a[k][k])
            for c in range(k + 1, width):
                a[i][c] = _minus(a[i][c], factor, a[k][c])
    x = [row[n:] for row in a]
    for c in range(width - n):
        for i in range(n - 1, -1, -1):
            for k in range(i + 1, n):
                x[i][c] = _minus(x[i][c], a[i][k], x[k][c])
            x[i][c] = _over(x[i][c], a[i][i])
    kept, kept_scales = _guards(pivots, scales, positive=True)
    return _matrix(x), MassTreatment("pivoted LU", f"{reason}: LU with row exchanges", kept, kept_scales)
