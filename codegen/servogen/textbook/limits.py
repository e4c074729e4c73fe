"""The answer within limits as a textbook has it: two least-squares problems, one after the other.

Stark and Parker's bounded least squares (scipy) says what the rows of S can reach; among the answers that reach it the
one nearest to y is Lawson and Hanson's least distance programming, through their nonnegative least squares.
"""

import dataclasses

import numpy as np

from servogen.results import FloatArray, Info, Status, refusal
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
    *,
    metric: FloatArray | None = None,
    slowed: FloatArray | None = None,
    start: tuple[FloatArray, Info] | None = None,
) -> tuple[FloatArray, Info]:
    """tau of shape (l,) and its info: the answer of `solve` where that lies within the limits, else the best there.

    metric: T, (l, l) of full rank: the distance from y is |T (tau - y)|. slowed: (m,), what z may be reduced by, z -
    (1 - s) slowed with the largest s in [0, 1] that can be met, which is info.scale. start: tau and info of the answer
    without limits where that is known, as it is with a metric.
    lower, upper: (l,), -inf and inf for none. Where the status is negative, tau is `last`, or zeros. Built for systems
    with numbers of ordinary size, in double; raises ValueError for wrong shapes.
    """
    l = policy.l
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    if lower.shape != (l,) or upper.shape != (l,):
        raise ValueError(f"limits have shapes {lower.shape} and {upper.shape}, expected ({l},)")
    tau, info = solve(S, z, y, policy, last) if start is None else start
    if info.status < 0 and info.status != Status.OVERFLOW:
        return tau, info
    if info.status >= 0 and np.all((lower <= tau) & (tau <= upper)):
        return tau, dataclasses.replace(info, active=_mask(tau, lower, upper))
    if not np.all((lower <= upper) & (lower < np.inf) & (upper > -np.inf)):
        untouched = np.zeros(l) if last is None else np.array(last, dtype=float)
        return untouched, refusal(Status.LIMITS_CROSSED)
    free = np.zeros(l) if y is None else np.asarray(y, dtype=float)
    counted = counted_rows(np.asarray(S, dtype=float), policy)
    z = np.asarray(z, dtype=float)
    scale = 1.0 if slowed is None else _part(S, z, np.asarray(slowed, dtype=float), free, lower, upper, policy)
    z = z if slowed is None else z - (1 - scale) * slowed
    T = np.eye(l) if metric is None else np.asarray(metric, dtype=float)
    tau = _nearest(counted, free, _reaching(counted, z, lower, upper), lower, upper, T)
    tau = _sharpened(counted, z, free, tau, lower, upper, T)
    residual = z - np.asarray(S, dtype=float) @ tau
    without = counted.T @ (z - counted @ tau)
    size = np.linalg.norm(counted) * (np.linalg.norm(counted) * np.linalg.norm(tau) + np.linalg.norm(z))
    if 0 < scale < 1 or consistent(S, z, free, tau, policy):  # the former was found to be met
        status = Status.LIMITED
    elif np.max(np.abs(without)) > 1e3 * policy.epsilon * size:
        status = Status.LIMITED_INCONSISTENT
    else:
        status = Status.RANK_DEFICIENT_INCONSISTENT
    told = dataclasses.replace(info, status=status, residual=float(np.linalg.norm(residual)), scale=scale)
    return tau, dataclasses.replace(told, active=_mask(tau, lower, upper))


def _part(
    S: FloatArray,
    z: FloatArray,
    slowed: FloatArray,
    y: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    policy: Policy,
) -> float:
    """The largest s in [0, 1] for which S tau = z - (1 - s) slowed has an admissible tau, by bisection; 0 for none.

    Those s are an interval; some s of it is found with s among the unknowns.
    """
    counted = counted_rows(S, policy)

    def met(s: float) -> bool:
        right = z - (1 - s) * slowed
        return consistent(S, right, y, _reaching(counted, right, lower, upper), policy)

    if met(1.0):
        return 1.0
    wider = np.hstack([counted, slowed[:, None]])
    low, high = 1 - float(_reaching(wider, z, np.append(lower, 0.0), np.append(upper, 1.0))[-1]), 1.0
    if not met(low):
        return 0.0
    for _ in range(52):
        middle = (low + high) / 2
        low, high = (middle, high) if met(middle) else (low, middle)
    return low


def _reaching(S: FloatArray, z: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Some tau within the limits that minimises |S tau - z|; what has no width is not asked."""
    from scipy.optimize import lsq_linear  # here, for it takes a third of the time to import servogen

    wide = lower < upper
    tau = np.where(wide, 0.0, lower)
    if wide.any():
        found = lsq_linear(S[:, wide], z - S @ tau, (lower[wide], upper[wide]), method="bvls", tol=1e-15, max_iter=1000)
        tau[wide] = found.x
    return tau


def _nearest(
    S: FloatArray, y: FloatArray, tau: FloatArray, lower: FloatArray, upper: FloatArray, T: FloatArray
) -> FloatArray:
    """The one nearest to y of those with the same S tau: tau + N t with rows G t >= h, by least distance programming.

    N spans the kernel of S with T N orthonormal, so that min |T (N t - d)| is min |t - (T N)^T T d|; with t that plus
    v, min |v| subject to G v >= h - G times that.
    """
    from scipy.optimize import nnls

    wide = lower < upper
    N = _kernel(S[:, wide])
    if N.shape[1] == 0:
        return np.clip(tau, lower, upper)
    N = N @ np.linalg.inv(np.linalg.qr(T[:, wide] @ N)[1])
    start = (T[:, wide] @ N).T @ (T @ (y - tau))
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


def _kernel(S: FloatArray) -> FloatArray:
    """An orthonormal basis of what S takes to zero, a column each."""
    _, sigma, right = np.linalg.svd(S)
    rank = int(np.sum(sigma > max(S.shape) * np.finfo(float).eps * sigma[0])) if len(sigma) else 0
    kernel: FloatArray = right[rank:].T
    return kernel


def _sharpened(
    S: FloatArray, z: FloatArray, y: FloatArray, tau: FloatArray, lower: FloatArray, upper: FloatArray, T: FloatArray
) -> FloatArray:
    """tau solved for once more with those at a limit exactly there; as it was, where that leaves the limits."""
    near = 1e-8 * (1 + np.max(np.abs(tau)))
    sharp = np.where(tau <= lower + near, lower, np.where(tau >= upper - near, upper, tau))
    free = sharp == tau
    free &= (tau > lower) & (tau < upper)
    sharp[free] = 0.0
    sharp[free] = np.linalg.pinv(S[:, free]) @ (z - S @ sharp)
    N = _kernel(S[:, free])
    sharp[free] += N @ (np.linalg.pinv(T[:, free] @ N) @ (T @ (y - sharp)))
    return sharp if np.all((lower <= sharp) & (sharp <= upper)) else tau


def _mask(tau: FloatArray, lower: FloatArray, upper: FloatArray) -> int:
    return sum(1 << j for j in range(len(tau)) if tau[j] <= lower[j] or tau[j] >= upper[j])
