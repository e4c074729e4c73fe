"""S, z and tau in CasADi as a user without servogen would write them: Jacobians, ca.solve and ca.pinv."""

from typing import Any

import casadi as ca

from servogen.bench.results import Output
from servogen.scene.constraints import ControlsInvolved, Holonomic
from servogen.scene.scene import Scene
from servogen.scene.symbols import chains

PARAMETERS = "p"


def arguments(scene: Scene) -> list[tuple[str, Any]]:
    """(name, symbol) of the functions' arguments: every input of the scene, then all parameters in one column."""
    fields = [(f.name, f.symbol) for f in scene.input_fields()]
    return [*fields, (PARAMETERS, ca.vertcat(ca.SX(0, 1), *(f.symbol for f in scene.parameters)))]


def expressions(scene: Scene, ldlt: bool = False) -> dict[Output, Any]:
    """Dense SX of the matrix (m x l), the right side (m) and the answer (l), Eqs. (8)-(10), (39)-(41).

    The system is the matrix, row by row, then the right side. Of ideal control forces R (n) and the answer alone, Eqs.
    (16)-(17). ldlt: Q is factorised once, as an expert would, and solved with for the rows of psi_u; else `ca.solve`
    does what it does.
    """
    if scene.system.tau_is_state:
        S, z = _controls(scene)
    elif scene.system.matrix_is_given:
        S, z = _ideal(scene)
    else:
        S, z = _servo(scene, ldlt)
    inverse = ca.pinv(S) if scene.weight is None else _weighted_inverse(S, scene)
    if scene.y is None:
        tau = ca.mtimes(inverse, z)
    else:
        y = scene.y_symbol if isinstance(scene.y, str) else scene.y
        tau = y + ca.mtimes(inverse, z - ca.mtimes(S, y))
    system = ca.vertcat(ca.vec(ca.densify(S).T), z)
    found = {Output.MATRIX: S, Output.RIGHT: z, Output.SYSTEM: system, Output.ANSWER: tau}
    if scene.system.matrix_is_given:
        del found[Output.MATRIX], found[Output.SYSTEM]  # G, as the user wrote it
    return {output: ca.densify(expression) for output, expression in found.items()}


def _weighted_inverse(S: Any, scene: Scene) -> Any:
    """W^-1 S^T (S W^-1 S^T)^-1."""
    right = ca.mtimes(scene.mechanism.Q, S.T) if scene.weighs_by_inverse_mass else ca.solve(scene.weight, S.T)
    return ca.mtimes(right, ca.inv(ca.mtimes(S, right)))


def function(scene: Scene, name: str, expression: Any, cse: bool) -> Any:
    """One CasADi function of the scene's arguments, its common subexpressions found first where asked for."""
    result = ca.cse(expression) if cse else expression
    return ca.Function(name, [symbol for _, symbol in arguments(scene)], [result])


def _servo(scene: Scene, ldlt: bool) -> tuple[Any, Any]:
    mech = scene.mechanism
    psi_u, rest = _rows(scene)
    if ldlt:
        W = ca.ldl_solve(psi_u.T, *ca.ldl(mech.Q)).T
        return ca.mtimes(W, mech.G), rest - ca.mtimes(W, mech.P)
    return ca.mtimes(psi_u, ca.solve(mech.Q, mech.G)), rest - ca.mtimes(psi_u, ca.solve(mech.Q, mech.P))


def _ideal(scene: Scene) -> tuple[Any, Any]:
    mech = scene.mechanism
    J, b = _rows(scene)
    inertia = ca.mtimes(J, ca.solve(mech.Q, J.T))
    return mech.G, ca.mtimes(J.T, ca.solve(inertia, b - ca.mtimes(J, ca.solve(mech.Q, mech.P))))


def _rows(scene: Scene) -> tuple[Any, Any]:
    """J and b of the rows J u' = b."""
    mech = scene.mechanism
    J, X, prescribed = [], [], []
    for c in scene.constraints:
        assert not isinstance(c, ControlsInvolved)
        psi_dot = _drift(scene, c.psi)
        if isinstance(c, Holonomic):
            J.append(ca.jacobian(psi_dot, mech.u))
            X.append(_drift(scene, psi_dot))
            prescribed.append(ca.mtimes(c.Theta1, psi_dot) + ca.mtimes(c.Theta2, c.psi))
        else:
            J.append(ca.jacobian(c.psi, mech.u))
            X.append(psi_dot)
            prescribed.append(ca.mtimes(c.Theta, c.psi))
    return ca.vertcat(*J), ca.vertcat(*prescribed) - ca.vertcat(*X)


def _controls(scene: Scene) -> tuple[Any, Any]:
    mech = scene.mechanism
    phi = ca.vertcat(*(c.phi for c in scene.constraints if isinstance(c, ControlsInvolved)))
    prescribed = [ca.mtimes(c.Theta, c.phi) for c in scene.constraints if isinstance(c, ControlsInvolved)]
    u_dot = ca.solve(mech.Q, mech.P + ca.mtimes(mech.G, mech.tau))
    B = ca.vertcat(*prescribed) - _drift(scene, phi) - ca.mtimes(ca.jacobian(phi, mech.u), u_dot)
    return ca.jacobian(phi, mech.tau), B


def _drift(scene: Scene, psi: Any) -> Any:
    """psi_q q' + psi_t + psi_r r', Eq. (5), without the term of u'."""
    mech = scene.mechanism
    drift = ca.mtimes(ca.jacobian(psi, mech.q), mech.q_dot)
    if mech.t is not None:
        drift += ca.jacobian(psi, mech.t)
    assert scene.references is not None
    for reference in chains(scene.references):
        for value, derivative in zip(reference.chain, reference.chain[1:], strict=False):
            drift += ca.mtimes(ca.jacobian(psi, value.symbol), derivative.symbol)
    return drift
