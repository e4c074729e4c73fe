"""QR with pivots as textbooks have it, and what it keeps of a matrix: the rank policy of method "cod" once more."""

import numpy as np

from servogen.results import FloatArray


def reduced(A: FloatArray) -> tuple[FloatArray, FloatArray, list[int]]:
    """Q, R and the order of the columns of A, A[:, order] = Q R, the longest remainder first (Businger and Golub 1965).

    A: (p, n), Q: (p, p), R: (p, n), by Householder's reflections; ties go to the lowest column.
    """
    R, Q, order = A.copy(), np.eye(len(A)), list(range(A.shape[1]))
    for k in range(min(A.shape)):
        best = k + int(np.argmax(np.linalg.norm(R[k:, k:], axis=0)))
        R[:, [k, best]], order[k], order[best] = R[:, [best, k]], order[best], order[k]
        v = R[k:, k].copy()
        length = np.linalg.norm(v)
        if length == 0:
            break
        v[0] += length if v[0] >= 0 else -length
        v /= np.linalg.norm(v)
        R[k:] -= 2 * np.outer(v, v @ R[k:])
        Q[:, k:] -= 2 * np.outer(Q[:, k:] @ v, v)
    return Q, R, order


def truncated(S: FloatArray, rtol: float) -> tuple[FloatArray, int]:
    """(S_r, rank): S, (m, l), without what is left of its rows (of a tall one its columns) below the pivots that count.

    rank is the number of these, longer than rtol times the first.
    """
    A = S.T if S.shape[0] <= S.shape[1] else S
    Q, R, order = reduced(A)
    pivots = np.abs(np.diag(R))
    small = pivots <= rtol * pivots[0]
    rank = int(np.argmax(small)) if small.any() else len(pivots)
    kept = np.zeros_like(A)
    kept[:, order] = Q[:, :rank] @ np.triu(R)[:rank]
    return (kept.T if A is not S else kept), rank
