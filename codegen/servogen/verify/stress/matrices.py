"""Matrices to solve: the spectra of LAPACK's dlatms, and those with names in the literature (numerics.md: Families)."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from servogen.results import FloatArray

MODES: dict[str, Callable[[int, float, Generator], FloatArray]] = {
    "one large": lambda n, k, _: np.where(np.arange(n) == 0, 1.0, 1 / k),
    "one small": lambda n, k, _: np.where(np.arange(n) == n - 1, 1 / k, 1.0),
    "geometric": lambda n, k, _: k ** -(np.arange(n) / max(n - 1, 1)),
    "arithmetic": lambda n, k, _: 1 - np.arange(n) / max(n - 1, 1) * (1 - 1 / k),
    "log-uniform": lambda n, k, g: k ** -g.uniform(0, 1, n),
    "random": lambda n, k, g: np.abs(g.standard_normal(n)) + 1 / k,
}
"""The spectra of LAPACK's dlatms, modes 1 to 6."""


def orthogonal(count: int, n: int, generator: Generator) -> FloatArray:
    """(count, n, n), Haar-distributed."""
    Q, R = np.linalg.qr(generator.standard_normal((count, n, n)))
    return np.asarray(Q * np.sign(np.diagonal(R, axis1=1, axis2=2))[:, None, :])


def with_spectra(m: int, l: int, sigma: FloatArray, generator: Generator) -> FloatArray:
    """(N, m, l) with the singular values sigma (N, min(m, l)), in random bases."""
    N, n = sigma.shape
    left, right = orthogonal(N, m, generator), orthogonal(N, l, generator)
    return np.asarray((left[:, :, :n] * sigma[:, None, :]) @ right[:, :, :n].transpose(0, 2, 1))


def spectra(count: int, n: int, largest: float, generator: Generator) -> FloatArray:
    """(count, n): each mode in turn, both ways round, kappa log-uniform from 1 to `largest`."""
    modes = list(MODES.values())
    sigma = np.empty((count, n))
    for i in range(count):
        one = modes[i % len(modes)](n, largest ** float(generator.uniform(0, 1)), generator)
        sigma[i] = one[::-1] if i // len(modes) % 2 else one
    return sigma


def _grid(m: int, l: int) -> tuple[FloatArray, FloatArray]:
    return np.arange(m, dtype=np.float64)[:, None], np.arange(l, dtype=np.float64)[None, :]


def _kahan(m: int, l: int, generator: Generator) -> FloatArray:
    c = float(generator.uniform(0.05, 0.95))
    i, j = _grid(m, l)
    return np.asarray((1 - c * c) ** (i / 2) * np.where(j == i, 1.0, np.where(j > i, -c, 0.0)))


def _bidiagonal(m: int, l: int, generator: Generator) -> FloatArray:
    """Graded, after Demmel and Kahan (1990)."""
    i, j = _grid(m, l)
    ratio = 10.0 ** -generator.uniform(0, 2)
    return np.asarray(ratio**i * ((j == i) + (j == i + 1)))


def _laeuchli(m: int, l: int, generator: Generator) -> FloatArray:
    i, j = _grid(m, l)
    return np.asarray((j == 0) + 10.0 ** -generator.uniform(0, 7) * (j == i + (l > m)))


CLASSICAL: dict[str, Callable[[int, int, Generator], FloatArray]] = {
    "Hilbert": lambda m, l, g: np.asarray(1 / (np.add(*_grid(m, l)) + 1 + g.integers(0, 5))),
    "Kahan": _kahan,
    "Laeuchli": _laeuchli,
    "Vandermonde": lambda m, l, g: np.vander(g.uniform(-1, 1, m), l),
    "Wilkinson": lambda m, l, g: np.eye(m, l) * np.abs(np.arange(l) - (m - 1) / 2) + np.eye(m, l, 1) + np.eye(m, l, -1),
    "graded bidiagonal": _bidiagonal,
    "D1 C D2": lambda m, l, g: (
        g.standard_normal((m, l)) * 10.0 ** -g.uniform(0, 3, (m, 1)) * 10.0 ** -g.uniform(0, 3, l)
    ),
    "nearly parallel rows": lambda m, l, g: (
        g.standard_normal(l) * (1 + 2.0 ** -g.integers(4, 40) * g.standard_normal((m, l)))
    ),
}
"""Test matrices of the literature."""


def classical(m: int, l: int, index: int, generator: Generator) -> FloatArray:
    """One of CLASSICAL in turn, every other one with rows and columns permuted, all with signs flipped."""
    A = list(CLASSICAL.values())[index % len(CLASSICAL)](m, l, generator)
    if index // len(CLASSICAL) % 2:
        A = A[generator.permutation(m)][:, generator.permutation(l)]
    return np.asarray(A * generator.choice([-1.0, 1.0], (m, 1)) * generator.choice([-1.0, 1.0], l))


def integer_factors(m: int, l: int, rank: int, most: float, generator: Generator) -> tuple[FloatArray, FloatArray]:
    """B (m, rank) and C (rank, l) of full rank, small integers; kappa(B) kappa(C) <= most, so that no tolerance of a
    rank lies between the singular values of B C and 0."""
    while True:
        B, C = generator.integers(-3, 4, (m, rank)), generator.integers(-3, 4, (rank, l))
        if np.linalg.cond(B) * np.linalg.cond(C) <= most:
            return B.astype(np.float64), C.astype(np.float64)


def nearly_deficient(A: NDArray[Any], most: float) -> bool:
    """Whether a singular value of integer rows, brought to length 1, is neither 0 nor above 1 / most of the largest."""
    lengths = np.linalg.norm(A, axis=1, keepdims=True)
    sigma = np.linalg.svd(A / np.where(lengths > 0, lengths, 1), compute_uv=False)
    zero = 1e-14 * max(A.shape)  # what numpy makes of one
    return bool(np.any((sigma > zero * sigma[0]) & (sigma < sigma[0] / most)))
