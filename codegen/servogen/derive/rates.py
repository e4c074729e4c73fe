"""Time derivatives along the motion: q' = C u + D, t' = 1, and the rates of the references."""

from collections.abc import Sequence
from typing import Any

import casadi as ca

from servogen.errors import SceneError
from servogen.scene.scene import Scene
from servogen.scene.symbols import chains


def rate(
    scene: Scene,
    expression: Any,
    what: str,
    u_dot: Any = None,
    along: Sequence[tuple[Any, Any]] = (),
    undeclared_rest: bool = False,
) -> Any:
    """d/dt of a column: psi_q (C u + D) + psi_t + psi_r r', and psi_u u' where u_dot is given (Eq. 5).

    along: further (symbol, rate) pairs. One directional derivative; no Jacobian is formed. SceneError where the
    rate of a reference is needed but not declared, unless such rates are taken for zero (undeclared_rest).
    """
    mech = scene.mechanism
    moving = [(mech.q, mech.q_dot), *along]
    if u_dot is not None:
        moving.append((mech.u, u_dot))
    if mech.t is not None:
        moving.append((mech.t, ca.SX(1)))
    assert scene.references is not None
    for reference in chains(scene.references):
        for value, derivative in zip(reference.chain, reference.chain[1:], strict=False):
            moving.append((value.symbol, derivative.symbol))
        last = reference.chain[-1]
        if not undeclared_rest and reference.order > 0 and ca.depends_on(expression, last.symbol):
            name = reference.chain[0].name
            raise SceneError(
                f"{what} needs the derivative of {last.name!r}, a higher order than reference {name!r} declares; "
                f"give sg.Ref(..., order={reference.order + 1})"
            )
    symbols = ca.vertcat(*(symbol for symbol, _ in moving))
    seed = ca.vertcat(*(derivative for _, derivative in moving))
    return ca.jtimes(expression, symbols, seed)


def moving_symbols(scene: Scene) -> Any:
    """A column of every symbol with a rate: q, u, t and the references that have rates."""
    mech = scene.mechanism
    assert scene.references is not None
    references = [f.symbol for chain in chains(scene.references) if chain.order > 0 for f in chain.chain]
    return ca.vertcat(mech.q, mech.u, *([] if mech.t is None else [mech.t]), *references)
