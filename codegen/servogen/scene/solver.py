"""What the user may say about the pseudo-inverse (numerics.md: The ladder, and Tolerances)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from servogen.errors import SceneError


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and math.isfinite(value)


@dataclass(frozen=True)
class Solver:
    """How S+ is computed.

    method: "auto" takes the cheapest step that is proven safe, "svd" goes straight to the SVD.
    rank: "scaled" decides the rank on S with its rows scaled by powers of two, so that a constraint's unit does not
        matter; "raw" on S itself, as numpy, scipy and MATLAB do.
    rtol: singular values at or below rtol times the largest count as zero; default max(m, l) * eps, and never less than
        sqrt(min(m, l)) * eps, below which no singular vector is known.
    atol: rows whose largest entry is at or below atol count as zero; a number, or one per row. Default: each row's
        rounding noise where it vanishes, as cos(q) does to 6e-17 at q = pi/2; 0 for a row that has no zero in the
        domain, or whose noise vanishes with it. `sg.build_solver`, which knows no rows: 0.
    damping: eps_d; singular values of the raw S below it are damped, exactly none above; default none.
    sigma_min: what `info.sigma_min` is where no SVD was needed. "bound": a proven lower bound of the smallest singular
        value, which costs next to nothing; the header tells its factor. "exact": the value, by an SVD of its own.
    """

    method: Literal["auto", "svd"] = "auto"
    rank: Literal["scaled", "raw"] = "scaled"
    rtol: float | None = None
    atol: float | Sequence[float] | None = None
    damping: float | None = None
    sigma_min: Literal["bound", "exact"] = "bound"

    def __post_init__(self) -> None:
        if self.method not in ("auto", "svd"):
            raise SceneError(f"Solver(method={self.method!r}): choose 'auto' or 'svd'")
        if self.rank not in ("scaled", "raw"):
            raise SceneError(f"Solver(rank={self.rank!r}): choose 'scaled' or 'raw'")
        if self.sigma_min not in ("bound", "exact"):
            raise SceneError(f"Solver(sigma_min={self.sigma_min!r}): choose 'bound' or 'exact'")
        if self.rtol is not None and not (_is_number(self.rtol) and 0 <= self.rtol < 1):
            raise SceneError(f"Solver(rtol={self.rtol!r}): give a number from 0 up to but not including 1")
        if self.damping is not None and not (_is_number(self.damping) and self.damping > 0):
            raise SceneError(f"Solver(damping={self.damping!r}): give a positive number, or None for no damping")
        if self.atol is not None:
            values = tuple(self.atol) if isinstance(self.atol, list | tuple | np.ndarray) else (self.atol,)
            if not values or not all(_is_number(v) and float(v) >= 0 for v in values):  # type: ignore[arg-type]
                raise SceneError(f"Solver(atol={self.atol!r}): give a finite number, zero or above, or one per row")
            if values != (self.atol,):
                object.__setattr__(self, "atol", values)  # a tuple hashes and compares
