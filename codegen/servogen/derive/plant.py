"""The mechanism itself, for closed-loop simulation: q' and u', Eqs. (1)-(2)."""

import casadi as ca

from servogen.derive.formulation import MassFindings, MassTreatment, Quantity
from servogen.derive.mass import solve_with_mass
from servogen.scene.scene import Scene


def derive_plant(scene: Scene, found: MassFindings) -> tuple[tuple[Quantity, ...], MassTreatment]:
    """q_dot = C u + D and u_dot = Q^-1 (P + G tau), of q, u, t, tau and the parameters."""
    mech = scene.mechanism
    u_dot, mass = solve_with_mass(scene, found, mech.P + ca.mtimes(mech.G, mech.tau))
    return (
        Quantity("q_dot", mech.q_dot, "Eq. (1)", "C u + D"),
        Quantity("u_dot", u_dot, "Eq. (2)", "Q^-1 (P + G tau)", needs_mass=True),
    ), mass
