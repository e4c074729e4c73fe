"""The pseudo-inverse straight from the textbook: numpy's SVD with a rank policy and tolerances.

The independent reference for the generated C: nothing is shared with the templates, everything is in double.
"""

import math

import numpy as np
from numpy.typing import NDArray

from servogen.results import FloatArray, Info, Path, Status, refusal
from servogen.textbook import pivoted
from servogen.textbook.policy import Policy


def solve(
    S: FloatArray,
    z: FloatArray,
    y: FloatArray | None,
    policy: Policy,
    last: FloatArray | None = None,
) -> tuple[FloatArray, Info]:
    """tau = y + S+ (z - S y), of shape (l,), and its info; S is (m, l), z (m,), y (l,) or None for zeros.

    Where the status is negative, tau is `last`, or zeros. Raises ValueError for wrong shapes.
    """
    S = _shaped(S, (policy.m, policy.l), "S")
    z = _shaped(z, (policy.m,), "z")
    y = np.zeros(policy.l) if y is None else _shaped(y, (policy.l,), "y")
    untouched = np.zeros(policy.l) if last is None else _shaped(last, (policy.l,), "last").copy()
    if not (np.isfinite(S).all() and np.isfinite(z).all() and np.isfinite(y).all()):
        return untouched, refusal(Status.NONFINITE)
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        left, sigma, right, row_unit, damped = _factors(S, policy)
        if len(sigma) == policy.l and not damped:
            y = np.zeros(policy.l)  # the one answer, whatever y
        tau = y + right @ ((left.T @ (z / row_unit - (S / row_unit[:, None]) @ y)) * _filter(sigma, damped, policy))
        if not _representable(tau, policy):
            return untouched, refusal(Status.OVERFLOW)
        rank = len(sigma)
        status = Status.OK
        if rank < policy.m:
            met = consistent(S, z, y, tau, policy)
            status = Status.RANK_DEFICIENT_CONSISTENT if met else Status.RANK_DEFICIENT_INCONSISTENT
        if damped:
            status = Status.REGULARISED
        return tau, _info(status, rank, S, float(np.linalg.norm(z - S @ tau)), policy)


def pinv(S: FloatArray, policy: Policy, last: FloatArray | None = None) -> tuple[FloatArray, Info]:
    """S+, of shape (l, m), and its info. Where the status is negative, the matrix is `last`, or zeros."""
    S = _shaped(S, (policy.m, policy.l), "S")
    shape = (policy.l, policy.m)
    untouched = np.zeros(shape) if last is None else _shaped(last, shape, "last").copy()
    if not np.isfinite(S).all():
        return untouched, refusal(Status.NONFINITE)
    with np.errstate(over="ignore", invalid="ignore", under="ignore"):
        left, sigma, right, row_unit, damped = _factors(S, policy)
        matrix = (right * _filter(sigma, damped, policy)) @ left.T / row_unit
        if not _representable(matrix, policy):
            return untouched, refusal(Status.OVERFLOW)
        rank = len(sigma)
        status = Status.OK if rank == policy.m else Status.RANK_DEFICIENT_CONSISTENT
        if damped:
            status = Status.REGULARISED
        return matrix, _info(status, rank, S, 0.0, policy)


def counted_rows(S: FloatArray, policy: Policy) -> FloatArray:
    """S, (m, l), with the rows at or below their atol set to zero, as the solver takes them."""
    return np.where(np.max(np.abs(S), axis=1, keepdims=True) > np.array(policy.atol)[:, None], S, 0.0)


def symmetric_units(matrix: FloatArray) -> NDArray[np.int64]:
    """Exponents e such that 2^-(e_i + e_j) matrix_ij has no entry far above 1; about 1 on a positive diagonal.

    Bunch (1971), who equilibrates symmetric matrices in the max-norm; 0 for a row of zeros.
    """
    size = np.maximum(np.abs(matrix), np.abs(matrix.T))
    power = np.where(size > 0, np.frexp(size)[1] - 1.0, -np.inf)
    units = np.floor(np.diag(power) / 2)
    for _ in range(2):
        for i in range(len(units)):
            known = np.isfinite(units) & (np.arange(len(units)) != i)
            units[i] = max(units[i], np.max(power[i, known] - units[known], initial=-np.inf))
    return np.where(np.isfinite(units), units, 0).astype(np.int64)


def _factors(S: FloatArray, policy: Policy) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, bool]:
    """U, sigma, V and the rows' units D with D U diag(sigma) V^T = S truncated to its rank, and whether to damp.

    D is the identity (times one power of two) wherever the row scaling makes a difference to S+.
    """
    S = counted_rows(S, policy)
    row_size = np.abs(S).max(axis=1)
    counted = row_size > 0
    if not counted.any():
        return np.zeros((policy.m, 0)), np.zeros(0), np.zeros((policy.l, 0)), np.ones(policy.m), False

    largest = _power_of_two(row_size[counted].max())
    row_length = row_size * np.linalg.norm(S / np.where(counted, row_size, 1.0)[:, None], axis=1)
    own = np.where(counted, _power_of_two(np.where(counted, row_length, 1.0)), largest)
    common = np.full(policy.m, largest)
    row_unit = own if policy.rank == "scaled" else common

    scaled = S / row_unit[:, None]
    if policy.by_pivots:
        kept, rank = pivoted.truncated(scaled, policy.rtol)
        left, sigma, right = _svd(kept)
    else:
        left, sigma, right = _svd(scaled)
        rank = int(np.sum(sigma > policy.rtol * sigma[0]))
    left, sigma, right = left[:, :rank], sigma[:rank], right[:, :rank]
    if policy.rank == "scaled":
        raw_left, raw_sigma, raw_right = _svd((own / largest)[:, None] * left * sigma @ right.T)
        raw = raw_left[:, :rank], raw_sigma[:rank], raw_right[:, :rank]
        too_small = policy.damping is not None and bool(np.any(raw_sigma[:rank] * largest < policy.damping))
        if rank < counted.sum() or too_small:
            (left, sigma, right), row_unit = raw, common
    damped = policy.damping is not None and row_unit is common and bool(np.any(sigma * largest < policy.damping))
    # sigma in the unit of row_unit: the filter needs it in the unit of S where it damps
    if damped:
        return left, sigma * largest, right, np.ones(policy.m), True
    return left, sigma, right, row_unit, False


def _filter(sigma: FloatArray, damped: bool, policy: Policy) -> FloatArray:
    """1 / sigma; below eps_d the filter sigma / eps_d^2 (2 - (sigma / eps_d)^2), numerics.md: Damping."""
    plain = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0)
    if not damped or policy.damping is None:
        return plain
    ratio = sigma / policy.damping
    return np.where(ratio < 1, ratio / policy.damping * (2 - ratio**2), plain)


def consistent(S: FloatArray, z: FloatArray, y: FloatArray, tau: FloatArray, policy: Policy) -> bool:
    """Every row met to a small backward error; a row's atol counts as uncertainty of each of its entries."""
    reach = np.linalg.norm(tau) + np.linalg.norm(y)
    size = np.linalg.norm(S, axis=1) * reach + np.abs(z)
    noise = np.array(policy.atol) * math.sqrt(policy.l) * reach
    return bool(np.all(np.abs(z - S @ tau) <= policy.consistency * size + noise))


def _svd(A: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    U, sigma, Vt = np.linalg.svd(A, full_matrices=False)
    return U, sigma, Vt.T


def _power_of_two(x: FloatArray | float) -> FloatArray:
    """The largest power of two at or below x > 0."""
    return np.asarray(np.ldexp(1.0, np.frexp(x)[1] - 1))


def _representable(values: FloatArray, policy: Policy) -> bool:
    return bool(np.isfinite(values.astype(policy.scalar)).all())


def _shaped(values: FloatArray, shape: tuple[int, ...], name: str) -> FloatArray:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} has shape {array.shape}, expected {shape}")
    return array


def _info(status: Status, rank: int, S: FloatArray, residual: float, policy: Policy) -> Info:
    return Info(
        status=status,
        path=Path.CLOSED_FORM if min(policy.m, policy.l) == 1 else Path.QR if policy.by_pivots else Path.SVD,
        rank=rank,
        sweeps=0,
        sigma_min=float(np.linalg.svd(S, compute_uv=False)[-1]),
        residual=residual,
    )
