"""The linear system of each kind of scene, by the paper's names."""

from dataclasses import dataclass
from typing import Literal

Kind = Literal["servo", "ideal", "controls"]


@dataclass(frozen=True)
class System:
    """matrix * answer = right, from constraint = psi or phi.

    reach: the matrix none of whose rows may vanish identically, a constraint's way to the controls.
    tau_is_state: the answer is tau', and tau an input like q and u.
    """

    matrix: str
    right: str
    answer: str
    constraint: Literal["psi", "phi"]
    reach: str
    tau_is_state: bool = False


SYSTEMS: dict[Kind, System] = {
    "servo": System("S", "z", "tau", "psi", reach="S"),  # Eq. (8)
    "ideal": System("G", "R", "tau", "psi", reach="J"),  # Eqs. (13)-(17)
    "controls": System("A", "B", "tau_dot", "phi", reach="A", tau_is_state=True),  # Eq. (39)
}
