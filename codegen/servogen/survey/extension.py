"""The dynamic extension algorithm: integrators before controls until all rows can be reached at once.

Isidori (1995), Section 5.4. Each row is differentiated until the controls reach it. Where the factors of tau in these
derivatives are dependent rows, what the dependent ones share comes too early: it gets an integrator, so that the others
come to bear, and one looks again. Either it is controls of their own, or what several controls make together; then the
derivative of a row takes the place of one of them, tau_c = (psi_p^(r) - its drift - the other controls' part) / S_pc,
and gets the integrator.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from servogen.derive.formulation import MassFindings, Quantity
from servogen.derive.lie import Drift
from servogen.derive.lower import lower_model, lower_quantities
from servogen.derive.passive import independent_rows, respond
from servogen.ir.field import PRIME, inverse
from servogen.optimise.decimals import clean_constants
from servogen.optimise.fingerprint import Fingerprints
from servogen.optimise.passes import optimise
from servogen.scene.constraints import Constraint, expression_of
from servogen.scene.domain import domain_box
from servogen.scene.mechanism import Mechanism
from servogen.scene.passive import PassiveHolonomic
from servogen.scene.samples import Samples, draw_samples
from servogen.scene.scene import Domain, Scene
from servogen.scene.symbols import derivative_name
from servogen.survey.definiteness import survey_mass
from servogen.survey.degree import LARGEST, labels_of, row_degrees

NEGLIGIBLE = 1e-9
"""Of rows brought to length one: what is left of one that others make up already is not larger."""


@dataclass(frozen=True, eq=False)
class Reached:
    """Every row's first derivative that the controls reach: S tau + drift, rows in the order of the constraints.

    degrees: of each row. rates: of each row psi and its derivatives below that one. All SX of the scene's symbols.
    """

    degrees: tuple[int, ...]
    rates: tuple[tuple[Any, ...], ...]
    S: Any
    drift: Any


@dataclass(frozen=True, eq=False)
class Extension:
    """What the algorithm came to.

    scene: with the integrators as entries of u behind the others; the scene given where none are needed. degrees: of
    the rows there, None for one that no control reaches; reached: None then. first_degrees, first_rank: of the scene
    given, and of its S for almost all states. integrators: control -> how many. exchanged: control -> the row whose
    derivative stands in its place. dependent: the places of the rows that made integrators necessary; as outputs of
    the degrees told here they need none (derive/rows.py: Behind). reason: why it ends without an answer; empty where S
    has full row rank.
    """

    scene: Scene
    degrees: tuple[int | None, ...]
    first_degrees: tuple[int | None, ...]
    first_rank: int = 0
    reached: Reached | None = None
    integrators: Mapping[str, int] = field(default_factory=dict)
    exchanged: Mapping[str, str] = field(default_factory=dict)
    dependent: frozenset[int] = frozenset()
    reason: str = ""


def extend(scene: Scene) -> Extension:
    """Run the algorithm on a servo scene.

    It ends: a step adds one integrator, or one for each row that others depend on, but raises the degrees of more rows
    than that; and rows that are independent at last have no more derivatives below their degrees than there are states.
    """
    scene = _bare(scene)
    labels = [label for c in scene.constraints for label in labels_of(c)]
    names = [s.name() for s in scene.mechanism.tau.nonzeros()]
    integrators: dict[str, int] = {}
    exchanged: dict[str, str] = {}
    first: tuple[tuple[int | None, ...], int] | None = None
    dependent: frozenset[int] = frozenset()
    while True:
        degrees = degrees_of(scene)
        if None in degrees:
            reason = f"no control moves {labels[degrees.index(None)]}, however often it is differentiated"
            known, rank = first or (degrees, 0)
            return Extension(scene, degrees, known, rank, reason=reason)
        reached = reached_at(scene, degrees)
        pivots, depends = _eliminated(scene, reached.S)
        first = first or (degrees, len(pivots))
        found = Extension(scene, degrees, *first, reached, integrators, exchanged, dependent)
        if len(pivots) == len(labels):
            return found
        tied = ", ".join(labels[i] for i in sorted({*depends, *(p for row in depends.values() for p in row)}))
        if len(labels) > scene.controls:
            return replace(found, reason=f"{len(labels)} rows for {scene.controls} controls are never independent")
        if sum(reached.degrees) > states_of(scene):
            return replace(found, reason=f"{tied} are never independent, whatever is differentiated")
        if reached.S.numel() and _size(reached) > LARGEST:
            return replace(found, reason=f"the derivatives of {tied} grow beyond {LARGEST} operations")
        dependent = dependent | depends.keys()
        rows = sorted({p for row in depends.values() for p in row})
        columns = [c for c in range(scene.controls) if any(not reached.S[p, c].is_zero() for p in rows)]
        if len(columns) > len(rows):
            columns = [pivots[p] for p in rows]
            exchanged |= {names[c]: labels[p] for p, c in zip(rows, columns, strict=True) if names[c] not in exchanged}
            scene = _exchanged(scene, reached, rows, columns)
        for c in columns:
            integrators[names[c]] = integrators.get(names[c], 0) + 1
        scene = _integrated(scene, {c: (names[c], integrators[names[c]]) for c in columns})


def degrees_of(scene: Scene) -> tuple[int | None, ...]:
    """The relative degree of each row of a servo scene, None for one that no control reaches."""
    samples, found = surveyed(scene)
    most = states_of(scene)
    return tuple(d for c in scene.constraints for d in row_degrees(samples, found, c, most))


def states_of(scene: Scene) -> int:
    """The states of a mechanism: entries of q and u, less those that passive constraints bind."""
    mech = scene.mechanism
    if not mech.passive:
        return int(mech.q.size1() + mech.u.size1())
    weights = [2 if isinstance(c, PassiveHolonomic) else 1 for c in mech.passive for _ in range(c.chi.size1())]
    bound = sum(weights[k] for k in independent_rows(draw_samples(scene)))
    return int(mech.q.size1() + mech.u.size1() - bound)


def _bare(scene: Scene) -> Scene:
    """With its constraints and its mechanism alone: what the rows are made of."""
    return replace(scene, y=None, weight=None, limits=None)


def surveyed(scene: Scene) -> tuple[Samples, MassFindings]:
    """The states at which all stages look at a scene, and what its Q is there."""
    samples = draw_samples(scene)
    return samples, survey_mass(samples, lower_model(scene))


def reached_at(scene: Scene, degrees: tuple[int | None, ...]) -> Reached:
    """The rows of a servo scene, each in its derivative of that degree."""
    samples, found = surveyed(scene)
    drift = Drift(samples, found, undeclared_rest=True)
    rates, ends, gradients = [], [], []
    known = iter(degrees)
    for c in scene.constraints:
        own = [next(known) or 0 for _ in range(c.size)]
        values = _derivatives(drift, c, max(own))
        for row, degree in enumerate(own):
            rates.append(tuple(value[row] for value in values[:degree]))
            ends.append(values[degree][row])
            gradients.append(drift.gradient(values[degree - 1][row]))
    W, *_ = respond(samples, found, ca.vertcat(*gradients))
    filled = drift.filled(*(x for row in rates for x in row), *ends)
    parts = iter(filled)
    rates = [tuple(next(parts) for _ in row) for row in rates]
    return Reached(tuple(d or 0 for d in degrees), tuple(rates), ca.mtimes(W, scene.mechanism.G), ca.vertcat(*parts))


def _derivatives(drift: Drift, constraint: Constraint, most: int) -> list[Any]:
    values = [expression_of(constraint)]
    for _ in range(most):
        values.append(drift.rate(values[-1], f"constraint {constraint.name!r}"))
    return values


def _size(reached: Reached) -> int:
    whole = ca.vertcat(ca.vec(reached.S), reached.drift)
    return int(ca.Function("size", ca.symvar(whole), [whole]).n_instructions())


def _eliminated(scene: Scene, S: Any) -> tuple[dict[int, int], dict[int, list[int]]]:
    """Pivot row -> its column, and dependent row -> the pivot rows that make it up, for almost all states.

    What is zero is decided in the field in which equal values mean equal expressions (optimise/fingerprint.py), or, for
    constants may have been rounded on the way there, by being negligible at all states examined. The pivot among the
    others is the one that is largest over these states, beside its row.
    """
    cleaned, _ = clean_constants(lower_quantities(scene, [Quantity("S", S, "", "")]))
    program = optimise(cleaned)
    known, nodes = Fingerprints(program).values, program.output("S").nodes
    m, l = S.shape
    rows = [[known[n][0] for n in nodes[i * l : (i + 1) * l]] for i in range(m)]
    share: list[dict[int, int]] = [{} for _ in rows]  # of the rows as they were, in what is left of each
    sizes = draw_samples(scene).values(S)
    sizes = sizes[np.all(np.isfinite(sizes), axis=(1, 2))]
    sizes = sizes / np.maximum(np.linalg.norm(sizes, axis=(0, 2), keepdims=True), 1e-300)
    pivots: dict[int, int] = {}
    while True:
        largest = np.max(np.abs(sizes), axis=0, initial=0.0)
        left = [
            (i, c) for i in range(m) if i not in pivots for c in range(l) if rows[i][c] and largest[i, c] > NEGLIGIBLE
        ]
        if not left:
            break
        scores = [float(np.mean(np.log(np.abs(sizes[:, i, c]) + 1e-12))) if len(sizes) else 0.0 for i, c in left]
        p, column = left[int(np.argmax(np.array(scores) > max(scores) - 1e-9))]
        pivots[p] = column
        with np.errstate(all="ignore"):
            factors = np.nan_to_num(sizes[:, :, column] / sizes[:, p, column][:, None], posinf=0.0, neginf=0.0)
        for i in range(m):
            if i in pivots or not rows[i][column]:
                continue
            factor = rows[i][column] * inverse(rows[p][column]) % PRIME
            rows[i] = [(a - factor * b) % PRIME for a, b in zip(rows[i], rows[p], strict=True)]
            for k, part in {**{k: -v for k, v in share[p].items()}, p: 1}.items():
                share[i][k] = (share[i].get(k, 0) + factor * part) % PRIME
            sizes[:, i] -= factors[:, i, None] * sizes[:, p]
    depends = {i: [k for k, part in share[i].items() if part] for i in range(m) if i not in pivots}
    return pivots, depends


def _exchanged(scene: Scene, reached: Reached, rows: list[int], columns: list[int]) -> Scene:
    """The derivatives of these rows as controls in the places of these columns."""
    mech = scene.mechanism
    others = [c for c in range(scene.controls) if c not in columns]
    inverse_of = ca.solve(reached.S[rows, columns], ca.SX.eye(len(rows)))
    through = ca.mtimes(mech.G[:, columns], inverse_of)
    G = ca.SX(mech.G)
    G[:, columns] = through
    G[:, others] = mech.G[:, others] - ca.mtimes(through, reached.S[rows, others])
    P = mech.P - ca.mtimes(through, reached.drift[rows])
    return replace(scene, mechanism=replace(mech, P=P, G=G, known_rates=None))


def _integrated(scene: Scene, moved: Mapping[int, tuple[str, int]]) -> Scene:
    """An integrator before some controls, their states the last entries of u.

    moved: column -> the control's name, and how many integrators it has then.
    """
    mech, k, columns = scene.mechanism, len(moved), list(moved)
    n_q, l = mech.q.size1(), scene.controls
    held = ca.vertcat(*(ca.SX.sym(derivative_name(name, count - 1)) for name, count in moved.values()))
    new = {c: ca.SX.sym(derivative_name(name, count)) for c, (name, count) in moved.items()}
    tau = ca.vertcat(*(new.get(c, s) for c, s in enumerate(mech.tau.nonzeros())))
    direct, through = ca.SX(mech.G), ca.SX(k, l)
    direct[:, columns] = 0
    for row, c in enumerate(columns):
        through[row, c] = 1
    C = ca.SX.eye(n_q) if mech.C is None else mech.C
    extended = Mechanism(
        q=mech.q,
        u=ca.vertcat(mech.u, held),
        tau=tau,
        Q=ca.diagcat(mech.Q, ca.SX.eye(k)),
        P=ca.vertcat(mech.P + ca.mtimes(mech.G[:, columns], held), ca.SX(k, 1)),
        G=ca.vertcat(direct, through),
        C=ca.horzcat(C, ca.SX(n_q, k)),
        D=mech.D,
        t=mech.t,
        passive=mech.passive,
    )

    return replace(scene, mechanism=extended, domain=_with_held(scene, k))


def _with_held(scene: Scene, k: int) -> Domain:
    """The domain of a scene with k more entries of u, between -1 and 1."""
    given = scene.domain
    if callable(given):
        known = {f.name for f in scene.input_fields()}
        n_u = scene.mechanism.u.size1()

        def drawn(generator: np.random.Generator) -> dict[str, Any]:
            state = {n: np.atleast_1d(v) for n, v in given(generator).items() if n in known}
            return state | {"u": np.concatenate([state.get("u", np.zeros(n_u)), generator.uniform(-1, 1, k)])}

        return drawn
    box: dict[str, tuple[Any, Any]] = dict(domain_box(scene, {}))
    low, high = box["u"]
    return box | {"u": (np.append(low, -np.ones(k)), np.append(high, np.ones(k)))}
