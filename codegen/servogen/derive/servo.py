"""Servo-constraints without controls: S tau = z, Eqs. (3)-(12)."""

from typing import Any

import casadi as ca

from servogen.derive.answer import controlling
from servogen.derive.constraint_rates import holonomic_rates, nonholonomic_rates
from servogen.derive.formulation import Formulation, MassFindings, Quantity, Weight
from servogen.derive.limiting import limit_quantities, within_limits
from servogen.derive.passive import passive_quantities, respond
from servogen.derive.weight import weigh
from servogen.scene.constraints import ControlsInvolved, Holonomic
from servogen.scene.convert import is_identity
from servogen.scene.known_rates import Gauge
from servogen.scene.samples import Samples
from servogen.scene.scene import Scene
from servogen.scene.system import NEAREST


def derive_servo(samples: Samples, found: MassFindings) -> Formulation:
    """psi, S and z; also y where it is an expression, and S L^-T with its like where there is a weight."""
    scene = samples.scene
    mech = scene.mechanism
    gauge = mech.gauge
    psi, J, X, prescribed = constraint_rows(scene, gauge)
    # m solves with Q for the rows of psi_u, not l for the columns of G
    W, shift, mass = respond(samples, found, J, gauge)
    S = ca.mtimes(W, mech.G)
    force = mech.P if gauge is None else gauge.force
    weight = weigh(scene, mass)
    weighted = None
    if weight is not None and weight.of_mass and is_identity(mech.G) and not mech.passive:
        # with N N^T = Q and G = I, S N is (N^-1 J^T)^T: half of the solve with Q, and the other half is not needed
        weighted = weight.to_sigma(J.T).T
        z = prescribed - X - ca.mtimes(weighted, weight.to_sigma(force))
    else:
        z = prescribed - X - ca.mtimes(W, force) - shift
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


def constraint_rows(scene: Scene, gauge: Gauge | None = None) -> tuple[Any, Any, Any, Any]:
    """psi, and J, X, right side of  J u' + X = right side  for all constraints, in the order given.

    With a gauge, X is that of  J (u' - gauge.u_dot) + X = right side.
    """
    rows = [_rows(scene, c, gauge) for c in scene.constraints]
    psi, J, X, prescribed = (ca.vertcat(*parts) for parts in zip(*rows, strict=True))
    return psi, J, X, prescribed


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
    words = _free_words(scene)
    if not scene.mechanism.passive:
        return words
    # The paper has no passive constraints: J and j are theirs here, and K the rows of u' in the servo-constraints.
    holonomic = [isinstance(c, Holonomic) for c in scene.constraints]
    K = "psi_q C" if all(holonomic) else "K" if any(holonomic) else "psi_u"
    told = ", K = psi_u or psi_q C" if K == "K" else ""
    prescribed = words["z"][1].split(" - X")[1]
    return {
        "psi": words["psi"],
        "S": ("", f"{K} N G{told}, {NEAREST}"),
        "z": ("", f"-{K} N P + {K} Q^-1 J^T A^-1 j - X{prescribed}"),
    }


def _free_words(scene: Scene) -> dict[str, tuple[str, str]]:
    holonomic = [isinstance(c, Holonomic) for c in scene.constraints]
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


def _rows(scene: Scene, constraint: Any, gauge: Gauge | None) -> tuple[Any, Any, Any, Any]:
    """psi, J, X and right side as in constraint_rows, for one constraint."""
    assert not isinstance(constraint, ControlsInvolved)
    what, psi = f"constraint {constraint.name!r}", constraint.psi
    if isinstance(constraint, Holonomic):
        psi_dot, J, X = holonomic_rates(scene, psi, what, gauge)
        return psi, J, X, ca.mtimes(constraint.Theta1, psi_dot) + ca.mtimes(constraint.Theta2, psi)
    J, psi_dot = nonholonomic_rates(scene, psi, what, gauge)
    return psi, J, psi_dot, ca.mtimes(constraint.Theta, psi)
