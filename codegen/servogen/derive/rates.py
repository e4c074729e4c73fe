"""Time derivatives along the motion: q' = C u + D, t' = 1, and the rates of the references."""

from typing import Any

import casadi as ca

from servogen.errors import SceneError
from servogen.scene.scene import Scene
from servogen.scene.symbols import chains


def rate(scene: Scene, expression: Any, what: str, u_dot: Any = None) -> Any:
    """d/dt of a column: psi_q (C u + D) + psi_t + psi_r r', and psi_u u' where u_dot is given (Eq. 5).

    One directional derivative; no Jacobian is formed. SceneError where a reference's rate is needed but not declared.
    """
    mech = scene.mechanism
    moving = [(mech.q, mech.q_dot)]
    if u_dot is not None:
        moving.append((mech.u, u_dot))
    if mech.t is not None:
        moving.append((mech.t, ca.SX(1)))
    assert scene.references is not None
    for reference in chains(scene.references):
        for value, derivative in zip(reference.chain, reference.chain[1:], strict=False):
            moving.append((value.symbol, derivative.symbol))
        last = reference.chain[-1]
        if reference.order > 0 and ca.depends_on(expression, last.symbol):
            name = reference.chain[0].name
            remedy = f"give sg.Ref(..., order={reference.order + 1})"
            if reference.order == 2:
                remedy = f"2 is the highest; make {last.name!r} the derivative of a reference of its own"
            raise SceneError(
                f"{what} needs the derivative of {last.name!r}, a higher order than reference {name!r} declares; "
                f"{remedy}"
            )
    along = ca.vertcat(*(symbol for symbol, _ in moving))
    seed = ca.vertcat(*(derivative for _, derivative in moving))
    return ca.jtimes(expression, along, seed)
