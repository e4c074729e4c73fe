"""The plan of one pseudo-inverse: every number and choice the C templates print (numerics.md: The ladder).

Three forms, by shape: "row" (m = 1) and "column" (l = 1) are closed; "full" is the ladder of certified normal
equations, certified pivoted QR and the SVD of its triangle.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np

from servogen.errors import SceneError
from servogen.plan.layout import Form, Layout
from servogen.plan.thresholds import CONSISTENCY, SWEEP_CAPS, RowRange, certificates, range_of_a_row, ranges
from servogen.results import Path
from servogen.scalars import EPSILON, Scalar
from servogen.scene.solver import Method, Solver

LARGEST = 12
"""Shapes run from 1 x 1 to LARGEST x LARGEST."""


@dataclass(frozen=True)
class SolverPlan(Layout):
    """One pseudo-inverse, S of m x l. All numbers are exact in `scalar`."""

    method: Method
    rank: Literal["scaled", "raw"]
    rtol: float  # singular values at or below rtol times the largest count as zero
    atol: tuple[float, ...]  # per row: largest entry at or below it, and the row counts as zero
    damping: float | None  # eps_d, of the raw S
    epsilon: float  # eps
    sweep_cap: int  # 0 where nothing iterates
    orthogonal: float  # two vectors are left alone when |v w| <= orthogonal |v| |w|
    converged: float  # a sweep that met nothing above converged |v| |w| was the last: above the rounding of v w
    smallest_square: float  # a pivot whose squared length is below counts as zero: far below eps^2, safe to divide by
    lift: float  # the triangle of the SVD is brought to this size: squares of its noise's squares do not underflow
    normal_limit: float  # largest bound ||M(R)^-1||_F^2 of the row-normalised S with which NORMAL is accurate and safe
    normal_floor: float  # a pivot of LDL^T below this part of its diagonal entry cannot meet normal_limit
    normal_rounding: float  # what the rounding of S S^T and of LDL^T takes from sigma_min^2, rows of length 1
    rtol_square: float
    qr_rounding: float  # what the rounding of Gram-Schmidt takes from sigma_min / |S|_F
    qr_margin: float  # sigma_min / |S|_F that QR must prove
    qr_limit: float  # the same for bound |S|_F^2
    square_ranges: tuple[tuple[int, int], ...]  # per row: biased exponents of its square that need no scaling
    answer_range: tuple[int, int]  # the same for tau tau^T
    sigma_min: Literal["bound", "exact"]  # what info tells of the smallest singular value
    least_rounding: float  # what the rounding of the QR and of its triangle's inverse takes from sigma_min / |S|_F
    least_share: float  # what the rounding of the bound itself leaves of it
    consistency: float  # relative residual of a row that counts as met
    row_range: RowRange | None  # form "row" only; None where tolerances leave no room for the short form
    root: str = ""  # the square root to call; "": that of <math.h>

    @property
    def certificate_needs_total(self) -> bool:
        """Whether the rank is decided on another matrix than the row-normalised one: |S|_F and the lengths enter."""
        return self.rank == "raw" or not self.wide

    @property
    def certificate_needs_least(self) -> bool:
        return self.certificate_needs_total or self.damping is not None

    @property
    def sqrt(self) -> str:
        return self.root or ("sqrt" if self.scalar == "float64" else "sqrtf")

    @property
    def path(self) -> Path:
        """The last step of the ladder."""
        if self.form != "full":
            return Path.CLOSED_FORM
        return Path.QR if self.method == "cod" else Path.SVD

    @property
    def ladder(self) -> tuple[Path, ...]:
        certified = (Path.NORMAL, Path.QR) if self.form == "full" and self.method == "auto" else ()
        return (*certified, self.path)

    @property
    def tells_bound(self) -> bool:
        """Whether info tells a lower bound of sigma_min where no SVD ran."""
        return self.form == "full" and self.method != "svd" and self.sigma_min == "bound"

    @property
    def sigma_share(self) -> float:
        """The bound is at least this part of sigma_min, but for rounding (numerics.md: The smallest singular value).

        In hundredths, rounded down.
        """
        n = self.count
        squared = 2 / (n + 1) if n < 4 else 2 / (1 + math.sqrt(n))
        return math.floor(100 * math.sqrt(squared)) / 100

    @property
    def sigma_left(self) -> float:
        """What certainly remains of sigma_min in the bound, rounding taken off where a certificate barely held.

        In hundredths, rounded down.
        """
        normal = math.sqrt(max(0.0, 1 - self.normal_rounding * self.normal_limit))
        qr = self.least_share - self.least_rounding * math.sqrt(self.qr_limit)
        return math.floor(100 * self.sigma_share * max(0.0, min(normal, qr))) / 100

    @property
    def mean_share(self) -> float:
        """1 / min(m, l): what the mean of as many eigenvalues is of their sum."""
        return _in_scalar(1 / self.count, self.scalar, "mean_share")

    @property
    def atol_used(self) -> bool:
        return any(a > 0 for a in self.atol)

    @property
    def root_l(self) -> float:
        """sqrt(l) in the target type: a row within atol has a norm below atol sqrt(l)."""
        return _in_scalar(math.sqrt(self.l), self.scalar, "root_l")

    def to_json(self) -> dict[str, Any]:
        """For the manifest: the shape, the ladder and the tolerances."""
        shown = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("row_range", "root")}
        return shown | {"atol": list(self.atol), "ladder": [path.name for path in self.ladder]}


def plan_solver(m: int, l: int, scalar: Scalar, solver: Solver) -> SolverPlan:
    """The plan for S of m x l. Raises SceneError for sizes outside 1..12 and tolerances that do not fit."""
    if not (1 <= m <= LARGEST and 1 <= l <= LARGEST):
        raise SceneError(
            f"S of {m} x {l}: the solver takes 1 to {LARGEST} rows and columns; "
            f"leave out constraints, or split the mechanism into parts that do not share controls"
        )
    if scalar not in EPSILON:
        raise SceneError(f"scalar {scalar!r}: choose 'float64' or 'float32'")
    eps = EPSILON[scalar]
    form: Form = "row" if m == 1 else "column" if l == 1 else "full"
    count = min(m, l)
    # Jacobi leaves vectors at or below eps |S|_F alone: below this rtol they would be counted without being orthogonal
    floor = math.sqrt(count) * eps
    rtol = max(m, l) * eps if solver.rtol is None else max(solver.rtol, floor)
    atol = _row_tolerances(m, solver.atol, scalar)
    damping = None if solver.damping is None else _in_scalar(solver.damping, scalar, "damping")
    if damping == 0.0:
        raise SceneError(f"Solver(damping={solver.damping!r}) is zero in {scalar}: give a larger one, or None")
    return SolverPlan(
        m=m,
        l=l,
        scalar=scalar,
        form=form,
        method=solver.method,
        rank=solver.rank,
        rtol=_in_scalar(rtol, scalar, "rtol"),
        atol=atol,
        damping=damping,
        epsilon=eps,
        sweep_cap=next(cap for size, cap in SWEEP_CAPS if count <= size)
        if form == "full" and solver.method != "cod"
        else 0,
        orthogonal=_in_scalar(math.sqrt(max(m, l)) * eps / 2, scalar, "orthogonal"),
        converged=(max(m, l) + 4) * eps / 2,
        **certificates(m, l, eps, rtol),
        **ranges(scalar, l, atol),
        sigma_min=solver.sigma_min,
        consistency=CONSISTENCY * max(m, l) * eps,
        row_range=range_of_a_row(l, atol[0], damping, scalar) if form == "row" else None,
    )


def _in_scalar(value: float, scalar: Scalar, name: str) -> float:
    """The nearest number of the target type: both twins then compare with the same one."""
    with np.errstate(over="ignore"):
        nearest = float(np.float32(value)) if scalar == "float32" else float(value)
    if not math.isfinite(nearest):
        raise SceneError(f"Solver({name}={value!r}) is too large for {scalar}: give a smaller one")
    return nearest


def _row_tolerances(m: int, atol: float | Sequence[float] | None, scalar: Scalar) -> tuple[float, ...]:
    values = (0.0,) * m if atol is None else (float(atol),) * m if isinstance(atol, int | float) else tuple(atol)
    if len(values) != m:
        raise SceneError(f"Solver(atol=...) has {len(values)} numbers, S has {m} rows: give one number, or one per row")
    return tuple(_in_scalar(float(v), scalar, "atol") for v in values)
