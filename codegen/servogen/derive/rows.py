"""The rows of a scene's constraints, J u' + X = prescribed, of whatever degree; and those that stand behind others."""

from dataclasses import dataclass
from functools import lru_cache, reduce
from operator import add
from typing import Any

import casadi as ca
import numpy as np

from servogen.derive.constraint_rates import holonomic_rates, nonholonomic_rates
from servogen.derive.formulation import MassFindings
from servogen.derive.lie import Drift
from servogen.derive.passive import respond
from servogen.errors import SceneError
from servogen.results import FloatArray
from servogen.scene.constraints import Constraint, Output, expression_of, is_holonomic
from servogen.scene.known_rates import Gauge
from servogen.scene.samples import Samples
from servogen.scene.scene import Scene

_NEGLIGIBLE = 1e-9
"""Of a sum of products beside that of their magnitudes: what rounding leaves of zero is not larger."""


@dataclass(frozen=True, eq=False)
class Behind:
    """Outputs that the controls reach too soon, but by way of other rows alone: the rows of lower degree beside them.

    Where these hold, S_d tau = z_d, one control of each is what makes it hold, tau_c = S_dc^-1 (z_d - what the others
    do). So the motion is that under the force P + G_c S_dc^-1 z_d and the other controls, and along it an output has a
    higher degree: the structure algorithm, Silverman (1969). No integrator is needed, for what the rows in front
    prescribe is known with all its derivatives. names: of the outputs. columns: c. drift: of that motion. G: n x l,
    what is left of the others' factors there, zero in the columns c.
    """

    names: frozenset[str]
    columns: tuple[int, ...]
    drift: Drift
    G: Any


@lru_cache(maxsize=32)
def behind(samples: Samples, found: MassFindings) -> Behind | None:
    """None where no output stands behind other rows. SceneError where one does in a scene that has no way with it."""
    scene = samples.scene
    early = frozenset(c.name for c in scene.constraints if _reached_early(samples, found, c))
    front = [c for c in scene.constraints if c.name not in early]
    if not early or not front:
        return None
    mech, name = scene.mechanism, min(early)
    for there, what in (
        (bool(mech.passive), "passive constraints"),
        (len(scene.levels) > 1, "priorities"),
        (bool(scene.switches), "active='input'"),
        (scene.sides is not None and scene.sides.policy == "keep_direction", "limits of policy 'keep_direction'"),
    ):
        if there:
            raise SceneError(
                f"constraint {name!r}: the controls reach it too soon, by way of other rows; in a scene with {what} "
                f"these cannot be taken out first: leave out {what}, or the constraint"
            )
    rows = [row_of(scene, c, None, Drift(samples, found)) for c in front]
    J, X, prescribed = (ca.vertcat(*parts) for parts in list(zip(*rows, strict=True))[1:4])
    driven = [row[4] for row, c in zip(rows, front, strict=True) for _ in range(c.size)]
    W, *_ = respond(samples, found, J)
    S, force = ca.mtimes(W, mech.G), ca.mtimes(W, mech.P)
    z = prescribed - X - ca.vertcat(*(0 if known else force[k] for k, known in enumerate(driven)))
    columns = _pivot_columns(samples.values(S))
    if columns is None:
        return None
    others = [c for c in range(scene.controls) if c not in columns]
    inverse = ca.solve(S[:, columns], ca.SX.eye(len(columns)))
    through = ca.mtimes(mech.G[:, columns], inverse)
    G = ca.SX.zeros(mech.u.size1(), scene.controls)
    G[:, others] = mech.G[:, others] - ca.mtimes(through, S[:, others])
    drift = Drift(samples, found, force=mech.P + ca.mtimes(through, z))
    return Behind(early, tuple(columns), drift, G)


def _reached_early(samples: Samples, found: MassFindings, constraint: Constraint) -> bool:
    """Whether a derivative of an output below the order of its Theta holds tau, at the states examined."""
    scene = samples.scene
    if not isinstance(constraint, Output) or constraint.order == 1:
        return False
    drift, value = Drift(samples, found, undeclared_rest=True), constraint.psi
    for _ in range(constraint.order - 1):
        W, *_ = respond(samples, found, drift.gradient(value))
        reach, size = (samples.values(x) for x in (ca.mtimes(W, scene.mechanism.G), _magnitude(W, scene.mechanism.G)))
        good = np.isfinite(reach) & np.isfinite(size)
        if np.any(np.abs(reach[good]) > _NEGLIGIBLE * size[good]):
            return True
        value = drift.rate(value, f"constraint {constraint.name!r}")
    return False


def _magnitude(a: Any, b: Any) -> Any:
    return ca.mtimes(ca.fabs(a), ca.fabs(b))


def _pivot_columns(values: FloatArray) -> list[int] | None:
    """As many columns of the matrices (N, m, l) as rows, so that they are as far from dependent as can be; None where
    the rows are dependent."""
    rest = values[np.all(np.isfinite(values), axis=(1, 2))]
    rest = rest / np.maximum(np.linalg.norm(rest, axis=2, keepdims=True), 1e-300)
    taken: list[int] = []
    for _ in range(values.shape[1]):
        lengths = np.linalg.norm(rest, axis=1)  # (states, columns)
        score = np.mean(np.log(lengths + 1e-12), axis=0)
        score[taken] = -np.inf
        best = int(np.argmax(score > np.max(score) - 1e-9))
        if np.max(lengths[:, best], initial=0.0) <= _NEGLIGIBLE:
            return None
        taken.append(best)
        column = rest[:, :, best] / np.maximum(lengths[:, best, None], 1e-300)
        rest = rest - column[:, :, None] * np.einsum("si,sij->sj", column, rest)[:, None, :]
    return sorted(taken)


@dataclass(frozen=True, eq=False)
class Rows:
    """J u' + X = prescribed for all constraints, in the order given; psi: their expressions. All SX, a row each.

    With a gauge it is J (u' - gauge.u_dot) + X. driven: rows of outputs whose X holds the drift J Q^-1 P, too.
    behind: of these, those that tau reaches once other rows are taken out.
    """

    psi: Any
    J: Any
    X: Any
    prescribed: Any
    driven: tuple[bool, ...]
    behind: tuple[bool, ...]

    def still_due(self, drift: Any) -> Any:
        """J Q^-1 P where X does not hold it."""
        if not any(self.driven):
            return drift
        return ca.vertcat(*(0 if driven else drift[k] for k, driven in enumerate(self.driven)))


def constraint_rows(
    scene: Scene, gauge: Gauge | None = None, drift: Drift | None = None, behind: Behind | None = None
) -> Rows:
    """The rows of a scene's constraints. drift: of the scene; outputs of a higher degree need it."""
    names = frozenset() if behind is None else behind.names
    along = [drift if behind is None or c.name not in names else behind.drift for c in scene.constraints]
    rows = [row_of(scene, c, gauge, own) for c, own in zip(scene.constraints, along, strict=True)]
    psi, J, X, prescribed = (ca.vertcat(*parts) for parts in zip(*(row[:4] for row in rows), strict=True))
    driven = tuple(row[4] for row, c in zip(rows, scene.constraints, strict=True) for _ in range(c.size))
    return Rows(psi, J, X, prescribed, driven, tuple(c.name in names for c in scene.constraints for _ in range(c.size)))


def row_of(
    scene: Scene, constraint: Constraint, gauge: Gauge | None, drift: Drift | None
) -> tuple[Any, Any, Any, Any, bool]:
    """psi, J, X, right side and driven as in Rows, for one constraint."""
    what, psi = f"constraint {constraint.name!r}", expression_of(constraint)
    driven = False
    if is_holonomic(constraint, scene.mechanism.u):
        psi_dot, J, X = holonomic_rates(scene, psi, what, gauge)
        rates = [psi, psi_dot]
    elif constraint.order == 1:
        J, X = nonholonomic_rates(scene, psi, what, gauge)
        rates = [psi]
    else:
        assert drift is not None
        driven, rates = True, [psi]
        for _ in range(constraint.order):
            rates.append(drift.rate(rates[-1], what))
        J = drift.gradient(rates[-2])
        *rates, X = drift.filled(*rates)
    terms = [ca.mtimes(theta, value) for theta, value in zip(constraint.thetas, rates, strict=True)]
    return psi, J, X, reduce(add, reversed(terms)), driven
