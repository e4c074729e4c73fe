"""The pseudo-inverse below full rank or damped, by the SVD at 50 digits."""

from collections.abc import Sequence
from typing import Any

import mpmath as mp
import numpy as np

from servogen.ir.numbers import DIGITS
from servogen.results import FloatArray


def pseudo_solution(
    S: FloatArray, z: FloatArray, y: FloatArray, rank: int, damping: float | None
) -> tuple[list[Any], float]:
    """(tau, kappa): tau = y + S_r+ (z - S_r y) of the `rank` largest singular values; numerics.md: Damping.

    S: (m, l), z: (m,), y: (l,), all exact. kappa: the condition of what was kept.
    """
    with mp.workdps(DIGITS):
        A = mp.matrix(np.asarray(S, dtype=float).tolist())
        U, sigma, V = _svd(A)
        rest = mp.matrix([mp.mpf(float(v)) for v in z]) - A * mp.matrix([mp.mpf(float(v)) for v in y])
        tau = [mp.mpf(float(v)) for v in y]
        for k in range(rank):
            along = mp.fsum(U[i, k] * rest[i] for i in range(A.rows)) * _inverse(sigma[k], damping)
            for j in range(A.cols):
                tau[j] += V[k, j] * along
        kappa = float(sigma[0] / sigma[rank - 1]) if rank else 1.0
    return tau, kappa


def pseudo_cascade(
    S: FloatArray,
    z: FloatArray,
    y: FloatArray,
    levels: Sequence[Sequence[int]],
    ranks: Sequence[int],
    damping: float | None,
) -> list[Any]:
    """The answer of priorities where each level keeps its `ranks[k]` largest singular values; damping as above.

    S: (m, l), z: (m,), y: (l,), all exact; levels: the rows of each.
    """
    l = S.shape[1]
    with mp.workdps(DIGITS):
        tau = mp.matrix([mp.mpf(float(v)) for v in y])
        still_open = mp.eye(l)
        for rows, rank in zip(map(list, levels), ranks, strict=True):
            own = mp.matrix(np.asarray(S[rows], dtype=float).tolist())
            rest = mp.matrix([mp.mpf(float(v)) for v in z[rows]]) - own * tau
            U, sigma, V = _svd(own * still_open)
            for k in range(rank):
                direction = V[k, :].T
                along = mp.fsum(U[i, k] * rest[i] for i in range(own.rows)) * _inverse(sigma[k], damping)
                tau += along * direction
                still_open -= direction * direction.T
        return list(tau)


def kept_singular_values(S: FloatArray, units: FloatArray, rtol: float) -> list[Any]:
    """What a rank policy keeps of S: its singular values, largest first; how many they are is the rank.

    The rank is that of D^-1 S with D = diag(units): its singular values above rtol times the largest. S: (m, l),
    units: (m,), powers of two.
    """
    with mp.workdps(DIGITS):
        U, sigma, V = _svd(mp.matrix((np.asarray(S, dtype=float) / units[:, None]).tolist()))
        rank = sum(1 for s in sigma if s > rtol * sigma[0])
        kept = mp.matrix(*S.shape)
        for i in range(S.shape[0]):
            for j in range(S.shape[1]):
                kept[i, j] = float(units[i]) * mp.fsum(U[i, k] * sigma[k] * V[k, j] for k in range(rank))
        return list(_svd(kept)[1])[:rank]


def smallest_singular_value(S: FloatArray) -> float:
    """sigma_min of a matrix (m, l)."""
    with mp.workdps(DIGITS):
        A = mp.matrix(np.asarray(S, dtype=float).tolist())
        return float(min(mp.svd_r(A if A.rows >= A.cols else A.T, compute_uv=False)))


def _svd(A: Any) -> tuple[Any, Any, Any]:
    """U, sigma and V^T; svd_r wants at least as many rows as columns."""
    if A.rows >= A.cols:
        return mp.svd_r(A)  # type: ignore[no-any-return]
    U, sigma, V = mp.svd_r(A.T)
    return V.T, sigma, U.T


def _inverse(sigma: Any, damping: float | None) -> Any:
    """1 / sigma, or sigma / eps^2 (2 - (sigma / eps)^2) below eps."""
    if damping is None or sigma >= damping:
        return 1 / sigma
    return sigma / damping**2 * (2 - (sigma / damping) ** 2)
