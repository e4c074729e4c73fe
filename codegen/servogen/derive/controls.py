"""Controls-involved servo-constraints: A tau' = B, Eqs. (36)-(41)."""

from dataclasses import replace
from typing import Any

import casadi as ca

from servogen.derive.answer import controlling
from servogen.derive.formulation import Formulation, MassFindings, Quantity
from servogen.derive.passive import HELD, accelerations, passive_quantities
from servogen.derive.rates import rate
from servogen.derive.servo import free_quantities
from servogen.derive.weight import weigh
from servogen.law.law import Law, Routine
from servogen.law.steps import STATE, SYSTEM, Advance, Call, Project
from servogen.scene.constraints import ControlsInvolved
from servogen.scene.samples import Samples

BENT_CAP = 25
"""Steps of a projection where phi is not affine in tau; Newton's method ends in far fewer or not at all."""

AFFINE_CAP = 2
"""Steps of a projection where it is: one is exact, another takes back the rounding of a start far away."""


def derive_controls(samples: Samples, found: MassFindings) -> Formulation:
    """phi, A and B; also y where it is an expression."""
    scene = samples.scene
    mech = scene.mechanism
    u_dot, mass = accelerations(samples, found, mech.P + ca.mtimes(mech.G, mech.tau))
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
            "" if mech.passive else "Eq. (40)",
            f"-phi_q (C u + D) - phi_u Q^-1 (P + G tau{HELD if mech.passive else ''}) - phi_t"
            + (" + Theta phi" if damped else ""),
            needs_mass=True,
        ),
    ]
    weight = weigh(scene, mass)
    quantities += free_quantities(scene, A, "A", "Eq. (54)", weight)
    bends, places = curvature(phi, mech.tau)
    if places:
        quantities.append(Quantity("curvature", bends, "Eq. (36)", "phi_tau_tau, its nonzeros"))
    passive = passive_quantities(samples, found)
    quantities += passive
    entries = (("phi",), ("A",), ("B",), ("A", "B"), *((q.name,) for q in passive))
    law = controlling(scene, quantities, weight, entries)
    law = _with_projection(law, scene.controls, places)
    return Formulation(scene, tuple(quantities), mass, law, weight)


def _with_projection(law: Law, l: int, places: tuple[tuple[int, int, int], ...]) -> Law:
    """project, the nearest tau with phi = 0, and step: tau advanced along tau' and projected."""
    nearest = Project(
        "tau",
        SYSTEM,
        of=f"{STATE}tau",
        value="phi",
        matrix="A",
        cap=BENT_CAP if places else AFFINE_CAP,
        curvature="curvature" if places else "",
        places=places,
    )
    tick = (
        Call("tau_dot", "control"),
        Advance("moved", of=f"{STATE}tau", rate="tau_dot", dt="dt"),
        Call("tau", "project", moved=("tau", "moved")),
    )
    routines = (
        *law.routines,
        Routine("project", (nearest,), "tau"),
        Routine("step", tick, "tau", arguments=(("dt", (1, 1)),)),
    )
    return replace(law, inputs=(*law.inputs, ("tau", (l, 1))), routines=routines)


def curvature(phi: Any, tau: Any) -> tuple[Any, tuple[tuple[int, int, int], ...]]:
    """Second derivatives of phi by tau, a column of the nonzero ones, and (row of phi, i, j <= i) of each."""
    bends, places = [], []
    for row in range(phi.size1()):
        H = ca.tril(ca.sparsify(ca.hessian(phi[row], tau)[0]))
        places += [(row, i, j) for i, j in zip(*H.sparsity().get_triplet(), strict=True)]
        bends += H.nonzeros()
    return ca.vertcat(*bends), tuple(places)
