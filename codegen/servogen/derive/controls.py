"""Controls-involved servo-constraints: A tau' = B, Eqs. (36)-(41)."""

from typing import Any

import casadi as ca

from servogen.derive.formulation import Formulation, Quantity
from servogen.derive.mass import solve_with_mass
from servogen.derive.rates import rate
from servogen.derive.servo import free_quantities
from servogen.derive.weight import weigh
from servogen.scene.constraints import ControlsInvolved
from servogen.scene.scene import Scene


def derive_controls(scene: Scene) -> Formulation:
    """phi, A and B; also y where it is an expression."""
    mech = scene.mechanism
    u_dot, mass = solve_with_mass(scene, mech.P + ca.mtimes(mech.G, mech.tau))
    phi, B = [], []
    for c in scene.constraints:
        assert isinstance(c, ControlsInvolved)
        phi.append(c.phi)
        # every term of Eq. (40) is one directional derivative along the motion
        B.append(ca.mtimes(c.Theta, c.phi) - rate(scene, c.phi, f"constraint {c.name!r}", u_dot))
    phi = ca.vertcat(*phi)
    damped = any(not c.Theta.is_zero() for c in scene.constraints if isinstance(c, ControlsInvolved))
    A = ca.jacobian(phi, mech.tau)
    quantities = [
        Quantity("phi", phi, "Eq. (36)", "phi(q, u, tau, t)"),
        Quantity("A", A, "Eq. (39)", "phi_tau"),
        Quantity(
            "B",
            ca.vertcat(*B),
            "Eq. (40)",
            "-phi_q (C u + D) - phi_u Q^-1 (P + G tau) - phi_t" + (" + Theta phi" if damped else ""),
            needs_mass=True,
        ),
    ]
    weight = weigh(scene, mass)
    quantities += free_quantities(scene, A, "A", "Eq. (54)", weight)
    bends, places = curvature(phi, mech.tau)
    if places:
        quantities.append(Quantity("curvature", bends, "Eq. (36)", "phi_tau_tau, its nonzeros"))
    return Formulation(scene, tuple(quantities), mass, weight=weight, curvature=places)


def curvature(phi: Any, tau: Any) -> tuple[Any, tuple[tuple[int, int, int], ...]]:
    """Second derivatives of phi by tau, a column of the nonzero ones, and (row of phi, i, j <= i) of each."""
    bends, places = [], []
    for row in range(phi.size1()):
        H = ca.tril(ca.sparsify(ca.hessian(phi[row], tau)[0]))
        places += [(row, i, j) for i, j in zip(*H.sparsity().get_triplet(), strict=True)]
        bends += H.nonzeros()
    return ca.vertcat(*bends), tuple(places)
