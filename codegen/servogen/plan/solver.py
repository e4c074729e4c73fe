"""The plan of one pseudo-inverse: every number and choice the C templates print (numerics.md: The ladder).

Three kinds, by shape: "row" (m = 1) and "column" (l = 1) are closed forms; "full" is the ladder of certified normal
equations, certified pivoted QR and the SVD of its triangle.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal, NamedTuple

import numpy as np

from servogen.errors import SceneError
from servogen.results import OF_LIMITS, STATUS_MEANING, Path, Status
from servogen.scalars import EPSILON, Scalar
from servogen.scene.solver import Solver

Kind = Literal["row", "column", "full"]
Operations = dict[str, int]

LARGEST = 12
"""Shapes run from 1 x 1 to LARGEST x LARGEST."""

SWEEP_CAPS = ((2, 5), (3, 7), (6, 10), (12, 12))
"""(min(m, l) up to, sweeps): at least two above the worst ever measured; NOT_CONVERGED stands behind them."""

BLOCK = 4
"""Sums run in this many parts, and vectors are padded to whole blocks: SIMD and scalar machines add up alike."""

ROUNDING = 4
"""eps times ROUNDING times the vectors' length covers the rounding of a product or a Gram-Schmidt (numerics.md:
Certificates)."""

NORMAL_SHARE = 1.0
"""NORMAL holds up to bound = NORMAL_SHARE u^(-2/3), kappa about 1e5 in float64 and 2e2 in float32."""

CONSISTENCY = 8
"""A row is met when its residual is below CONSISTENCY max(m, l) u (|S_i| (|tau| + |y|) + |z_i|): a backward error."""

PATH_MEANING: dict[Path, str] = {
    Path.NONE: "by none, for the call was refused",
    Path.PRECOMPUTED: "the matrix does not depend on the state: inverted at generation, or by prepare",
    Path.CLOSED_FORM: "one row or one column",
    Path.NORMAL: "normal equations, certified and refined",
    Path.QR: "pivoted QR, certified and refined",
    Path.SVD: "singular value decomposition",
}


class Bits(NamedTuple):
    """The layout of a scalar type, as C text where C needs text; templates read it by name."""

    uint: str  # unsigned integer of the same size
    mantissa: int  # bits of the fraction
    bias: int
    magnitude: str  # mask of everything but the sign
    infinity: str  # bits of +infinity: magnitudes at or above it are not finite
    smallest_normal: str  # bits of the smallest normal number
    highest: int  # largest k for which 2^k is finite
    lowest: int  # smallest k for which 2^k is normal
    lift: int  # 2^lift makes every subnormal normal
    none: int  # stands for the exponent of zero: below all exponents and sums of two


BITS: dict[str, Bits] = {
    "float64": Bits(
        "uint64_t",
        52,
        1023,
        "UINT64_C(0x7fffffffffffffff)",
        "UINT64_C(0x7ff0000000000000)",
        "UINT64_C(0x0010000000000000)",
        1023,
        -1022,
        64,
        -16384,
    ),
    "float32": Bits(
        "uint32_t",
        23,
        127,
        "UINT32_C(0x7fffffff)",
        "UINT32_C(0x7f800000)",
        "UINT32_C(0x00800000)",
        127,
        -126,
        32,
        -16384,
    ),
}


@dataclass(frozen=True)
class RowRange:
    """Where the unscaled closed form of a row is safe, and gives the same bits as the scaled one.

    Outside (and at NaN, infinity, zero, atol and damping, which all fall outside) the scaled form takes over. A square
    and a task in range lie 0 to span above their lowest, span a power of two less one: so one comparison does for both.
    """

    square_low: int  # of s s^T, twice the biased exponent: half as many binades
    square_floor: int | None  # the same, below which s may be zero or damped; None where square_low is above it
    task_low: int  # of z - s y, biased exponent
    task_high: int
    span: int
    tau_low: int  # of tau tau^T where noise may be all that tau is, biased exponent
    tau_high: int


@dataclass(frozen=True)
class SolverPlan:
    """One pseudo-inverse, S of m x l. All numbers are exact in `scalar`."""

    m: int
    l: int
    scalar: Scalar
    kind: Kind
    method: Literal["auto", "svd"]
    rank: Literal["scaled", "raw"]
    rtol: float  # singular values at or below rtol times the largest count as zero
    atol: tuple[float, ...]  # per row: largest entry at or below it, and the row counts as zero
    damping: float | None  # eps_d, of the raw S
    epsilon: float  # u
    sweep_cap: int  # 0 for closed forms
    orthogonal: float  # two vectors are left alone when |v w| <= orthogonal |v| |w|
    converged: float  # a sweep that met nothing above converged |v| |w| was the last: above the rounding of v w
    smallest_square: float  # a pivot whose squared length is below counts as zero: far below u^2, safe to divide by
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
    consistency: float  # relative residual of a row that counts as met
    row_range: RowRange | None  # kind "row" only; None where tolerances leave no room for the short form
    root: str = ""  # the square root to call; "": that of <math.h>

    @property
    def wide(self) -> bool:
        """The vectors of the SVD are the rows (m <= l), else the columns."""
        return self.m <= self.l

    @property
    def count(self) -> int:
        """min(m, l), the number of singular values."""
        return min(self.m, self.l)

    @property
    def long(self) -> int:
        """max(m, l): the length of the vectors that are made orthogonal."""
        return max(self.m, self.l)

    @property
    def width(self) -> int:
        """`long` in whole blocks of four numbers; below four there are no blocks."""
        return self.long if self.long < BLOCK else -(-self.long // BLOCK) * BLOCK

    @property
    def pad(self) -> int:
        return self.width - self.long

    @property
    def stride(self) -> int:
        """Columns of the triangle, padded likewise."""
        return self.count if self.count < BLOCK else -(-self.count // BLOCK) * BLOCK

    @property
    def m_width(self) -> int:
        """Numbers in a working vector of m: padded if it is the long side."""
        return self.m if self.wide or self.kind != "full" else self.width

    @property
    def l_width(self) -> int:
        return self.width if self.wide and self.kind == "full" else self.l

    def m_at(self, index: str) -> str:
        """C for the place of element `index` in a working vector of m."""
        return index if self.wide else self._at(index)

    def l_at(self, index: str) -> str:
        return self._at(index) if self.wide and self.kind == "full" else index

    def _at(self, index: str) -> str:
        whole = self.long - self.long % BLOCK
        return (
            index if self.pad == 0 or self.kind != "full" else f"({index} < {whole} ? {index} : {index} + {self.pad})"
        )

    @property
    def certificate_needs_total(self) -> bool:
        """Whether the rank is decided on another matrix than the row-normalised one: |S|_F and the lengths enter."""
        return self.rank == "raw" or not self.wide

    @property
    def certificate_needs_least(self) -> bool:
        return self.certificate_needs_total or self.damping is not None

    @property
    def real(self) -> str:
        return "double" if self.scalar == "float64" else "float"

    @property
    def sqrt(self) -> str:
        return self.root or ("sqrt" if self.scalar == "float64" else "sqrtf")

    @property
    def path(self) -> Path:
        """The last step of the ladder."""
        return Path.SVD if self.kind == "full" else Path.CLOSED_FORM

    @property
    def ladder(self) -> tuple[Path, ...]:
        certified = (Path.NORMAL, Path.QR) if self.kind == "full" and self.method == "auto" else ()
        return (*certified, self.path)

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
    u = EPSILON[scalar]
    kind: Kind = "row" if m == 1 else "column" if l == 1 else "full"
    count = min(m, l)
    # Jacobi leaves vectors at or below u |S|_F alone: below this rtol they would be counted without being orthogonal
    floor = math.sqrt(count) * u
    rtol = max(m, l) * u if solver.rtol is None else max(solver.rtol, floor)
    atol = _row_tolerances(m, solver.atol, scalar)
    damping = None if solver.damping is None else _in_scalar(solver.damping, scalar, "damping")
    if damping == 0.0:
        raise SceneError(f"Solver(damping={solver.damping!r}) is zero in {scalar}: give a larger one, or None")
    return SolverPlan(
        m=m,
        l=l,
        scalar=scalar,
        kind=kind,
        method=solver.method,
        rank=solver.rank,
        rtol=_in_scalar(rtol, scalar, "rtol"),
        atol=atol,
        damping=damping,
        epsilon=u,
        sweep_cap=next(cap for size, cap in SWEEP_CAPS if count <= size) if kind == "full" else 0,
        orthogonal=_in_scalar(math.sqrt(max(m, l)) * u / 2, scalar, "orthogonal"),
        converged=(max(m, l) + 4) * u / 2,
        **_certificates(m, l, count, u, rtol),
        **_ranges(scalar, l, atol),
        consistency=CONSISTENCY * max(m, l) * u,
        row_range=_row_range(l, atol[0], damping, scalar) if kind == "row" else None,
    )


def _certificates(m: int, l: int, count: int, u: float, rtol: float) -> dict[str, Any]:
    """Limits of the certificates (numerics.md: Certificates), with margins for the rounding of the bound itself."""
    total = 4 * m  # above the squared norm of S with the length of each row in [1, 2)
    rounding = ROUNDING * l * count * u
    # refined once, NORMAL's error is (u bound)^2 + u kappa: accepted where the first is the smaller
    accurate = NORMAL_SHARE * u ** (-2 / 3)
    safe = 0.875 / (rounding + total * rtol**2)
    normal_limit = min(accurate, safe)
    qr_margin = rtol + ROUNDING * max(m, l) * u
    return {
        "smallest_square": 2.0**-900 if u < 2.0**-40 else 2.0**-110,
        "lift": 1.0 if u < 2.0**-40 else 2.0**20,
        "normal_limit": normal_limit,
        "normal_floor": 1 / normal_limit,
        "normal_rounding": rounding,
        "rtol_square": rtol**2,
        "qr_rounding": ROUNDING * max(m, l) * u,
        "qr_margin": qr_margin,
        "qr_limit": 0.875 / qr_margin**2,
    }


def _ranges(scalar: Scalar, l: int, atol: Sequence[float]) -> dict[str, Any]:
    """Biased exponents within which nothing needs scaling: products that underflow are far below half an ulp.

    Rows that may be within their atol are outside.
    """
    square, low, high = (500, -1000, 900) if scalar == "float64" else (40, -100, 110)
    bias = BITS[scalar].bias
    never = 2 * (bias + 1)
    lows = [max(-square, _square_above(math.sqrt(l) * a)) for a in atol]
    return {
        "square_ranges": tuple((bias + a, bias + square) if a <= square else (never, never) for a in lows),
        "answer_range": (bias + low, bias + high),
    }


def _square_above(bound: float) -> int:
    """The exponent from which on s s^T is above bound^2. As max|s|^2 >= s s^T / l, bound is sqrt(l) atol for a row."""
    return 2 * math.frexp(bound)[1] + 1 if bound > 0 else -(2**30)


PLAIN = {"matrix": "S", "right": "z", "unknown": "tau"}
"""The names of the solver's equation S tau = z in comments where a scene has none of its own."""


def solver_context(
    plan: SolverPlan, prefix: str, literal: Callable[[float], str], limited: bool = False
) -> dict[str, Any]:
    """Everything the templates solver/solver.c.j2 and solver/info.h.j2 name. limited: there are limits."""
    said = [s for s in Status if limited or s not in OF_LIMITS]
    return {
        "p": prefix,
        "P": prefix.upper(),
        "K": prefix.upper(),  # of the names of this solver's numbers; another solver of the same package has its own
        "real": plan.real,
        "plan": plan,
        "bits": BITS[plan.scalar],
        "named": PLAIN,
        "solved": PLAIN,
        "lit": literal,
        "emit": {"solve": True, "pinv": True, "known": False},  # the functions to print; a scene may need fewer
        "statuses": [(s.name, int(s), STATUS_MEANING[s]) for s in sorted(said, key=lambda s: (s < 0, abs(s)))],
        "paths": [(path.name, int(path), PATH_MEANING[path]) for path in Path],
    }


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


def _row_range(l: int, atol: float, damping: float | None, scalar: Scalar) -> RowRange | None:
    """Exponents chosen so that no product that matters underflows and no sum overflows.

    Squares from 2^-a to below 2^a, tasks from 2^-2a and steps of refinement to below 2^2a: then |tau - y| <= 2^(5a/2)
    is below half an ulp of the largest number, and products that underflow are below half an ulp of any sum they enter
    that matters: only a chain of ties, each 24 bits above the last, can carry such a rounding up to a float32 task, by
    half an ulp of it. Squares of tau in 2^+-c, times s s^T, neither overflow nor become subnormal.
    """
    a, c = (256, 760) if scalar == "float64" else (32, 90)
    # above these the row is neither zero nor damped
    floor = max(_square_above(math.sqrt(l) * atol), _square_above(damping or 0.0))
    if floor >= a:
        return None
    bias = BITS[scalar].bias
    return RowRange(
        square_low=2 * (bias - a),
        square_floor=2 * (bias + floor) if floor > -a else None,
        task_low=bias - 2 * a,
        task_high=bias + 2 * a - 1,
        span=4 * a - 1,
        tau_low=bias - c,
        tau_high=bias + c,
    )


def _total(add: int = 0, mul: int = 0, div: int = 0, sqrt: int = 0) -> Operations:
    return {"total": add + mul + div + sqrt, "add": add, "mul": mul, "div": div, "sqrt": sqrt}


def _sum(*terms: tuple[int, Operations]) -> Operations:
    return {key: sum(times * counts[key] for times, counts in terms) for key in terms[0][1]}


def _dot(n: int) -> Operations:
    return _total(add=n - 1, mul=n)


def solver_operations(plan: SolverPlan) -> dict[str, Operations]:
    """Floating-point operations of `solve` with y, without info; exact scalings by powers of two left out.

    "closed_form" for one row or column (the usual case, no damping); else one entry a step of the ladder, each with
    what the steps before it spent in vain: "normal", "qr" and "svd", the last with every loop at its cap.
    """
    m, l, n = plan.m, plan.l, plan.count
    with_y = int(l != m)  # at full rank of a square S tau is determined without
    if plan.kind == "row":
        rest = _total(add=l, mul=l)
        return {"closed_form": _sum((1, _dot(l)), (with_y, rest), (1, _total(div=1)), (1, _total(with_y * l, l)))}
    residual = _total(add=m * l, mul=m * l)
    if plan.kind == "column":  # applied twice: the second is the refinement
        apply = _sum((1, _dot(m)), (1, _total(div=2)), (1, _total(add=1, mul=1)))
        return {"closed_form": _sum((1, _dot(m)), (1, _total(add=4, sqrt=1)), (2, residual), (2, apply))}
    long, stride = plan.width, plan.stride
    gram = _sum((n * (n + 1) // 2, _dot(long)))
    triangle = n * (n - 1) // 2
    cubic = n * (n - 1) * (n - 2) // 6
    factor = _sum((cubic, _total(add=1, mul=1)), (triangle, _total(add=1, mul=2)), (n, _total(div=1)))
    bound = _sum((cubic, _total(add=1, mul=1)), (triangle, _total(add=1, mul=2)), (n, _total(add=1, mul=1)))
    substitute = _sum((2 * triangle, _total(add=1, mul=1)), (n, _total(mul=1)))
    normal = _sum((1, gram), (1, factor), (1, bound), (2, substitute), (2 * n, _total(long, long)), (1, residual))
    normal = _sum((1, normal), (with_y, residual), (1, _total(add=(1 + with_y) * long, mul=long)))
    project = _sum((1, _dot(long)), (1, _total(mul=1)), (1, _total(long, long)), (1, _dot(long)))
    cross = _sum((triangle, _dot(long)))
    qr = _sum((n, _dot(long)), (triangle, project), (n, _total(div=1)), (int(plan.wide), cross))
    apply = _sum((triangle, _total(add=1, mul=1)), (n, _total(mul=1)), (n, _total(long, long)))
    careful = _sum((triangle, _total(add=1, mul=1))) if plan.wide else _sum((n, _total(long, long)))
    certified = _sum(
        (1, qr), (1, bound), (2, apply), (1, careful), (1 + with_y, residual), (1, _total(add=(1 + with_y) * long))
    )
    if n == 2:
        svd = _total(add=9, mul=10, div=10, sqrt=5)
    else:
        rotation = _sum((3, _dot(stride)), (stride, _total(add=4, mul=4)), (1, _total(5, 12, 4, 4)))
        sweep = _sum((triangle, rotation))
        svd = _sum((plan.sweep_cap, sweep), (n, _dot(stride)), (n, _total(sqrt=2)), (n * stride, _total(div=1)))
    unit = _sum((1, _dot(long)), (1, _total(mul=long, div=2, sqrt=1)))
    vectors = _sum((n * n + triangle, _total(long, long)), (triangle, _dot(long)), (n, unit))
    decompose = _sum((1, qr), (1, svd), (1, vectors))
    weigh = _sum(
        (m * n, _total(2 * m, 2 * m)), (n * n, _total(m, m)), (m * n, _total(n, n, 1)), (n, _total(div=1, sqrt=1))
    )
    runs = 1 + (plan.rank == "scaled" and (not plan.wide or plan.damping is not None))
    apply = _sum((n, _total(m + l, m + l + 1)))
    steps = [(runs, decompose), (2, apply), (2, residual), (1, _total(add=3 * l)), (int(plan.rank == "scaled"), weigh)]
    counts = {"svd": _sum(*steps)}
    if plan.method == "auto":
        counts = {
            "normal": normal,
            "qr": _sum((1, normal), (1, certified)),
            "svd": _sum((1, normal), (1, certified), *steps),
        }
    return counts
