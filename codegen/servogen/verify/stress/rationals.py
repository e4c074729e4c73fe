"""Answers measured against exact rationals: errors of tau and S+, residuals, the Penrose identities."""

from collections.abc import Iterator, Sequence

import numpy as np

from servogen import exact
from servogen.results import FloatArray, Status
from servogen.verify.stress.bars import PENROSE, PINV, PINV_R, RESIDUAL, TAU, TAU_LS, Figure, figure
from servogen.verify.stress.bench import Bench, answers


def accuracy(
    bench: Bench,
    S: FloatArray,
    z: FloatArray,
    y: FloatArray,
    truths: Sequence[exact.Matrix],
    quantities: tuple[str, str] = (TAU, PINV),
) -> Iterator[Figure]:
    """Errors of tau and S+ over eps kappa, S+ in rationals; where S has full row rank, residual and Penrose too.

    S: (N, m, l), z: (N, m), y: (N, l). kappa is that of what was kept, |S| |S+|.
    """
    tau, info = bench.solve(S, z, y)
    X, pinv_info = bench.pinv(S)
    yield from bench.ends(info)
    yield from bench.ends(pinv_info)
    least_squares = quantities[0] == TAU_LS
    wide, wide_y, wide_z = (a.astype(np.float64) for a in (S, y, z))
    right_tau, miss, S_pinv, off = (np.zeros(a.shape) for a in (tau, tau, X, X))
    rest, least = np.zeros(z.shape), np.zeros(z.shape)
    for i, truth in enumerate(truths):
        s, zi, yi = (exact.rational(a[i]) for a in (S, z, y))
        right = exact.solution(s, truth, zi, yi)
        right_tau[i], S_pinv[i] = exact.nearest(right)[:, 0], exact.nearest(truth)
        miss[i], off[i] = error(tau[i], right)[:, 0], error(X[i], truth)
        if pinv_info["status"][i] == Status.OVERFLOW and np.abs(S_pinv[i]).max() > np.finfo(bench.dtype).max:
            off[i] = S_pinv[i] = 0.0  # rightly refused
        if quantities[0] == TAU and np.isfinite(tau[i]).all():
            rest[i] = exact.nearest(zi - s * exact.rational(tau[i]))[:, 0]
        if least_squares:
            least[i] = exact.nearest(zi - s * right)[:, 0]
    size, pinv_size = norm2(wide), norm2(S_pinv)
    kappa = np.maximum(size * pinv_size, 1.0)
    scale = length(right_tau) + length(wide_y)
    if least_squares:
        scale = scale + kappa * over(length(least), size)
    yield figure(quantities[0], over(length(miss), bench.eps * kappa * scale))
    yield figure(quantities[1], over(norm2(off), bench.eps * kappa * pinv_size))
    if quantities[0] == TAU:
        yield figure(RESIDUAL, over(length(rest), bench.eps * (size * length(tau.astype(np.float64)) + length(wide_z))))
        yield figure(PENROSE, penrose(S, X) / (bench.eps * kappa))


def decided_exactly(bench: Bench, S: FloatArray, z: FloatArray) -> Iterator[Figure]:
    """Rank and status decided in rationals, and the errors of tau and S+, for systems of any rank; y = 0."""
    y = bench.round(np.zeros((len(S), S.shape[2])))
    matrices = [exact.rational(s) for s in S]
    truths = [exact.pinv(s) for s in matrices]
    ranks = [exact.rank(s) for s in matrices]
    statuses = []
    for s, truth, zi, rank in zip(matrices, truths, z, ranks, strict=True):
        target = exact.rational(zi)
        if rank == s.nrows():
            statuses.append(Status.OK)
        elif s * truth * target == target:
            statuses.append(Status.RANK_DEFICIENT_CONSISTENT)
        else:
            statuses.append(Status.RANK_DEFICIENT_INCONSISTENT)
    _, info = bench.solve(S, z, y)
    yield from answers(info, ranks, statuses)
    yield from accuracy(bench, S, z, y, truths, (TAU_LS, PINV_R))


def error(computed: FloatArray, right: exact.Matrix) -> FloatArray:
    """computed - right, subtracted exactly; infinite where computed is not finite."""
    if not np.isfinite(computed).all():
        return np.full((right.nrows(), right.ncols()), np.inf)
    return exact.difference(computed, right)


def penrose(S: FloatArray, X: FloatArray) -> FloatArray:
    """The largest of the four identities' errors, relative; products in extended precision. (N,)"""
    A, B = S.astype(np.longdouble), X.astype(np.longdouble)
    AB, BA = A @ B, B @ A

    def largest(M: FloatArray) -> FloatArray:
        return np.asarray(np.abs(M).max(axis=(1, 2)))

    errors = (
        largest(AB @ A - A) / largest(A),
        np.divide(largest(BA @ B - B), largest(B), where=largest(B) > 0, out=np.full(len(S), np.inf, np.longdouble)),
        largest(AB - AB.transpose(0, 2, 1)),
        largest(BA - BA.transpose(0, 2, 1)),
    )
    return np.asarray(np.max(errors, axis=0), np.float64)


def norm2(A: FloatArray) -> FloatArray:
    """Largest singular values of a stack; infinite where an entry is not finite."""
    finite = np.isfinite(A).all(axis=(1, 2))
    sizes = np.full(len(A), np.inf)
    sizes[finite] = np.linalg.svd(A[finite], compute_uv=False)[:, 0]
    return sizes


def length(v: FloatArray) -> FloatArray:
    """2-norms of a stack of vectors; their squares neither over- nor underflow."""
    largest = np.abs(v).max(axis=1, initial=0.0)
    unit = np.where((largest > 0) & np.isfinite(largest), largest, 1.0)
    return np.asarray(np.linalg.norm(v / unit[:, None], axis=1) * unit)


def over(a: FloatArray, b: FloatArray) -> FloatArray:
    """a / b, and 0 / 0 = 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(a == 0, 0.0, np.asarray(a / b))
