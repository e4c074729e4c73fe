"""What a controller says about its answer: status, path and the rest of `info`, in Python as in the generated C."""

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating]
IntArray = NDArray[np.int32]


class Status(IntEnum):
    """Zero and positive: the answer is written, positive with a remark. Negative: the outputs are untouched."""

    OK = 0
    RANK_DEFICIENT_CONSISTENT = 1
    RANK_DEFICIENT_INCONSISTENT = 2
    REGULARISED = 3
    LIMITED = 4
    LIMITED_INCONSISTENT = 5
    NONFINITE = -1
    SINGULAR_MASS = -2
    NOT_CONVERGED = -3
    OVERFLOW = -4
    LIMITS_CROSSED = -5
    DEAD_CENTRE = -6


OF_LIMITS = (Status.LIMITED, Status.LIMITED_INCONSISTENT, Status.LIMITS_CROSSED)
"""What only a package with limits says."""

OF_PASSIVE = (Status.DEAD_CENTRE,)
"""What only a package of a mechanism with passive constraints says."""


STATUS_MEANING: dict[Status, str] = {
    Status.OK: "the answer is written",
    Status.RANK_DEFICIENT_CONSISTENT: "rank below the number of constraints, all of them met; minimum norm",
    Status.RANK_DEFICIENT_INCONSISTENT: "the constraints cannot all be met; least squares, minimum norm",
    Status.REGULARISED: "close to a singularity, damping changed the answer",
    Status.LIMITED: "limits moved the answer, all constraints are still met, or met as far as they were slowed down",
    Status.LIMITED_INCONSISTENT: "limits keep the constraints from being met; least squares within them",
    Status.NONFINITE: "NaN or infinity among the inputs or parameters; outputs untouched",
    Status.SINGULAR_MASS: "Q is singular, or not positive definite as it was over the domain; outputs untouched",
    Status.NOT_CONVERGED: "an iteration met its cap; outputs untouched",
    Status.OVERFLOW: "a result is not a finite number of this type; outputs untouched",
    Status.DEAD_CENTRE: "the passive constraints lose rank, no motion is determined; outputs untouched",
    Status.LIMITS_CROSSED: "no number lies between a lower and an upper limit, or NaN there; outputs untouched",
}


class Path(IntEnum):
    """Which rung of the solver's ladder gave the answer; NONE where the call was refused."""

    NONE = -1
    PRECOMPUTED = 0
    CLOSED_FORM = 1
    NORMAL = 2
    QR = 3
    SVD = 4


PATH_MEANING: dict[Path, str] = {
    Path.NONE: "by none, for the call was refused",
    Path.PRECOMPUTED: "the matrix does not depend on the state: inverted at generation, or by prepare",
    Path.CLOSED_FORM: "one row or one column",
    Path.NORMAL: "normal equations, certified and refined",
    Path.QR: "pivoted QR, certified and refined",
    Path.SVD: "singular value decomposition",
}
INFO_INTEGERS, INFO_REALS = ("status", "path", "rank", "sweeps"), ("sigma_min", "residual")
"""The members of `info` in their order: of Info, of an array of them, and of <prefix>_info in C."""


@dataclass(frozen=True)
class Info:
    """`sigma_min` is the smallest of the min(m, l) singular values of the raw S, `residual` the 2-norm of z - S tau.

    By the paths NORMAL and QR sigma_min is a proven lower bound, unless `sg.Solver(sigma_min="exact")` was asked for.
    Of limits: `scale`, the part of the error dynamics that is kept, and `active`, a bit mask of the controls at one.
    Of priorities: `level_rank` and `level_residual`, one entry a level, and `sigma_min` is that of the first level;
    empty where there is one level, of which rank and residual tell.
    Where the status is negative, path is NONE and all other members are zero.
    """

    status: Status
    path: Path
    rank: int
    sweeps: int
    sigma_min: float
    residual: float
    scale: float = 1.0
    active: int = 0
    level_rank: list[int] = field(default_factory=list)
    level_residual: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        """A refusal keeps no part of the error dynamics, whether the package has limits or not."""
        if isinstance(self.status, Status):  # of one call, which must not wait for numpy
            if self.status < 0:
                object.__setattr__(self, "scale", 0.0)
        elif np.any(np.less(self.status, 0)):
            object.__setattr__(self, "scale", np.where(np.less(self.status, 0), 0.0, self.scale))

    def __repr__(self) -> str:
        """Names for numbers; of a stack, how often each."""
        status, path = _names(Status, self.status), _names(Path, self.path)
        figures = ", ".join(f"{n}={_figure(getattr(self, n))}" for n in ("rank", "sweeps", "sigma_min", "residual"))
        limited = np.any(np.not_equal(self.scale, 1.0) & np.greater_equal(self.status, 0)) or np.any(self.active)
        bits = f", active={np.bitwise_or.reduce(np.ravel(self.active)):#b}"
        levels = f", level_rank={self.level_rank}" if np.size(self.level_rank) else ""
        return f"Info({status}, {path}, {figures}{levels}{f', scale={_figure(self.scale)}{bits}' if limited else ''})"


def refusal(status: Status) -> Info:
    """Info of a negative status."""
    return Info(status, Path.NONE, 0, 0, 0.0, 0.0)


def _names(kind: type[IntEnum], value: Any) -> str:
    if np.ndim(value) == 0:
        return kind(value).name
    return " ".join(f"{kind(k).name}*{n}" for k, n in zip(*np.unique(value, return_counts=True), strict=True))


def _figure(value: Any) -> str:
    return f"{value:.4g}" if np.ndim(value) == 0 else f"{np.min(value):.4g}..{np.max(value):.4g}"


@dataclass(frozen=True)
class Control:
    """tau (tau' for controls-involved scenes), shape (l,), and how it was found."""

    value: FloatArray
    info: Info


@dataclass(frozen=True, eq=False)
class Batch:
    """`control` at N states: value (N, l), and the members of `info` as arrays (N,), of levels (N, levels) with no
    column where there is one level. batch[k] is what one call gives.

    Where a status is negative, the value is `last`, or zeros.
    """

    value: FloatArray
    status: IntArray
    path: IntArray
    rank: IntArray
    sweeps: IntArray
    sigma_min: FloatArray
    residual: FloatArray
    scale: FloatArray
    active: IntArray
    level_rank: IntArray
    level_residual: FloatArray

    def __len__(self) -> int:
        return len(self.status)

    def __getitem__(self, k: int) -> Control:
        """State k alone."""
        status, path = Status(int(self.status[k])), Path(int(self.path[k]))
        integers = int(self.rank[k]), int(self.sweeps[k])
        numbers = float(self.sigma_min[k]), float(self.residual[k]), float(self.scale[k])
        levels = self.level_rank[k].tolist(), self.level_residual[k].tolist()
        return Control(self.value[k], Info(status, path, *integers, *numbers, int(self.active[k]), *levels))

    def __repr__(self) -> str:
        """How often each status."""
        return f"<Batch of {len(self)} states: {_names(Status, self.status) or 'none'}>"
