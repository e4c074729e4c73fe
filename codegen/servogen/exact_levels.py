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
        if not rows:
            ranks.append(0)
            continue
        own = flint.fmpq_mat(len(rows), l, [S[i, j] for i in rows for j in range(l)])
        asked = flint.fmpq_mat(len(rows), 1, [z[i, 0] for i in rows])
        inside = own * N
        inverse = pinv(inside)
        x = x + inverse * (asked - own * x)
        N = N - inverse * inside
        ranks.append(int(inside.rank()))
    return Lexicographic(x, tuple(ranks))


Switch = tuple[Sequence[int], float]
"""Rows that come and go, and how far they are in: at 0 and below they are out, at 1 and above all in."""


def kept_levels(levels: Sequence[Sequence[int]], switches: Sequence[Switch], there: frozenset[int]) -> list[list[int]]:
    """The levels without the rows of those switches that are not there."""
    gone = {i for k, (rows, _) in enumerate(switches) if k not in there for i in rows}
    return [[i for i in own if i not in gone] for own in levels]


def switched(
    S: Matrix, z: Matrix, y: Matrix, levels: Sequence[Sequence[int]], switches: Sequence[Switch]
) -> Lexicographic:
    """The same where a switch in between asks its rows for a z + (1 - a) S x', x' the answer without them, found
    alike."""

    def answer(there: frozenset[int]) -> Lexicographic:
        asked = flint.fmpq_mat(z)
        for k in there:
            rows, a = switches[k]
            if a < 1:
                part, instead = flint.fmpq(*float(a).as_integer_ratio()), S * answer(there - {k}).x
                for i in rows:
                    asked[i, 0] = part * z[i, 0] + (1 - part) * instead[i, 0]
        return lexicographic(S, asked, y, kept_levels(levels, switches, there))

    return answer(frozenset(k for k, (_, a) in enumerate(switches) if a > 0))
