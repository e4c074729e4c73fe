"""Servo-constraints without controls: S tau = z, Eqs. (3)-(12)."""

from typing import Any

import casadi as ca

from servogen.derive.formulation import Formulation, Quantity
from servogen.derive.known import holonomic_rates, nonholonomic_rates
from servogen.derive.mass import solve_with_mass
from servogen.scene.constraints import ControlsInvolved, Holonomic
from servogen.scene.scene import Scene


def derive_servo(scene: Scene) -> Formulation:
    """psi, S and z; also y where it is an expression."""
    mech = scene.mechanism
    rows = [_rows(scene, c) for c in scene.constraints]
    psi, J, X, prescribed = (ca.vertcat(*parts) for parts in zip(*rows, strict=True))
    # m solves with Q for the rows of psi_u, not l for the columns of G
    W_transposed, mass = solve_with_mass(scene, J.T, transposed=True)
    W = W_transposed.T
    S = ca.mtimes(W, mech.G)
    z = prescribed - X - ca.mtimes(W, mech.P)
    quantities = [
        Quantity("psi", psi, "Eqs. (3), (11)", "psi(q, u, t)"),
        Quantity("S", S, "Eq. (8)", "psi_u Q^-1 G", needs_mass=True),
        Quantity("z", z, "Eq. (9)", "-psi_u Q^-1 P - X + Theta psi", needs_mass=True),
    ]
    if isinstance(scene.y, ca.SX):
        quantities.append(Quantity("y", scene.y, "Eq. (10)", "the free vector"))
    return Formulation(scene, tuple(quantities), mass)


def _rows(scene: Scene, constraint: Any) -> tuple[Any, Any, Any, Any]:
    """psi, and J, X, right side of  J u' + X = right side  for one constraint."""
    assert not isinstance(constraint, ControlsInvolved)
    what, psi = f"constraint {constraint.name!r}", constraint.psi
    if isinstance(constraint, Holonomic):
        psi_dot, J, X = holonomic_rates(scene, psi, what)
        return psi, J, X, ca.mtimes(constraint.Theta1, psi_dot) + ca.mtimes(constraint.Theta2, psi)
    J, psi_dot = nonholonomic_rates(scene, psi, what)
    return psi, J, psi_dot, ca.mtimes(constraint.Theta, psi)
