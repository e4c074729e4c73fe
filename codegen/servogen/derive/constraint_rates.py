"""Constraints on quantities with known rates: the chain rule stops there, and geometric Jacobians take over."""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from servogen.derive.rates import moving_symbols, rate
from servogen.scene.known_rates import Gauge, KnownRate
from servogen.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class Cut:
    """One scalar that was cut out of an expression: a symbol in its place, and the entry it belongs to."""

    node: Any
    symbol: Any
    known: KnownRate
    row: int
    is_rate: bool

    def acceleration(self, gauge: Gauge | None) -> Any:
        """p'' at u' = 0, or at the gauge's u'."""
        return (self.known.acceleration if gauge is None else self.known.at_gauge)[self.row]

    def derivative(self, gauge: Gauge | None) -> Any:
        """Of the scalar, at u' = 0 or the gauge's u'."""
        return self.acceleration(gauge) if self.is_rate else self.known.rate[self.row]


def holonomic_rates(scene: Scene, psi: Any, what: str, gauge: Gauge | None = None) -> tuple[Any, Any, Any]:
    """psi', its Jacobian with respect to u, and psi'' at u' = 0 or the gauge's u', of a psi(q, t): Eqs. (11)-(12)."""
    shell, cuts = cut(scene, psi)
    speeds = [ca.SX.sym("p_dot") for _ in cuts]
    moving = [(c.symbol, speed) for c, speed in zip(cuts, speeds, strict=True)]
    psi_dot = rate(scene, shell, what, along=moving)
    accelerations = [c.acceleration(gauge) for c in cuts]
    X = rate(scene, psi_dot, what, _u_dot(gauge), along=[*moving, *zip(speeds, accelerations, strict=True)])
    values = [c.node for c in cuts] + [c.derivative(gauge) for c in cuts]
    symbols = [c.symbol for c in cuts] + speeds

    def filled(expression: Any) -> Any:
        return _filled(expression, symbols, values)

    J = ca.jacobian(psi_dot, scene.mechanism.u)
    return filled(psi_dot), filled(J) + _through(filled, psi_dot, speeds, cuts), filled(X)


def nonholonomic_rates(scene: Scene, psi: Any, what: str, gauge: Gauge | None = None) -> tuple[Any, Any]:
    """The Jacobian of a psi(q, u, t) with respect to u, and psi' at u' = 0 or the gauge's u': Eqs. (4)-(6)."""
    shell, cuts = cut(scene, psi)
    X = rate(scene, shell, what, _u_dot(gauge), along=[(c.symbol, c.derivative(gauge)) for c in cuts])
    symbols, values = [c.symbol for c in cuts], [c.node for c in cuts]

    def filled(expression: Any) -> Any:
        return _filled(expression, symbols, values)

    speeds = [c for c in cuts if c.is_rate]
    J = filled(ca.jacobian(shell, scene.mechanism.u))
    return J + _through(filled, shell, [c.symbol for c in speeds], speeds), filled(X)


def _u_dot(gauge: Gauge | None) -> Any:
    return None if gauge is None else gauge.u_dot


def cut(scene: Scene, expression: Any) -> tuple[Any, list[Cut]]:
    """The expression with a fresh symbol for each scalar whose rate is known, and what the symbols stand for."""
    known = scene.mechanism.known_rates
    if not known:
        return expression, []
    moving = moving_symbols(scene)
    cuts: list[Cut] = []
    rebuilt: dict[int, Any] = {}
    waiting = [expression[k] for k in range(expression.size1())]
    while waiting:
        node = waiting[-1]
        key = node.__hash__()
        if key in rebuilt:
            waiting.pop()
            continue
        for found, is_rate in ((known.of_q(node), False), (known.of_u(node), True)):
            if found is not None and key not in rebuilt and not ca.depends_on(found[0].still, moving):
                cuts.append(Cut(node, ca.SX.sym("p"), *found, is_rate))
                rebuilt[key] = cuts[-1].symbol
        if key in rebuilt:
            continue
        parts = [node.dep(k) for k in range(node.n_dep())]
        missing = [part for part in parts if part.__hash__() not in rebuilt]
        if missing:
            waiting += missing
        elif any(rebuilt[part.__hash__()] is not part for part in parts):
            rebuilt[key] = _again(node, [rebuilt[part.__hash__()] for part in parts])
        else:
            rebuilt[key] = node
    return ca.vertcat(*(rebuilt[expression[k].__hash__()] for k in range(expression.size1()))), cuts


def _again(node: Any, parts: list[Any]) -> Any:
    return ca.SX.unary(node.op(), *parts) if len(parts) == 1 else ca.SX.binary(node.op(), *parts)


def _filled(expression: Any, symbols: list[Any], values: list[Any]) -> Any:
    return ca.substitute(expression, ca.vertcat(*symbols), ca.vertcat(*values)) if symbols else expression


def _through(filled: Any, expression: Any, speeds: list[Any], cuts: list[Cut]) -> Any:
    """What the rates p' of the cuts, standing in an expression as `speeds`, add to its Jacobian with respect to u."""
    total: Any = 0
    for known in {id(c.known): c.known for c in cuts}.values():
        mine = [(speed, c.row) for speed, c in zip(speeds, cuts, strict=True) if c.known is known]
        gradient = filled(ca.jacobian(expression, ca.vertcat(*(speed for speed, _ in mine))))
        factor = ca.vertcat(*(known.factor[row, :] for _, row in mine))
        total = total + ca.mtimes(ca.mtimes(gradient, factor), known.J)
    return total
