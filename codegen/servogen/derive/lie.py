"""Derivatives of any order along the motion at tau = 0: repeated directional ones, Lie derivatives along the drift.

u' and its derivatives stay symbols while one differentiates: a_0 = u', a_1 = u'' and so on. Q a_0 = P differentiates to
Q a_k = b_k, where b_k is of q, u, t and the a before it. So nothing but Q's factors ever divides, and no solve is
differentiated.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import casadi as ca

from servogen.derive.formulation import MassFindings
from servogen.derive.mass import solve_with_mass
from servogen.derive.passive import accelerations
from servogen.derive.rates import rate
from servogen.scene.samples import Samples


@dataclass(frozen=True, eq=False)
class _Level:
    """a_k: its symbols (n), b_k with Q a_k = b_k, and a_k itself, of q, u, t and the symbols before it."""

    symbol: Any
    right: Any
    value: Any


class Drift:
    """The motion of a scene at tau = 0.

    Expressions on the way hold the symbols of a_0, a_1, ...; `filled` puts in what these are. With passive constraints
    u' is an expression of q, u and t from the start. undeclared_rest: rates of references that are not declared are
    zero, no error. force: another than P.
    """

    def __init__(self, samples: Samples, found: MassFindings, undeclared_rest: bool = False, force: Any = None) -> None:
        self._force = samples.scene.mechanism.P if force is None else force
        self._samples, self._found, self._scene = samples, found, samples.scene
        self._undeclared_rest = undeclared_rest
        self._levels: list[_Level] = []

    @cached_property
    def _held(self) -> Any:
        """u' under passive constraints; None where there are none."""
        passive = self._scene.mechanism.passive
        return accelerations(self._samples, self._found, self._force)[0] if passive else None

    def rate(self, expression: Any, what: str) -> Any:
        """Its time derivative at tau = 0. SceneError as derive.rates.rate's."""
        if self._held is not None:
            return self._along(expression, what, self._held)
        deepest = max((k for k, a in enumerate(self._levels) if ca.depends_on(expression, a.symbol)), default=-1)
        if deepest < 0 and not ca.depends_on(expression, self._scene.mechanism.u):
            return self._along(expression, what)
        self._reach(deepest + 1, what)
        return self._rate(expression, what, deepest + 2)

    def gradient(self, expression: Any) -> Any:
        """Its Jacobian with respect to u, m x n, the ways through u' and its derivatives included; filled."""
        u = self._scene.mechanism.u
        total = ca.jacobian(expression, u)
        through = [ca.jacobian(expression, level.symbol) for level in self._levels]
        for k in reversed(range(len(self._levels))):
            if through[k].is_zero():
                continue
            right = self._levels[k].right
            multipliers = solve_with_mass(self._scene, self._found, through[k].T, transposed=True)[0]
            total = total + ca.jtimes(right, u, multipliers, True).T
            for j in range(k):
                through[j] = through[j] + ca.jtimes(right, self._levels[j].symbol, multipliers, True).T
        return self.filled(total)[0]

    def filled(self, *expressions: Any) -> list[Any]:
        """The same of q, u, t, parameters and references alone."""
        found = list(expressions)
        for level in reversed(self._levels):
            found = ca.substitute(found, [level.symbol], [level.value])
        return found

    def _rate(self, expression: Any, what: str, count: int) -> Any:
        """The derivative where a_0 to a_(count - 1) are known, the last of which is held still."""
        symbols = [level.symbol for level in self._levels[:count]]
        return self._along(expression, what, symbols[0], list(pairwise(symbols)))

    def _along(self, expression: Any, what: str, u_dot: Any = None, pairs: Sequence[tuple[Any, Any]] = ()) -> Any:
        return rate(self._scene, expression, what, u_dot, pairs, self._undeclared_rest)

    def _reach(self, k: int, what: str) -> None:
        """Make the levels up to a_k."""
        mech = self._scene.mechanism
        while len(self._levels) <= k:
            if not self._levels:
                right = self._force
            else:
                last = self._levels[-1]
                right = -self._rate(ca.mtimes(mech.Q, last.symbol) - last.right, what, len(self._levels))
            value, _ = solve_with_mass(self._scene, self._found, right)
            self._levels.append(_Level(ca.SX.sym("a", mech.u.size1()), right, ca.densify(value)))
