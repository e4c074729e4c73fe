"""A mechanism with passive constraints as one without: Q u' = P + G tau + J^T lam with J u' + j = 0.

lam = -A^-1 (J Q^-1 (P + G tau) + j) with A = J Q^-1 J^T; no inverse is formed: Q is solved with once for all, then A,
both by LDL^T. Who asks for rows K of K u' gets W and a shift, K u' = W (P + G tau) + shift, and need not know.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from servogen.derive.constraint_rates import holonomic_rates, nonholonomic_rates
from servogen.derive.formulation import MassFindings, MassTreatment, Quantity
from servogen.derive.mass import solve_definite, solve_with_mass
from servogen.errors import SceneError
from servogen.results import FloatArray
from servogen.scene.closing import Closer
from servogen.scene.known_rates import Gauge
from servogen.scene.passive import PassiveHolonomic
from servogen.scene.samples import AT_DEFAULTS, Samples
from servogen.scene.scene import Scene

HELD = " + J^T lam"
"""What stands beside P + G tau in a formula."""

_NEGLIGIBLE = 1e-9
"""Of rows brought to length one: what is left of one that the others make up already is not larger."""


@dataclass(frozen=True, eq=False)
class Closure:
    """J u' + j = 0 (at the gauge's u' where there is one), its values, and those of the rates of holonomic rows."""

    J: Any
    j: Any
    chi: Any
    chi_dot: Any


def closure_of(scene: Scene, gauge: Gauge | None = None, stabilised: bool = False) -> Closure:
    """All passive constraints, in the order given. stabilised: as in the plant of a simulation."""
    parts: list[tuple[Any, Any]] = []
    values, speeds = [], [ca.SX(0, 1)]
    for c in scene.mechanism.passive:
        what = f"passive constraint {c.name!r}"
        values.append(c.chi)
        if isinstance(c, PassiveHolonomic):
            chi_dot, J, j = holonomic_rates(scene, c.chi, what, gauge)
            speeds.append(chi_dot)
            pull = 2 * c.stabilise * chi_dot + c.stabilise**2 * c.chi
        else:
            J, j = nonholonomic_rates(scene, c.chi, what, gauge)
            pull = c.stabilise * c.chi
        parts.append((J, j + pull if stabilised and not c.stabilise.is_zero() else j))
    J, j = (ca.densify(ca.vertcat(*column)) for column in zip(*parts, strict=True))
    return Closure(J, j, ca.vertcat(*values), ca.vertcat(*speeds))


def respond(
    samples: Samples, found: MassFindings, K: Any, gauge: Gauge | None = None
) -> tuple[Any, Any, MassTreatment]:
    """W and shift with K u' = W (P + G tau) + shift, for rows K; about the gauge's u' and force where there is one."""
    scene = samples.scene
    if not scene.mechanism.passive:
        W_transposed, mass = solve_with_mass(scene, found, K.T, transposed=True)
        return W_transposed.T, ca.SX.zeros(K.size1()), mass
    closure = closure_of(scene, gauge)
    kept = independent_rows(samples)
    J, j = closure.J[kept, :], closure.j[kept]
    m = K.size1()
    both, mass = _solve_definite_mass(samples, found, ca.horzcat(K.T, J.T))
    V, held = both[:, :m], both[:, m:]
    A = _gram(held, J)
    Y, mass = _solve_closure(samples, A, ca.mtimes(J, V), mass)  # A^-1 J Q^-1 K^T
    return (V - ca.mtimes(held, Y)).T, -ca.mtimes(Y.T, j), mass


def accelerations(
    samples: Samples, found: MassFindings, force: Any, stabilised: bool = False
) -> tuple[Any, MassTreatment]:
    """u' under `force`, P + G tau. stabilised: as in the plant of a simulation."""
    scene = samples.scene
    if not scene.mechanism.passive:
        return solve_with_mass(scene, found, force)
    closure = closure_of(scene, stabilised=stabilised)
    kept = independent_rows(samples)
    J, j = closure.J[kept, :], closure.j[kept]
    both, mass = _solve_definite_mass(samples, found, ca.horzcat(force, J.T))
    free, held = both[:, 0], both[:, 1:]
    lam, mass = _solve_closure(samples, _gram(held, J), -(ca.mtimes(J, free) + j), mass)
    return free + ca.mtimes(held, lam), mass


def passive_quantities(samples: Samples, found: MassFindings) -> tuple[Quantity, ...]:
    """lam, of the state and tau, and closure: chi, then chi' of the holonomic rows; nothing where all is free."""
    scene, mech = samples.scene, samples.scene.mechanism
    if not mech.passive:
        return ()
    closure = closure_of(scene)
    kept = independent_rows(samples)
    J, j = closure.J[kept, :], closure.j[kept]
    both, mass = _solve_definite_mass(samples, found, ca.horzcat(mech.P + ca.mtimes(mech.G, mech.tau), J.T))
    lam, _ = _solve_closure(samples, _gram(both[:, 1:], J), -(ca.mtimes(J, both[:, 0]) + j), mass)
    if len(kept) < closure.J.size1():
        lam = _least(closure.J, J, lam)
    return (
        Quantity("lam", lam, "", "-(J Q^-1 J^T)^-1 (J Q^-1 (P + G tau) + j)", needs_mass=True),
        Quantity("closure", ca.vertcat(closure.chi, closure.chi_dot), "", "chi, and chi' of holonomic rows"),
    )


@lru_cache(maxsize=16)
def independent_rows(samples: Samples) -> list[int]:
    """Rows of J that are independent over the domain and make up all others: by pivoting over the states examined.

    Each state is brought onto the constraints as the parameters drawn with it make them, for rows that are dependent
    at the defaults alone are dependent no more once a parameter changes. SceneError for these, where all rows vanish,
    and where J is not finite.
    """
    scene = samples.scene
    J = closure_of(scene).J
    states, good = Closer(scene).close(samples.examined | samples.parameters)
    values = replace(samples, examined=states).values(J)
    finite = np.all(np.isfinite(values), axis=(1, 2))
    usual = np.arange(len(values)) < AT_DEFAULTS
    if not np.any(finite & usual):
        raise SceneError("passive: J is not finite at any state drawn from the domain; give a domain in which it is")
    taken, at_defaults = _pivots(values[finite & (usual | good)]), _pivots(values[finite & usual])
    labels = row_labels(scene)
    if not taken:
        raise SceneError(f"{labels[0]} does not depend on the motion; give one that does")
    if len(at_defaults) < len(taken):
        more = next(k for k in taken if k not in at_defaults)
        raise SceneError(
            f"{labels[more]} depends on the other passive constraints at the parameters' defaults, but not at others: "
            "leave it out, or write it with the same parameters as those, so that it always does"
        )
    return taken


def left_out(samples: Samples) -> tuple[str, ...]:
    """A remark on each row of chi that the other ones make up already."""
    if not samples.scene.mechanism.passive:
        return ()
    kept = independent_rows(samples)
    return tuple(
        f"{label} is left out, for the others make it up already at every state examined; leave it out of chi, too"
        for k, label in enumerate(row_labels(samples.scene))
        if k not in kept
    )


def row_labels(scene: Scene) -> list[str]:
    """What each row of chi is called in a message."""
    return [
        f"passive constraint {c.name!r}: " + ("chi" if c.chi.size1() == 1 else f"row {k + 1} of chi")
        for c in scene.mechanism.passive
        for k in range(c.chi.size1())
    ]


def _pivots(values: FloatArray) -> list[int]:
    """Rows of the matrices (N, p, n) that make up all others."""
    size = np.linalg.norm(values, axis=2, keepdims=True)
    rest = values / np.where(size == 0, 1, size)
    taken: list[int] = []
    while len(taken) < values.shape[1]:
        lengths = np.sqrt(np.sum(rest**2, axis=2))
        score = np.exp(np.mean(np.log(lengths + 1e-12), axis=0))
        score[taken] = -1.0
        best = int(np.argmax(score > (1 - _NEGLIGIBLE) * np.max(score)))
        if np.max(lengths[:, best]) <= _NEGLIGIBLE * 100:
            break
        taken.append(best)
        row = rest[:, best, :] / np.maximum(lengths[:, best, None], 1e-300)
        rest = rest - np.einsum("sij,sj->si", rest, row)[:, :, None] * row[:, None, :]
    return sorted(taken)


def _least(J: Any, kept: Any, lam: Any) -> Any:
    """The multipliers of all rows with the least norm: J = B J_kept, and B^T lam is what the kept rows have."""
    inner, _ = solve_definite(_gram(kept.T, kept), ca.mtimes(kept, J.T))
    B = inner.T
    shared, _ = solve_definite(_gram(B, B.T), lam)
    return ca.mtimes(B, shared)


def _solve_definite_mass(samples: Samples, found: MassFindings, right: Any) -> tuple[Any, MassTreatment]:
    X, mass = solve_with_mass(samples.scene, found, right)
    if mass.factor is None:
        raise SceneError(
            f"passive constraints need a Q that is symmetric and positive definite; {mass.reason.split(':')[0]}. "
            "Write Q[j, i] as the same expression as Q[i, j], or narrow the domain"
        )
    return X, mass


def _gram(X: Any, J: Any) -> Any:
    """J X, known to be symmetric: each pair of entries once."""
    return ca.triu2symm(ca.triu(ca.densify(ca.mtimes(J, X))))


def _solve_closure(samples: Samples, A: Any, right: Any, mass: MassTreatment) -> tuple[Any, MassTreatment]:
    """A^-1 right; A's pivots join those of Q.

    Where J loses rank, a dead centre, a whole row of it may vanish, and with that its entry on A's diagonal: so pivots
    are judged by the largest such entry over the domain.
    """
    X, own = solve_definite(A, right)
    values = samples.values(ca.diag(A))
    largest = np.max(np.where(np.isfinite(values), values, 0.0), axis=(0, 2))
    scales = (*mass.scales, *(ca.SX(float(f"{size:.3g}")) for size in largest))
    pivots = (*mass.pivots, *own.pivots)
    reason = f"{mass.reason}; passive constraints: one LDL^T of J Q^-1 J^T, {A.size1()}x{A.size1()}"
    return X, replace(mass, pivots=pivots, scales=scales, reason=reason)
