"""S, z and tau in CasADi as a user without servogen would write them: Jacobians, ca.solve and ca.pinv."""

from typing import Any

import casadi as ca

from servogen.bench.results import Output
from servogen.scene.scene import Scene
from servogen.twins.reference import textbook_system

PARAMETERS = "p"


def arguments(scene: Scene) -> list[tuple[str, Any]]:
    """(name, symbol) of the functions' arguments: every input of the scene, then all parameters in one column."""
    fields = [(f.name, f.symbol) for f in scene.input_fields()]
    return [*fields, (PARAMETERS, ca.vertcat(ca.SX(0, 1), *(f.symbol for f in scene.parameters)))]


def expressions(scene: Scene, ldlt: bool = False) -> dict[Output, Any]:
    """Dense SX of the matrix (m x l), the right side (m) and the answer (l), Eqs. (8)-(10), (39)-(41).

    The system is the matrix, row by row, then the right side. Of ideal control forces R (n) and the answer alone, Eqs.
    (16)-(17); no answer where there are priorities. ldlt: Q is factorised once, as an expert would, and solved with for
    the rows of psi_u; else `ca.solve` does what it does.
    """
    Q = scene.mechanism.Q
    factors = ca.ldl(Q) if ldlt else ()
    S, z = textbook_system(scene, lambda X: ca.ldl_solve(X, *factors) if ldlt else ca.solve(Q, X), rows=ldlt)
    inverse = ca.pinv(S) if scene.weight is None else _weighted_inverse(S, scene)
    if scene.y is None:
        tau = ca.mtimes(inverse, z)
    else:
        y = scene.y_symbol if isinstance(scene.y, str) else scene.y
        tau = y + ca.mtimes(inverse, z - ca.mtimes(S, y))
    system = ca.vertcat(ca.vec(ca.densify(S).T), z)
    found = {Output.MATRIX: S, Output.RIGHT: z, Output.SYSTEM: system, Output.ANSWER: tau}
    if scene.cascaded:
        del found[Output.ANSWER]  # an expression cannot follow the ranks of its levels
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
