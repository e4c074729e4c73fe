"""Exact truth for priorities: lexicographic least squares in rationals, one level after the other."""

from collections.abc import Sequence
from dataclasses import dataclass

import flint

from servogen.exact import Matrix, pinv


@dataclass(frozen=True)
class Lexicographic:
    """x, of shape (l, 1), and the rank of each level within what the levels before it leave open."""

    x: Matrix
    ranks: tuple[int, ...]


def lexicographic(S: Matrix, z: Matrix, y: Matrix, levels: Sequence[Sequence[int]]) -> Lexicographic:
    """The x nearest to y among those that minimise |S x - z| level by level; levels: the rows of each, first one first.

    Of Siciliano and Slotine (1991): x <- x + (S_k N)^+ (z_k - S_k x), N the projector onto what is left open.
    """
    l = S.ncols()
    x = y
    N = flint.fmpq_mat(l, l, [int(i == j) for i in range(l) for j in range(l)])
    ranks = []
    for rows in levels:
        own = flint.fmpq_mat(len(rows), l, [S[i, j] for i in rows for j in range(l)])
        asked = flint.fmpq_mat(len(rows), 1, [z[i, 0] for i in rows])
        inside = own * N
        inverse = pinv(inside)
        x = x + inverse * (asked - own * x)
        N = N - inverse * inside
        ranks.append(int(inside.rank()))
    return Lexicographic(x, tuple(ranks))
