"""The linear system of each kind of scene, by the paper's names."""

from dataclasses import dataclass
from typing import Literal

Kind = Literal["servo", "ideal", "controls"]


@dataclass(frozen=True)
class System:
    """matrix * answer = right, from constraint = psi or phi.

    answer is its name in C, symbol the one in formulas. equation: of the answer in the paper.
    reach: the matrix none of whose rows may vanish identically, a constraint's way to the controls.
    quantities: what it is made of, beside tau; a twin has a function for each. matrix_is_given: the user wrote it.
    tau_is_state: the answer is tau', and tau an input like q and u.
    """

    matrix: str
    right: str
    answer: str
    constraint: Literal["psi", "phi"]
    reach: str
    equation: str
    quantities: tuple[str, ...]
    symbol: str = "tau"
    matrix_is_given: bool = False
    tau_is_state: bool = False


SYSTEMS: dict[Kind, System] = {
    "servo": System("S", "z", "tau", "psi", "S", "10", ("psi", "S", "z")),  # Eq. (8)
    "ideal": System("G", "R", "tau", "psi", "J", "16", ("psi", "R", "T", "F"), matrix_is_given=True),  # Eqs. (13)-(17)
    "controls": System(
        "A", "B", "tau_dot", "phi", "A", "54", ("phi", "A", "B"), symbol="tau'", tau_is_state=True
    ),  # Eq. (39)
}
