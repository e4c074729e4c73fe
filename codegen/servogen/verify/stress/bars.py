"""The quantities of a stress run and their bars (numerics.md: Bars)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

TAU = "error of tau / (eps kappa (|tau| + |y|))"
PINV = "error of S+ / (eps kappa |S+|)"
RESIDUAL = "residual / (eps (|S| |tau| + |z|))"
GRADED = "error of tau / (eps kappa(D^-1 S) |tau|)"
BITS = "results whose bits differ"
RANK = "wrong rank"
STATUS = "wrong status"
TAU_R = "error of tau / (eps kappa_r (|tau| + |y|))"
TAU_LS = "error of tau / (eps kappa_r (|tau| + |y| + kappa_r |residual| / |S|))"
PINV_R = "error of S+ / (eps kappa_r |S+|)"
PENROSE = "Penrose identities / (eps kappa)"
SVD_BACK = "|S - U s V^T| / (|S| max(m, l) eps)"
SVD_LEFT = "|I - U^T U| / (m eps)"
SVD_RIGHT = "|I - V^T V| / (l eps)"
TOUCHED = "outputs touched or silent NaN"
SWEEPS = "sweeps / cap"
CAPPED = "NOT_CONVERGED"
FALSE_NORMAL = "false NORMAL certificates"
FALSE_QR = "false QR certificates"
HIGH_BOUND = "bounds of sigma_min above it"
LOW_BOUND = "bounds of sigma_min below a tenth of it"
IDLE = "steps that never gave a certificate"
COMPLAINTS = "compilers that complain"
OPTIMUM = "(|S tau - z| - least) / (eps kappa (|S| (|tau| + |y|) + |z|))"
TAU_WITHIN = "error of tau within limits / (eps kappa (|tau| + |y| + |z_i| / |S_i|))"
FALSE_OPTIMUM = "false certificates of an optimum"
BEYOND = "tau beyond a limit"
WARM = "answers that a hint changes"
NEAR = "residual / (rtol |S| (|x| + |tau|)), z = S x"

BARS: dict[str, float] = {
    TAU: 4,
    PINV: 5,
    RESIDUAL: 1.5,
    GRADED: 4,
    BITS: 0,
    RANK: 0,
    STATUS: 0,
    TAU_R: 8,
    TAU_LS: 8,
    PINV_R: 8,
    PENROSE: 10,
    SVD_BACK: 5,
    SVD_LEFT: 5,
    SVD_RIGHT: 5,
    TOUCHED: 0,
    SWEEPS: 1,
    CAPPED: 0,
    FALSE_NORMAL: 0,
    FALSE_QR: 0,
    HIGH_BOUND: 0,
    LOW_BOUND: 0,
    IDLE: 0,
    COMPLAINTS: 0,
    OPTIMUM: 4,
    TAU_WITHIN: 8,
    FALSE_OPTIMUM: 0,
    BEYOND: 0,
    WARM: 0,
    NEAR: 10,  # singular values up to 10 rtol may be cut off
}


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
