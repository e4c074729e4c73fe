"""What the user may say about the pseudo-inverse (numerics.md: The ladder, and Tolerances)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from servogen.errors import SceneError

Method = Literal["auto", "svd", "cod"]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and math.isfinite(value)


@dataclass(frozen=True)
class Solver:
    """How S+ is computed.

    method: "auto" takes the cheapest step that is proven safe, "svd" goes straight to the SVD. "cod" is a complete
        orthogonal decomposition: rank by the pivots of a QR, no iteration, so a lower worst case; near a loss of rank
        its decision may differ from the SVD's, and it takes neither damping, nor sigma_min="exact", nor priorities.
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

    method: Method = "auto"
    rank: Literal["scaled", "raw"] = "scaled"
    rtol: float | None = None
    atol: float | Sequence[float] | None = None
    damping: float | None = None
    sigma_min: Literal["bound", "exact"] = "bound"

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            raise SceneError(f"Solver(method={self.method!r}): choose 'auto', 'svd' or 'cod'")
        if self.rank not in ("scaled", "raw"):
            raise SceneError(f"Solver(rank={self.rank!r}): choose 'scaled' or 'raw'")
        if self.sigma_min not in ("bound", "exact"):
            raise SceneError(f"Solver(sigma_min={self.sigma_min!r}): choose 'bound' or 'exact'")
        if self.rtol is not None and not (_is_number(self.rtol) and 0 <= self.rtol < 1):
            raise SceneError(f"Solver(rtol={self.rtol!r}): give a number from 0 up to but not including 1")
        if self.damping is not None and not (_is_number(self.damping) and self.damping > 0):
            raise SceneError(f"Solver(damping={self.damping!r}): give a positive number, or None for no damping")
        if self.method == "cod" and self.damping is not None:
            raise SceneError(
                f"Solver(method='cod', damping={self.damping!r}): damping acts on singular values, which cod does not "
                f"compute; choose method 'auto' or 'svd', or no damping"
            )
        if self.method == "cod" and self.sigma_min == "exact":
            raise SceneError(
                "Solver(method='cod', sigma_min='exact'): singular values need an iteration, which cod does without; "
                "choose sigma_min 'bound', or method 'auto' or 'svd'"
            )
        if self.atol is not None:
            values = tuple(self.atol) if isinstance(self.atol, list | tuple | np.ndarray) else (self.atol,)
            if not values or not all(_is_number(v) and float(v) >= 0 for v in values):  # type: ignore[arg-type]
                raise SceneError(f"Solver(atol={self.atol!r}): give a finite number, zero or above, or one per row")
            if values != (self.atol,):
                object.__setattr__(self, "atol", values)  # a tuple hashes and compares
