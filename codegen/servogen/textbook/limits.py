"""The answer within limits as a textbook has it: two least-squares problems, one after the other.

Stark and Parker's bounded least squares (scipy) says what the rows of S can reach; among the answers that reach it the
one nearest to y is Lawson and Hanson's least distance programming, through their nonnegative least squares.
"""

import dataclasses

import numpy as np
from scipy.optimize import lsq_linear, nnls

from servogen.results import FloatArray, Info, Path, Status
from servogen.textbook.policy import Policy
from servogen.textbook.pseudo_inverse import consistent, counted_rows, solve


def solve_within(
    S: FloatArray,
    z: FloatArray,
    y: FloatArray | None,
    lower: FloatArray,
    upper: FloatArray,
    policy: Policy,
    last: FloatArray | None = None,
) -> tuple[FloatArray, Info]:
    """tau of shape (l,) and its info: the answer of `solve` where that lies within the limits, else the best there.

    lower, upper: (l,), -inf and inf for none. Where the status is negative, tau is `last`, or zeros. Built for systems
    with numbers of ordinary size, in double; raises ValueError for wrong shapes.
    """
    l = policy.l
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    if lower.shape != (l,) or upper.shape != (l,):
        raise ValueError(f"limits have shapes {lower.shape} and {upper.shape}, expected ({l},)")
    tau, info = solve(S, z, y, policy, last)
    if info.status < 0 and info.status != Status.OVERFLOW:
        return tau, info
    if info.status >= 0 and np.all((lower <= tau) & (tau <= upper)):
        return tau, dataclasses.replace(info, active=_mask(tau, lower, upper))
    if not np.all((lower <= upper) & (lower < np.inf) & (upper > -np.inf)):
        untouched = np.zeros(l) if last is None else np.array(last, dtype=float)
        return untouched, Info(Status.LIMITS_CROSSED, Path.NONE, 0, 0, 0.0, 0.0, scale=0.0)
    free = np.zeros(l) if y is None else np.asarray(y, dtype=float)
    counted = counted_rows(np.asarray(S, dtype=float), policy)
    tau = _nearest(counted, free, _reaching(counted, np.asarray(z, dtype=float), lower, upper), lower, upper)
    tau = _sharpened(counted, np.asarray(z, dtype=float), free, tau, lower, upper)
    residual = np.asarray(z, dtype=float) - np.asarray(S, dtype=float) @ tau
    without = counted.T @ (np.asarray(z, dtype=float) - counted @ tau)
    size = np.linalg.norm(counted) * (np.linalg.norm(counted) * np.linalg.norm(tau) + np.linalg.norm(z))
    if consistent(S, z, free, tau, policy):
        status = Status.LIMITED
    elif np.max(np.abs(without)) > 1e3 * policy.epsilon * size:
        status = Status.LIMITED_INCONSISTENT
    else:
        status = Status.RANK_DEFICIENT_INCONSISTENT
    told = dataclasses.replace(info, status=status, residual=float(np.linalg.norm(residual)))
    return tau, dataclasses.replace(told, active=_mask(tau, lower, upper))


def _reaching(S: FloatArray, z: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Some tau within the limits that minimises |S tau - z|; what has no width is not asked."""
    wide = lower < upper
    tau = np.where(wide, 0.0, lower)
    if wide.any():
        found = lsq_linear(S[:, wide], z - S @ tau, (lower[wide], upper[wide]), method="bvls", tol=1e-15, max_iter=1000)
        tau[wide] = found.x
    return tau


def _nearest(S: FloatArray, y: FloatArray, tau: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """The one nearest to y of those with the same S tau: tau + N t with rows G t >= h, by least distance programming.

    min |N t - d| for orthonormal N is min |t - N^T d|; with t = N^T d + v, min |v| subject to G v >= h - G N^T d.
    """
    wide = lower < upper
    _, sigma, right = np.linalg.svd(S[:, wide])
    rank = int(np.sum(sigma > max(S.shape) * np.finfo(float).eps * sigma[0])) if len(sigma) else 0
    N = right[rank:].T
    if N.shape[1] == 0:
        return np.clip(tau, lower, upper)
    start = N.T @ (y - tau)[wide]
    below, above = np.isfinite(lower[wide]), np.isfinite(upper[wide])
    G = np.vstack([N[below], -N[above]])
    h = np.concatenate([(lower - tau)[wide][below], (tau - upper)[wide][above]])
    h = h - G @ start - 1e-12 * (1 + np.max(np.abs(tau)))  # rounding must not shut out the tau that is at hand
    # Lawson and Hanson (1974), Chapter 23: the residual of nonnegative least squares points to the answer
    E, f = np.vstack([G.T, h]), np.append(np.zeros(N.shape[1]), 1.0)
    move = np.zeros(N.shape[1])
    if np.any(h > 0):
        multipliers, _ = nnls(E, f, maxiter=1000)
        rest = E @ multipliers - f
        move = -rest[:-1] / rest[-1] if rest[-1] < 0 else -start
    found = tau.copy()
    found[wide] += N @ (start + move)
    return np.clip(found, lower, upper)


def _sharpened(
    S: FloatArray, z: FloatArray, y: FloatArray, tau: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """tau solved for once more with those at a limit exactly there; as it was, where that leaves the limits."""
    near = 1e-8 * (1 + np.max(np.abs(tau)))
    sharp = np.where(tau <= lower + near, lower, np.where(tau >= upper - near, upper, tau))
    free = sharp == tau
    free &= (tau > lower) & (tau < upper)
    rest = z - S[:, ~free] @ sharp[~free] - S[:, free] @ y[free]
    sharp[free] = y[free] + np.linalg.pinv(S[:, free]) @ rest
    return sharp if np.all((lower <= sharp) & (sharp <= upper)) else tau


def _mask(tau: FloatArray, lower: FloatArray, upper: FloatArray) -> int:
    return sum(1 << j for j in range(len(tau)) if tau[j] <= lower[j] or tau[j] >= upper[j])
