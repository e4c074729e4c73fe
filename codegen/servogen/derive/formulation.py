"""What derivation hands on: named SX quantities with their equations."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from servogen.law.law import Law
from servogen.law.steps import SYSTEM
from servogen.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class Quantity:
    """One named matrix: its SX, the equation of the paper, the formula in words of ASCII, and whether it needs Q^-1."""

    name: str
    expression: Any
    equation: str
    formula: str
    needs_mass: bool = False


@dataclass(frozen=True)
class MassFindings:
    """What is known of Q before it is solved with: symmetric by proof, positive definite at every state drawn from the
    domain. remarks: on its signs and symmetry."""

    symmetric: bool
    positive_definite: bool
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class MassTreatment:
    """How Q is solved with, and why; pivots at or below n eps times their scale mean a singular Q at run time, and the
    last of them, `joining`, a dead centre of the passive constraints."""

    method: str  # "identity", "diagonal", "LDL^T" or "pivoted LU"
    reason: str
    pivots: tuple[Any, ...] = ()
    scales: tuple[Any, ...] = ()
    positive_definite: bool = False  # at every state drawn from the domain
    factor: "MassFactor | None" = None  # where Q is positive definite
    joining: int = 0


@dataclass(frozen=True, eq=False)
class MassFactor:
    """Q[order, order] = L D L^T as the solve with Q computes them: the rows of the unit triangular L, and D."""

    order: tuple[int, ...]
    L: tuple[tuple[Any, ...], ...]
    D: tuple[Any, ...]


@dataclass(frozen=True, eq=False)
class Weight:
    """W = L L^T with sigma = L^T tau: the plain minimum norm in sigma is the weighted one in tau.

    N = L^-T: l x l SX. to_sigma: X -> L^T X for SX of l rows. entries: the structural nonzeros of N, row by row, a
    column; pattern: per row of N the (place in entries, column) of each. of_mass: W is Q^-1, so that N N^T = Q.
    """

    N: Any
    to_sigma: Callable[[Any], Any]
    entries: Any
    pattern: tuple[tuple[tuple[int, int], ...], ...]
    reason: str
    of_mass: bool = False


@dataclass(frozen=True, eq=False)
class Formulation:
    """The quantities of the scene's linear system, and the law that makes the controls of them.

    remarks: what is odd and yet no error, found on the way.
    """

    scene: Scene
    quantities: tuple[Quantity, ...]
    mass: MassTreatment
    law: Law
    weight: Weight | None = None
    remarks: tuple[str, ...] = ()

    @property
    def factorised(self) -> str:
        """The matrix the scene's solver gets: the system's own, or that times L^-T where there is a weight."""
        return self.law.matrix_of(SYSTEM)

    def __getitem__(self, name: str) -> Any:
        """The SX of the quantity of that name."""
        return next(q.expression for q in self.quantities if q.name == name)
