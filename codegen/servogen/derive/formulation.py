"""What derivation hands on: named SX quantities with their equations."""

from dataclasses import dataclass
from typing import Any

from servogen.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class Quantity:
    """One named matrix: its SX, the equation of the paper, the formula in words of ASCII, and whether it needs Q^-1."""

    name: str
    expression: Any
    equation: str
    formula: str
    needs_mass: bool = False


@dataclass(frozen=True, eq=False)
class MassTreatment:
    """How Q is solved with, and why; pivots at or below n eps times their scale mean a singular Q at run time."""

    method: str  # "identity", "diagonal", "LDL^T" or "pivoted LU"
    reason: str
    pivots: tuple[Any, ...] = ()
    scales: tuple[Any, ...] = ()
    positive_definite: bool = False  # at every state drawn from the domain


@dataclass(frozen=True, eq=False)
class Formulation:
    """S tau = z or A tau' = B with what belongs to it; `system` names the two, `constraint` psi or phi."""

    scene: Scene
    quantities: tuple[Quantity, ...]
    mass: MassTreatment
    affine_in_tau: bool = True

    @property
    def system(self) -> tuple[str, str]:
        return ("S", "z") if self.scene.kind == "servo" else ("A", "B")

    @property
    def constraint(self) -> str:
        return "psi" if self.scene.kind == "servo" else "phi"

    def __getitem__(self, name: str) -> Any:
        """The SX of the quantity of that name."""
        return next(q.expression for q in self.quantities if q.name == name)
