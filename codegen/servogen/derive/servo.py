"""Servo-constraints without controls: S tau = z, Eqs. (3)-(12)."""

from typing import Any

import casadi as ca

from servogen.derive.answer import controlling
from servogen.derive.formulation import Formulation, MassFindings, Quantity, Weight
from servogen.derive.lie import Drift
from servogen.derive.limiting import limit_quantities, within_limits
from servogen.derive.passive import passive_quantities, respond
from servogen.derive.rows import behind, constraint_rows
from servogen.derive.weight import weigh
from servogen.scene.constraints import is_holonomic
from servogen.scene.convert import is_identity
from servogen.scene.samples import Samples
from servogen.scene.scene import Scene
from servogen.scene.system import NEAREST


def derive_servo(samples: Samples, found: MassFindings) -> Formulation:
    """psi, S and z; also y where it is an expression, and S L^-T with its like where there is a weight."""
    scene = samples.scene
    mech = scene.mechanism
    gauge = mech.gauge
    apart = behind(samples, found)
    rows = constraint_rows(scene, gauge, Drift(samples, found), apart)
    psi, J, X, prescribed = rows.psi, rows.J, rows.X, rows.prescribed
    # m solves with Q for the rows of psi_u, not l for the columns of G
    W, shift, mass = respond(samples, found, J, gauge)
    S = ca.mtimes(W, mech.G)
    if apart is not None:
        left = ca.mtimes(W, apart.G)
        S = ca.vertcat(*(left[k, :] if own else S[k, :] for k, own in enumerate(rows.behind)))
    force = mech.P if gauge is None else gauge.force
    weight = weigh(scene, mass)
    weighted = None
    if weight is not None and weight.of_mass and is_identity(mech.G) and not mech.passive and apart is None:
        # with N N^T = Q and G = I, S N is (N^-1 J^T)^T: half of the solve with Q, and the other half is not needed
        weighted = weight.to_sigma(J.T).T
        z = prescribed - X - rows.still_due(ca.mtimes(weighted, weight.to_sigma(force)))
    else:
        z = prescribed - X - rows.still_due(ca.mtimes(W, force)) - rows.still_due(shift)
    words, passive = _words(scene), passive_quantities(samples, found)
    limits = limit_quantities(scene, prescribed, weight)
    quantities = [
        Quantity("psi", psi, *words["psi"]),
        Quantity("S", S, *words["S"], needs_mass=True),
        Quantity("z", z, *words["z"], needs_mass=True),
        *free_quantities(scene, S, "S", "Eq. (10)", weight, weighted),
        *limits,
    ]
    entries = (("psi",), ("S",), ("z",), ("S", "z"), *((q.name,) for q in passive))
    law = within_limits(scene, controlling(scene, [*quantities, *passive], weight, entries), limits)
    return Formulation(scene, (*quantities, *passive), mass, law, weight)


def free_quantities(
    scene: Scene, matrix: Any, name: str, equation: str, weight: Weight | None, weighted: Any = None
) -> tuple[Quantity, ...]:
    """y where it is an expression; with a weight W = L L^T instead the matrix times L^-T, L^T y and L^-T itself.

    weighted: the matrix times L^-T where it is known already.
    """
    if weight is None:
        return (Quantity("y", scene.y, equation, "the free vector"),) if isinstance(scene.y, ca.SX) else ()
    W = "W = Q^-1" if weight.of_mass else "W"
    product = ca.mtimes(matrix, weight.N) if weighted is None else weighted
    needs_mass = name == "S" or weight.of_mass
    found = [
        Quantity(f"{name}_w", product, equation, f"{name} L^-T, L L^T = {W}", needs_mass),
        Quantity("recover", weight.entries, equation, "L^-T, its nonzeros", weight.of_mass),
    ]
    if scene.y is not None:
        found.append(Quantity("y_w", _free_in_sigma(scene, weight), equation, "L^T y", weight.of_mass))
    return tuple(found)


def _free_in_sigma(scene: Scene, weight: Weight) -> Any:
    """L^T y; of y = Q a - P, which a posture is, it is N^T a - N^-1 P where W is Q^-1."""
    mech = scene.mechanism
    if isinstance(scene.y, str):
        return weight.to_sigma(scene.y_symbol)
    posture = mech.posture_of(scene.y) if weight.of_mass else None
    if posture is None:
        return weight.to_sigma(scene.y)
    force, acceleration = posture
    return ca.mtimes(weight.N.T, acceleration) - weight.to_sigma(force)


def _words(scene: Scene) -> dict[str, tuple[str, str]]:
    """Equation and formula of psi, S and z for the kinds of constraints there are."""
    u = scene.mechanism.u
    if any(c.order > 1 and not is_holonomic(c, u) for c in scene.constraints):
        # the paper ends at the second derivative; a row of degree r is prescribed in its r-th
        return {
            "psi": ("", "psi(q, u, t)"),
            "S": ("", "the factor of tau in psi^(r), r the relative degree of the row"),
            "z": ("", "T0 psi + T1 psi' + ... up to psi^(r-1), less psi^(r) at tau = 0"),
        }
    words = _free_words(scene)
    if not scene.mechanism.passive:
        return words
    # The paper has no passive constraints: J and j are theirs here, and K the rows of u' in the servo-constraints.
    holonomic = [is_holonomic(c, scene.mechanism.u) for c in scene.constraints]
    K = "psi_q C" if all(holonomic) else "K" if any(holonomic) else "psi_u"
    told = ", K = psi_u or psi_q C" if K == "K" else ""
    prescribed = words["z"][1].split(" - X")[1]
    return {
        "psi": words["psi"],
        "S": ("", f"{K} N G{told}, {NEAREST}"),
        "z": ("", f"-{K} N P + {K} Q^-1 J^T A^-1 j - X{prescribed}"),
    }


def _free_words(scene: Scene) -> dict[str, tuple[str, str]]:
    holonomic = [is_holonomic(c, scene.mechanism.u) for c in scene.constraints]
    if not any(holonomic):
        return {
            "psi": ("Eq. (3)", "psi(q, u, t)"),
            "S": ("Eq. (8)", "psi_u Q^-1 G"),
            "z": ("Eq. (9)", "-psi_u Q^-1 P - X + Theta psi"),
        }
    if all(holonomic):
        return {
            "psi": ("Eq. (11)", "psi(q, t)"),
            "S": ("Eqs. (8), (12)", "psi_q C Q^-1 G"),
            "z": ("Eqs. (9), (12)", "-psi_q C Q^-1 P - X + Theta1 psi' + Theta2 psi"),
        }
    return {
        "psi": ("Eqs. (3), (11)", "psi(q, u, t), holonomic rows psi(q, t)"),
        "S": ("Eq. (8)", "J Q^-1 G, J = psi_u or psi_q C"),
        "z": ("Eqs. (9), (12)", "-J Q^-1 P - X + Theta psi or Theta1 psi' + Theta2 psi"),
    }
