"""Quantities whose rates are known in closed form, so that nobody needs to differentiate them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca


@dataclass(frozen=True, eq=False)
class KnownRate:
    """A column p' = factor J u with p'' = factor J u' + acceleration, all SX.

    factor: k x w of q. J: w x n_u of q. rate: k, p'. acceleration: k, p'' at u' = 0; at_gauge: at the gauge's u'.
    still: what these take to be constant (references, say); the entry does not hold where it moves.
    """

    factor: Any
    J: Any
    rate: Any
    acceleration: Any
    at_gauge: Any
    still: Any


@dataclass(frozen=True, eq=False)
class Gauge:
    """The equations of motion about an acceleration of one's choice: Q (u' - u_dot) = force + G tau.

    u_dot, force = P - Q u_dot: n_u, SX. S and z are the same for every choice; a good one makes `force` and the
    accelerations at u_dot cheap to compute. Q, P: the matrices it holds for.
    """

    Q: Any
    P: Any
    u_dot: Any
    force: Any

    def holds_for(self, Q: Any, P: Any) -> bool:
        """Whether these are the very expressions, node for node; who adds friction to P gets no gauge."""
        return bool(ca.is_equal(self.Q, Q)) and bool(ca.is_equal(self.P, P))


class KnownRates:
    """What is known about the expressions of one mechanism; grows as the user asks for them.

    Entries are recognised by their SX node, not by their form: an expression that CasADi has rewritten beyond
    recognition is differentiated like any other. gauge: None where `at_gauge` is never to be used. frames: by name,
    position (3) and rotation (3 x 3) of a robot's frames that were asked for, in the world.
    """

    gauge: Gauge | None = None

    def __init__(self) -> None:
        self._of_q: dict[int, tuple[Any, KnownRate, int]] = {}
        self._of_u: dict[int, tuple[Any, KnownRate, int]] = {}
        self.frames: dict[str, tuple[Any, Any]] = {}

    def add(
        self,
        factor: Any,
        J: Any,
        rate: Any,
        accelerations: Sequence[Any],
        value: Any = None,
        still: Any = None,
    ) -> None:
        """Make p' = rate known, and p = value if given (a function of q); accelerations: at u' = 0 and at the gauge's.

        See KnownRate.
        """
        rate, acceleration, at_gauge = (ca.densify(x) for x in (rate, *accelerations))
        known = KnownRate(factor, J, rate, acceleration, at_gauge, ca.SX() if still is None else still)
        _enter(self._of_u, rate, known)
        if value is not None:
            _enter(self._of_q, ca.densify(value), known)

    def of_q(self, node: Any) -> tuple[KnownRate, int] | None:
        """The entry whose p a scalar SX node is, and its row."""
        found = self._of_q.get(node.__hash__())
        return None if found is None else found[1:]

    def of_u(self, node: Any) -> tuple[KnownRate, int] | None:
        """The entry whose p' a scalar SX node is, and its row."""
        found = self._of_u.get(node.__hash__())
        return None if found is None else found[1:]

    def __bool__(self) -> bool:
        return bool(self._of_u)


def _enter(table: dict[int, tuple[Any, KnownRate, int]], column: Any, known: KnownRate) -> None:
    for row in range(column.size1()):
        node = column[row]  # kept, so that its number is never another's
        if not node.is_leaf():
            table.setdefault(node.__hash__(), (node, known, row))
