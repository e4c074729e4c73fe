"""Exact rational truth for the pseudo-inverse: floating-point inputs are dyadic rationals (numerics.md: Truth)."""

from typing import Any

import flint
import numpy as np

from servogen.results import FloatArray

Matrix = Any
"""flint.fmpq_mat: exact, of any shape."""


def rational(A: FloatArray) -> Matrix:
    """The exact value of a finite array; a vector becomes a column."""
    A = np.asarray(A)
    if not np.isfinite(A).all():
        raise ValueError("NaN and infinity are not rational")
    A = A.reshape(-1, 1) if A.ndim == 1 else A
    rows, columns = A.shape
    return flint.fmpq_mat(rows, columns, [_fmpq(float(x)) for x in A.flat])


def pinv_full(S: Matrix) -> Matrix:
    """S+ of full rank: S^T (S S^T)^-1 if wide, (S^T S)^-1 S^T if tall. Raises ZeroDivisionError below full rank."""
    T = S.transpose()
    if S.nrows() <= S.ncols():
        return T * (S * T).inv()
    return (T * S).inv() * T


def pinv(S: Matrix) -> Matrix:
    """S+ of any S, through S = B C of full rank: C+ B+ (MacDuffee; C the nonzero rows of the echelon form)."""
    echelon, rank = S.rref()
    if rank == 0:
        return flint.fmpq_mat(S.ncols(), S.nrows())
    pivots = [next(j for j in range(S.ncols()) if echelon[i, j] != 0) for i in range(rank)]
    B = flint.fmpq_mat(S.nrows(), rank, [S[i, j] for i in range(S.nrows()) for j in pivots])
    C = flint.fmpq_mat(rank, S.ncols(), [echelon[i, j] for i in range(rank) for j in range(S.ncols())])
    return pinv_full(C) * pinv_full(B)


def pinv_product(B: Matrix, C: Matrix) -> Matrix:
    """(B C)+ = C+ B+ for B of full column rank and C of full row rank."""
    return pinv_full(C) * pinv_full(B)


def solution(S: Matrix, S_pinv: Matrix, z: Matrix, y: Matrix | None = None) -> Matrix:
    """tau = y + S+ (z - S y)."""
    return S_pinv * z if y is None else y + S_pinv * (z - S * y)


def rank(S: Matrix) -> int:
    return int(S.rank())


def rank_by_pivots(S: Matrix, rtol: float) -> int:
    """How many pivots of a QR of the rows of S (the columns where it is tall) exceed rtol times the first.

    By the diagonal pivots of the Gram matrix, which are their squares.
    """
    A = S if S.nrows() <= S.ncols() else S.transpose()
    gram = A * A.transpose()
    left, first = list(range(A.nrows())), None
    for found in range(A.nrows()):
        best = max(left, key=lambda i: gram[i, i])
        pivot = gram[best, best]
        first = pivot if first is None else first
        if pivot <= _fmpq(rtol) * _fmpq(rtol) * first:
            return found
        left.remove(best)
        for i in left:
            factor = gram[i, best] / pivot
            for j in left:
                gram[i, j] -= factor * gram[best, j]
    return int(A.nrows())


def nearest(A: Matrix) -> FloatArray:
    """The nearest doubles (overflow gives infinity); the shape is A's."""
    values = np.empty((A.nrows(), A.ncols()))
    for i in range(A.nrows()):
        for j in range(A.ncols()):
            values[i, j] = _float(A[i, j])
    return values


def difference(computed: FloatArray, exact: Matrix) -> FloatArray:
    """computed - exact, subtracted exactly and rounded last; the shape is that of `exact`."""
    return nearest(rational(computed) - exact)


def _fmpq(x: float) -> Any:
    numerator, denominator = x.as_integer_ratio()
    return flint.fmpq(numerator, denominator)


def _float(q: Any) -> float:
    try:
        return int(q.p) / int(q.q)  # Python rounds a quotient of integers correctly
    except OverflowError:
        return float("inf") if q > 0 else float("-inf")
