"""The page of a stress run: the bars (numerics.md: Bars) with the figures reached, then every family."""

from collections.abc import Sequence
from dataclasses import dataclass

from servogen.report.templates import pages
from servogen.verify.stress.bars import (
    BITS,
    CAPPED,
    COMPLAINTS,
    FALSE_NORMAL,
    FALSE_QR,
    GRADED,
    HIGH_BOUND,
    IDLE,
    LOW_BOUND,
    PENROSE,
    PINV,
    PINV_R,
    RANK,
    RESIDUAL,
    STATUS,
    SVD_BACK,
    SVD_LEFT,
    SVD_RIGHT,
    SWEEPS,
    TAU,
    TAU_LS,
    TAU_R,
    TOUCHED,
)
from servogen.verify.stress.report import StressReport, StressRow

CLAIMS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("full rank: error of tau, in eps κ (‖τ‖ + ‖y‖)", (TAU,)),
    ("full rank: error of S⁺, in eps κ ‖S⁺‖", (PINV,)),
    ("full rank: residual, in eps (‖S‖ ‖τ‖ + ‖z‖)", (RESIDUAL,)),
    ("rows graded to 1e-14: error of tau, in eps κ(D⁻¹S) ‖τ‖", (GRADED,)),
    ("powers of two, signs: results whose bits differ", (BITS,)),
    ("the SVD: the three ratios of ddrvbd", (SVD_BACK, SVD_LEFT, SVD_RIGHT)),
    ("rank-deficient: errors of tau and S⁺, in eps κᵣ", (TAU_R, PINV_R)),
    ("least squares: error of tau, in eps κ (‖τ‖ + ‖y‖ + κ ‖r‖ / ‖S‖)", (TAU_LS,)),
    ("four Penrose identities, in eps κ", (PENROSE,)),
    ("wrong ranks, wrong statuses", (RANK, STATUS)),
    ("false certificates", (FALSE_NORMAL, FALSE_QR)),
    ("bounds of sigma_min: above it, or below a tenth", (HIGH_BOUND, LOW_BOUND)),
    ("steps that never gave a certificate", (IDLE,)),
    ("outputs touched, silent NaN", (TOUCHED,)),
    ("sweeps, as a part of the cap", (SWEEPS,)),
    ("iterations that did not end", (CAPPED,)),
    ("shapes a compiler complains of", (COMPLAINTS,)),
)
"""What the page claims, each with the quantities whose bars stand for it (numerics.md: Bars)."""


@dataclass(frozen=True)
class Claim:
    """One bar and the largest figure in each scalar, over all families."""

    text: str
    bar: float
    largest: dict[str, float]
    systems: int
    passed: bool


def claims(rows: Sequence[StressRow]) -> list[Claim]:
    """The bars that were measured."""
    found = []
    for text, quantities in CLAIMS:
        own = [row for row in rows if row.quantity in quantities]
        if own:
            scalars = dict.fromkeys(row.scalar for row in own)
            largest = {s: max(row.largest for row in own if row.scalar == s) for s in scalars}
            systems = sum(row.systems for row in own if row.quantity == quantities[0])
            found.append(Claim(text, own[0].bar, largest, systems, all(row.passed for row in own)))
    return found


def render_stress(report: StressReport) -> str:
    """The HTML of a stress run, one file without network."""
    families: dict[str, list[StressRow]] = {}
    for row in report.rows:
        families.setdefault(row.family, []).append(row)
    return pages().get_template("stress.html.j2").render(report=report, claims=claims(report.rows), families=families)
