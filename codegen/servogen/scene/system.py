"""The linear system of each kind of scene, by the paper's names, and the functions that come with it."""

from dataclasses import dataclass, replace
from typing import Literal

Kind = Literal["servo", "ideal", "controls"]


@dataclass(frozen=True)
class Function:
    """A function that the twins of a kind have beside pinv and control; its C has the same name.

    text: what it returns. shape: of that, a letter a dimension: m rows of constraints, l controls, n velocity
    parameters, p rows of passive constraints, c those and the rates of the holonomic ones. controls: it answers as
    control does, with info. arguments: numbers that it takes before the inputs. of_constraints: it looks at the
    constraints alone, so that only the states that they use have to be given.
    """

    name: str
    text: str
    shape: str
    controls: bool = False
    arguments: tuple[str, ...] = ()
    of_constraints: bool = False


@dataclass(frozen=True)
class System:
    """matrix * answer = right, from constraint = psi or phi.

    answer is its name in C, symbol the one in formulas. equation: of the answer in the paper.
    reach: the matrix none of whose rows may vanish identically, a constraint's way to the controls.
    functions: of a twin, beside pinv and control. matrix_is_given: the user wrote it.
    tau_is_state: the answer is tau', and tau an input like q and u. of_outputs: the rows are derivatives of psi, the
    first ones that the controls reach.
    """

    matrix: str
    right: str
    answer: str
    constraint: Literal["psi", "phi"]
    reach: str
    equation: str
    functions: tuple[Function, ...]
    symbol: str = "tau"
    matrix_is_given: bool = False
    tau_is_state: bool = False
    of_outputs: bool = False

    def with_passive(self) -> "System":
        """The same of a mechanism with passive constraints: multipliers and closure are functions, too."""
        own = (replace(f, text=_WITH_PASSIVE.get(f.name, f.text)) for f in self.functions)
        return replace(self, functions=(*own, *PASSIVE))

    def function(self, name: str) -> Function | None:
        """The function of that name, None where there is none."""
        return next((f for f in self.functions if f.name == name), None)


NEAREST = "N = Q^-1 - Q^-1 J^T A^-1 J Q^-1, A = J Q^-1 J^T"
"""What Q^-1 becomes under passive constraints J u' + j = 0: u' = N (P + G tau) - Q^-1 J^T A^-1 j."""

_WITH_PASSIVE = {
    "S": f"psi_u N G, {NEAREST} of the passive constraints' J, shape (m, l).",
    "z": "-psi_u N P + psi_u Q^-1 J^T A^-1 j - X + Theta psi, N and A as for S, shape (m,).",
    "B": "Right side of A tau' = B, with the passive constraints' J^T lam beside P + G tau, shape (m,).",
}

PASSIVE = (
    Function("lam", "The multipliers of the passive constraints under tau, of least norm, shape (p,).", "p"),
    Function("closure", "chi of the passive constraints, then chi' of the holonomic ones, shape (c,).", "c"),
)
"""The functions that come with passive constraints."""

_VALUES = "The constraints' values, shape (m,)."
_PSI = Function("psi", _VALUES, "m", of_constraints=True)

SYSTEMS: dict[Kind, System] = {
    "servo": System(  # Eq. (8)
        *("S", "z", "tau", "psi", "S", "10"),
        functions=(
            _PSI,
            Function("S", "psi_u Q^-1 G, shape (m, l), Eq. (8).", "ml"),
            Function("z", "-psi_u Q^-1 P - X + Theta psi, shape (m,), Eq. (9).", "m"),
        ),
        of_outputs=True,
    ),
    "ideal": System(  # Eqs. (13)-(17)
        *("G", "R", "tau", "psi", "J", "16"),
        functions=(
            _PSI,
            Function("R", "The generalised forces of an ideal passive constraint, shape (n,), Eqs. (16)-(17).", "n"),
            Function("T", "[I A^T] Q over the constraint rows, shape (n, n), Eqs. (15), (26).", "nn"),
            Function("F", "[I A^T] P over the right side of the constraint rows, shape (n,), Eqs. (15), (26).", "n"),
        ),
        matrix_is_given=True,
    ),
    "controls": System(  # Eq. (39)
        *("A", "B", "tau_dot", "phi", "A", "54"),
        functions=(
            Function("phi", _VALUES, "m", of_constraints=True),
            Function("A", "phi_tau, shape (m, l), Eq. (39).", "ml", of_constraints=True),
            Function("B", "Right side of A tau' = B, shape (m,), Eq. (40).", "m"),
            Function(
                "project", "The tau nearest to the given one with phi = 0.", "l", controls=True, of_constraints=True
            ),
            Function(
                *("step", "tau advanced by dt (seconds) along tau', then projected onto phi = 0.", "l"),
                controls=True,
                arguments=("dt",),
            ),
        ),
        symbol="tau'",
        tau_is_state=True,
    ),
}
