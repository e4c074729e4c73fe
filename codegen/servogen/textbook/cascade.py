"""Priorities as a textbook has them: least squares in the null space of all levels before, by numpy's SVD."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from servogen.results import FloatArray, Info, Path, Status, refusal
from servogen.textbook.policy import Policy
from servogen.textbook.pseudo_inverse import consistent, counted_rows

_LOST = 4.0
"""max(m, l) eps times this: what rounding leaves of a row that the levels before have used up (numerics.md:
Priorities)."""


def solve_cascade(
    S: FloatArray,
    z: FloatArray,
    y: FloatArray,
    levels: Sequence[Sequence[int]],
    policy: Policy,
    last: FloatArray | None = None,
) -> tuple[FloatArray, Info]:
    """tau of shape (l,) and its info: least squares of S tau = z level by level, nearest to y.

    levels: the rows of each, the most important first; the status is about the first that has any. Where it is
    negative, tau is `last`, or zeros.
    """
    S, z, y = (np.asarray(a, dtype=float) for a in (S, z, y))
    untouched = np.zeros(policy.l) if last is None else np.array(last, dtype=float)
    if not (np.isfinite(S).all() and np.isfinite(z).all() and np.isfinite(y).all()):
        return untouched, refusal(Status.NONFINITE)
    tau, basis, counted = y, np.eye(policy.l), counted_rows(S, policy)
    ranks, damped = list[int](), False
    with np.errstate(over="ignore", invalid="ignore"):
        for own in map(list, levels):
            lost = max(policy.rtol, _LOST * max(policy.m, policy.l) * policy.epsilon) if sum(ranks) else policy.rtol
            move, rest, bent = _level(counted[own], basis, z[own] - S[own] @ tau, lost, policy)
            tau = tau + basis @ move
            ranks.append(basis.shape[1] - rest.shape[1])
            basis, damped = basis @ rest, damped or bent
    if not np.isfinite(tau.astype(policy.scalar)).all():
        return untouched, refusal(Status.OVERFLOW)
    status = Status.OK
    lead = next((k for k, own in enumerate(levels) if own), 0)
    rows = list(levels[lead])
    if ranks[lead] < len(rows):  # the levels behind the first are met as far as it allows, which is no remark
        met = consistent(S[rows], z[rows], y, tau, replace(policy, atol=tuple(policy.atol[i] for i in rows)))
        status = Status.RANK_DEFICIENT_CONSISTENT if met else Status.RANK_DEFICIENT_INCONSISTENT
    missed, first = z - S @ tau, S[rows]
    return tau, Info(
        Status.REGULARISED if damped else status,
        Path.SVD,
        sum(ranks),
        0,
        float(np.linalg.svd(first, compute_uv=False)[-1]) if 0 < ranks[lead] == min(first.shape) else 0.0,
        float(np.linalg.norm([missed[i] for own in levels for i in own])),
        level_rank=ranks,
        level_residual=[float(np.linalg.norm(missed[list(own)])) for own in levels],
    )


Switch = tuple[Sequence[int], float]
"""Rows that come and go, and how far they are in, from 0 to 1."""


def solve_switched(
    S: FloatArray,
    z: FloatArray,
    y: FloatArray,
    levels: Sequence[Sequence[int]],
    switches: Sequence[Switch],
    policy: Policy,
    last: FloatArray | None = None,
) -> tuple[FloatArray, Info]:
    """The same where rows come and go, Lee, Mansard and Park (2012): a switch in between asks its rows for a z +
    (1 - a) S tau', tau' the answer without them, which is found likewise."""

    def answer(there: frozenset[int]) -> tuple[FloatArray, Info]:
        asked = np.array(z, dtype=float)
        for k in there:
            rows, a = list(switches[k][0]), switches[k][1]
            if a < 1:
                asked[rows] = a * asked[rows] + (1 - a) * S[rows] @ answer(there - {k})[0]
        gone = {i for k, (rows, _) in enumerate(switches) if k not in there for i in rows}
        kept = [[i for i in own if i not in gone] for own in levels]
        return solve_cascade(S, asked, y, kept, policy, last)

    return answer(frozenset(k for k, (_, a) in enumerate(switches) if a > 0))


def _level(
    S: FloatArray, basis: FloatArray, asked: FloatArray, lost: float, policy: Policy
) -> tuple[FloatArray, FloatArray, bool]:
    """One level: its move in the basis of what is open, a basis in that one of what it leaves open, whether damped.

    S: its rows, zero where they count as zero. Singular values at or below `lost` times the largest, or times the
    longest row before it was projected, count as zero.
    """
    n, length = basis.shape[1], np.linalg.norm(S, axis=1)
    counted = length > 0
    own = np.ldexp(1.0, np.frexp(np.where(counted, length, 1.0))[1] - 1)
    top = np.max(own[counted], initial=0.0)
    if n == 0 or top == 0:
        return np.zeros(n), np.eye(n), False
    own = np.where(counted, own, top) if policy.rank == "scaled" else np.full(len(S), top)
    inside = S / own[:, None] @ basis
    left, sigma, right = np.linalg.svd(inside)
    rank = int(np.sum(sigma > lost * max(sigma[0], np.max(length / own))))
    kept = left[:, :rank] * sigma[:rank] @ right[:rank]
    raw_left, raw, raw_right = np.linalg.svd((own / top)[:, None] * kept)
    damped = policy.damping is not None and bool(np.any(raw[:rank] * top < policy.damping))
    if rank == counted.sum() and not damped:  # whatever the rows' units, all are met
        move = right[:rank].T @ (left[:, :rank].T @ (asked / own * counted) / sigma[:rank])
    else:
        ratio = raw[:rank] * top / policy.damping if policy.damping is not None else np.ones(rank)
        kept_part = np.where(ratio < 1, ratio**2 * (2 - ratio**2), 1.0)
        move = raw_right[:rank].T @ (kept_part * (raw_left[:, :rank].T @ (asked / top * counted)) / raw[:rank])
    return move, right[rank:].T, damped
