"""The quantities of a stress run and their bars (NUMERICS: What the tests must show)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

BARS: dict[str, float] = {
    "error of tau / (u kappa (|tau| + |y|))": 4,
    "error of S+ / (u kappa |S+|)": 5,
    "residual / (u (|S| |tau| + |z|))": 1.5,
    "error of tau / (u kappa(D^-1 S) |tau|)": 4,
    "results whose bits differ": 0,
    "wrong rank": 0,
    "wrong status": 0,
    "error of tau / (u kappa_r (|tau| + |y|))": 8,
    "error of tau / (u kappa_r (|tau| + |y| + kappa_r |residual| / |S|))": 8,
    "error of S+ / (u kappa_r |S+|)": 8,
    "Penrose identities / (u kappa)": 10,
    "|S - U s V^T| / (|S| max(m, l) u)": 5,
    "|I - U^T U| / (m u)": 5,
    "|I - V^T V| / (l u)": 5,
    "outputs touched or silent NaN": 0,
    "sweeps / cap": 1,
    "NOT_CONVERGED": 0,
    "false NORMAL certificates": 0,
    "false QR certificates": 0,
    "compilers that complain": 0,
    "residual / (rtol |S| (|x| + |tau|)), z = S x": 10,  # singular values up to 10 rtol may be cut off
}

(TAU, PINV, RESIDUAL, GRADED, BITS, RANK, STATUS, TAU_R, TAU_LS, PINV_R, PENROSE, SVD_BACK, SVD_LEFT, SVD_RIGHT,
 TOUCHED, SWEEPS, CAPPED, FALSE_NORMAL, FALSE_QR, COMPLAINTS, NEAR) = BARS  # fmt: skip


@dataclass(frozen=True)
class Figure:
    """The largest figure of one quantity in one task; a NaN counts as infinite."""

    quantity: str
    largest: float
    systems: int


def figure(quantity: str, values: NDArray[Any] | np.bool) -> Figure:
    """The largest of one figure per system."""
    numbers = np.nan_to_num(np.asarray(values, np.float64), nan=np.inf, posinf=np.inf)
    return Figure(quantity, float(numbers.max(initial=0.0)), int(numbers.size))
