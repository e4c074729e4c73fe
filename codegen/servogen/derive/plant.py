"""The mechanism itself, for closed-loop simulation: q' and u', Eqs. (1)-(2)."""

import casadi as ca

from servogen.derive.formulation import MassFindings, MassTreatment, Quantity
from servogen.derive.passive import HELD, accelerations
from servogen.scene.samples import draw_samples
from servogen.scene.scene import Scene


def derive_plant(scene: Scene, found: MassFindings) -> tuple[tuple[Quantity, ...], MassTreatment]:
    """q_dot = C u + D and u_dot = Q^-1 (P + G tau), of q, u, t, tau and the parameters."""
    mech = scene.mechanism
    u_dot, mass = accelerations(draw_samples(scene), found, mech.P + ca.mtimes(mech.G, mech.tau), stabilised=True)
    held = HELD if mech.passive else ""
    return (
        Quantity("q_dot", mech.q_dot, "Eq. (1)", "C u + D"),
        Quantity("u_dot", u_dot, "" if mech.passive else "Eq. (2)", f"Q^-1 (P + G tau{held})", needs_mass=True),
    ), mass
