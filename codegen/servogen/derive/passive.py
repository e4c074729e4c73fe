"""A mechanism with passive constraints as one without: Q u' = P + G tau + J^T lam with J u' + j = 0.

lam = -A^-1 (J Q^-1 (P + G tau) + j) with A = J Q^-1 J^T; no inverse is formed: Q is solved with once for all, then A,
both by LDL^T. Who asks for rows K of K u' gets W and a shift, K u' = W (P + G tau) + shift, and need not know.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from servogen.derive.constraint_rates import holonomic_rates, nonholonomic_rates
from servogen.derive.formulation import MassFindings, MassTreatment, Quantity
from servogen.derive.mass import solve_definite, solve_semidefinite, solve_with_mass
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


@dataclass(frozen=True, eq=False)
class Joined:
    """Rows J u' + j = 0 that say what all passive constraints say, and the rank they have.

    Rows that the others always make up in the same way are not among them. Where which rows make up the others changes
    from state to state, all are, and their rank is below their number.
    """

    J: Any
    j: Any
    rank: int
    closure: Closure

    @property
    def wanders(self) -> bool:
        return self.rank < int(self.J.size1())


def _joined(samples: Samples, closure: Closure) -> Joined:
    kept = independent_rows(samples)
    if _wanders(samples):
        return Joined(closure.J, closure.j, len(kept), closure)
    return Joined(closure.J[kept, :], closure.j[kept], len(kept), closure)


def respond(
    samples: Samples, found: MassFindings, K: Any, gauge: Gauge | None = None
) -> tuple[Any, Any, MassTreatment]:
    """W and shift with K u' = W (P + G tau) + shift, for rows K; about the gauge's u' and force where there is one."""
    scene = samples.scene
    if not scene.mechanism.passive:
        W_transposed, mass = solve_with_mass(scene, found, K.T, transposed=True)
        return W_transposed.T, ca.SX.zeros(K.size1()), mass
    joined = _joined(samples, closure_of(scene, gauge))
    m = K.size1()
    both, mass = _solve_definite_mass(samples, found, ca.horzcat(K.T, joined.J.T))
    V, held = both[:, :m], both[:, m:]
    Y, _, mass = _solve_closure(samples, joined, held, ca.mtimes(joined.J, V), mass)  # A^-1 J Q^-1 K^T
    return (V - ca.mtimes(held, Y)).T, -ca.mtimes(Y.T, joined.j), mass


def accelerations(
    samples: Samples, found: MassFindings, force: Any, stabilised: bool = False
) -> tuple[Any, MassTreatment]:
    """u' under `force`, P + G tau. stabilised: as in the plant of a simulation."""
    scene = samples.scene
    if not scene.mechanism.passive:
        return solve_with_mass(scene, found, force)
    joined = _joined(samples, closure_of(scene, stabilised=stabilised))
    both, mass = _solve_definite_mass(samples, found, ca.horzcat(force, joined.J.T))
    free, held = both[:, 0], both[:, 1:]
    lam, _, mass = _solve_closure(samples, joined, held, -(ca.mtimes(joined.J, free) + joined.j), mass)
    return free + ca.mtimes(held, lam), mass


def passive_quantities(samples: Samples, found: MassFindings) -> tuple[Quantity, ...]:
    """lam, of the state and tau, and closure: chi, then chi' of the holonomic rows; nothing where all is free."""
    scene, mech = samples.scene, samples.scene.mechanism
    if not mech.passive:
        return ()
    closure = closure_of(scene)
    joined = _joined(samples, closure)
    J = joined.J
    both, mass = _solve_definite_mass(samples, found, ca.horzcat(mech.P + ca.mtimes(mech.G, mech.tau), J.T))
    right = -(ca.mtimes(J, both[:, 0]) + joined.j)
    lam, basis, _ = _solve_closure(samples, joined, both[:, 1:], right, mass)
    if joined.wanders:
        shares, _ = solve_definite(_gram(basis, basis.T), ca.mtimes(basis.T, lam))
        lam = ca.mtimes(basis, shares)
    elif joined.rank < closure.J.size1():
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
    values, usual = _rows_over_the_domain(samples)
    taken, at_defaults = _pivots(values), _pivots(values[usual])
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


@lru_cache(maxsize=16)
def _rows_over_the_domain(samples: Samples) -> tuple[FloatArray, NDArray[np.bool_]]:
    """J at states examined (N, p, n), where it is finite, and which of them are at the parameters' defaults."""
    scene = samples.scene
    states, good = Closer(scene).close(samples.examined | samples.parameters)
    values = replace(samples, examined=states).values(closure_of(scene).J)
    finite = np.all(np.isfinite(values), axis=(1, 2))
    usual = np.arange(len(values)) < AT_DEFAULTS
    if not np.any(finite & usual):
        raise SceneError("passive: J is not finite at any state drawn from the domain; give a domain in which it is")
    taken = finite & (usual | good)
    return values[taken], usual[taken]


def _wanders(samples: Samples) -> bool:
    """Whether the rows that are left make up the others differently from state to state."""
    kept, (values, _) = independent_rows(samples), _rows_over_the_domain(samples)
    others = [k for k in range(values.shape[1]) if k not in kept]
    if not others:
        return False
    shares = values[:, others, :] @ np.linalg.pinv(values[:, kept, :])
    return bool(np.max(np.abs(shares - shares[0])) > _NEGLIGIBLE * 100 * (1 + np.max(np.abs(shares[0]))))


def left_out(samples: Samples) -> tuple[str, ...]:
    """A remark on each row of chi that the other ones make up already."""
    if not samples.scene.mechanism.passive:
        return ()
    kept, labels = independent_rows(samples), row_labels(samples.scene)
    if _wanders(samples):
        names = ", ".join(repr(c.name) for c in samples.scene.mechanism.passive)
        return (
            f"passive constraints {names}: of {len(labels)} rows {len(labels) - len(kept)} follow from the others at "
            "every state examined, and which ones changes: rows are chosen anew at each state",
        )
    return tuple(
        f"{label} is left out, for the others make it up already at every state examined; leave it out of chi, too"
        for k, label in enumerate(labels)
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


def _solve_closure(
    samples: Samples, joined: Joined, held: Any, right: Any, mass: MassTreatment
) -> tuple[Any, Any, MassTreatment]:
    """A^-1 right with A = J held, a basis of A's range where its rows wander (else None); A's pivots join those of Q.

    Where J loses rank, a dead centre, a whole row of it may vanish, and with that its entry on A's diagonal: so pivots
    are judged by the largest such entry over the domain.
    """
    A = _gram(held, joined.J)
    values = samples.values(ca.diag(A))
    largest = np.max(np.where(np.isfinite(values), values, 0.0), axis=(0, 2))
    sizes = [float(f"{size:.3g}") for size in largest]
    p = A.size1()
    if joined.wanders:
        X, basis, chosen = solve_semidefinite(A, right, joined.rank, [1 / size if size else 0.0 for size in sizes])
        own, scales = tuple(chosen), (ca.SX(1),) * joined.rank
        told = f"J Q^-1 J^T, {p}x{p}, of rank {joined.rank}, its rows chosen by selection"
    else:
        X, treatment = solve_definite(A, right)
        basis, own, scales = None, treatment.pivots, tuple(map(ca.SX, sizes))
        told = f"one LDL^T of J Q^-1 J^T, {p}x{p}"
    reason = f"{mass.reason}; passive constraints: {told}"
    pivots, scales = (*mass.pivots, *own), (*mass.scales, *scales)
    return X, basis, replace(mass, pivots=pivots, scales=scales, joining=len(own), reason=reason)
