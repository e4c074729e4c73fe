"""What a controller says about its answer: status, path and the rest of `info`, in Python as in the generated C."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]


class Status(IntEnum):
    """Zero and positive: the answer is written, positive with a remark. Negative: the outputs are untouched."""

    OK = 0
    RANK_DEFICIENT_CONSISTENT = 1
    RANK_DEFICIENT_INCONSISTENT = 2
    REGULARISED = 3
    NONFINITE = -1
    SINGULAR_MASS = -2
    NOT_CONVERGED = -3
    OVERFLOW = -4


STATUS_MEANING: dict[Status, str] = {
    Status.OK: "the answer is written",
    Status.RANK_DEFICIENT_CONSISTENT: "rank below the number of constraints, all of them met; minimum norm",
    Status.RANK_DEFICIENT_INCONSISTENT: "the constraints cannot all be met; least squares, minimum norm",
    Status.REGULARISED: "close to a singularity, damping changed the answer",
    Status.NONFINITE: "NaN or infinity among the inputs or parameters; outputs untouched",
    Status.SINGULAR_MASS: "Q is singular, or not positive definite as it was over the domain; outputs untouched",
    Status.NOT_CONVERGED: "an iteration met its cap; outputs untouched",
    Status.OVERFLOW: "a result is not a finite number of this type; outputs untouched",
}


class Path(IntEnum):
    """Which rung of the solver's ladder gave the answer; NONE where the call was refused."""

    NONE = -1
    PRECOMPUTED = 0
    CLOSED_FORM = 1
    NORMAL = 2
    QR = 3
    SVD = 4


@dataclass(frozen=True)
class Info:
    """`sigma_min` is the smallest of the min(m, l) singular values of the raw S, `residual` the 2-norm of z - S tau."""

    status: Status
    path: Path
    rank: int
    sweeps: int
    sigma_min: float
    residual: float


@dataclass(frozen=True)
class Control:
    """tau (tau' for controls-involved scenes), shape (l,), and how it was found."""

    value: FloatArray
    info: Info
