"""What counts as rank, and as a row that is met, written from numerics.md: Tolerances, and Consistency.

A wrong number in the plan shows so: nothing here is shared with the plan of the generated solver, and tests hold one
against the other.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from servogen.scalars import EPSILON, Scalar
from servogen.scene.solver import Solver


@dataclass(frozen=True)
class Policy:
    """Of S, m x l. rtol: singular values at or below rtol times the largest count as zero. atol: per row.

    by_pivots: the rank is the number of pivots of a QR above rtol times the first.
    consistency: a row i is met where |z_i - S_i tau| is at most consistency (|S_i| (|tau| + |y|) + |z_i|).
    """

    m: int
    l: int
    scalar: Scalar
    rank: Literal["scaled", "raw"]
    rtol: float
    atol: tuple[float, ...]
    damping: float | None
    consistency: float
    by_pivots: bool = False

    @property
    def epsilon(self) -> float:
        return EPSILON[self.scalar]


def policy_for(m: int, l: int, scalar: Scalar, solver: Solver, noise: Sequence[float] | None = None) -> Policy:
    """The policy that a user's solver asks for; noise: per row, the atol where the user gave none; default zero."""
    eps, number = EPSILON[scalar], np.dtype(scalar).type
    longer = max(m, l)
    # a Jacobi iteration leaves columns below eps |S|_F alone, and |S|_F is at most sqrt(min(m, l)) times sigma_1
    least = math.sqrt(min(m, l)) * eps
    rtol = longer * eps if solver.rtol is None else max(solver.rtol, least)
    given = solver.atol if solver.atol is not None else 0.0 if noise is None else tuple(noise)
    return Policy(
        m=m,
        l=l,
        scalar=scalar,
        rank=solver.rank,
        rtol=float(number(rtol)),
        atol=tuple(float(number(a)) for a in np.broadcast_to(np.asarray(given, dtype=float), m)),
        damping=None if solver.damping is None else float(number(solver.damping)),
        consistency=8 * longer * eps,
        by_pivots=solver.method == "cod" and min(m, l) > 1,
    )
