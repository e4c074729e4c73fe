"""Equilibria of a closed loop, and the eigenvalues of what moves there while all constraints are held."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from servogen.analysis.inside import Inside
from servogen.results import FloatArray
from servogen.scene.domain import domain_box, draw_states
from servogen.scene.scene import Scene

STARTS = 12
"""States of the domain from which equilibria are looked for."""

_ENOUGH = 5
"""Starts from which one arrives at rest, after which nobody looks for more."""

_STEPS = 100
_ALIKE = 1e-6
"""Of states, and of invariant subspaces: apart by less, they are one."""


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A state x at rest, and the linearised internal dynamics there.

    eigenvalues: 1/s, the largest real part first. modes: a column each, their directions in x. tau: what holds it.
    far: how far outside the domain, in widths of its ranges; 0 inside.
    """

    x: FloatArray
    tau: FloatArray
    eigenvalues: Any
    modes: Any
    far: float


class Search:
    """Of one closed loop, with parameters and references at their defaults and references at rest."""

    def __init__(self, inside: Inside) -> None:
        self._inside, scene = inside, inside.scene
        self._n, self._n_q = int(inside.x.numel()), int(scene.mechanism.q.size1())
        fields = [f for f in scene.input_fields() if f.name not in ("q", "u", "tau")]
        given = [(f.symbol, f.default) for f in (*fields, *scene.parameters)]
        symbols = ca.vertcat(ca.SX(0, 1), *(s for s, _ in given))
        values = ca.vertcat(ca.DM(0, 1), *(ca.DM(v) for _, v in given))
        parts = [ca.densify(part) for part in (inside.field, inside.held, inside.controls)]
        field, held, controls = ca.substitute(parts, [symbols], [ca.SX(values)])
        self._field, self._held = (_with_jacobian(inside.x, part) for part in (field, held))
        self._controls = ca.Function("controls", [inside.x], [controls])
        self._reachable, self._everywhere = _reachable(scene), invariants_of(scene) == 0
        D = scene.mechanism.D
        self._at_zero = slice(self._n_q, self._n_q + (inside.speeds if D is None or D.is_zero() else 0))
        self._starts, low, high = self._domain()
        self._middle, self._half = (low + high) / 2, np.maximum((high - low) / 2, 1e-3)
        rows = np.array([self._held[1](x) for x in self._starts])
        with np.errstate(all="ignore"):
            self._sizes = np.nanmedian(np.linalg.norm(rows, axis=2), axis=0)

    def equilibria(self) -> tuple[list[Equilibrium], int]:
        """Those found, the nearest to the domain first, then to its middle, each once; and how many more there are at
        which the constraints are dependent, so that no internal dynamics is defined."""
        found: list[FloatArray] = []
        arrivals = 0
        for start in self._starts:
            x, _ = self._descend(self._held, start)
            x, arrived = self._descend(self._field, x)
            arrivals += arrived
            if arrived and all(np.max(np.abs(x - other)) > _ALIKE * (1 + np.max(np.abs(x))) for other in found):
                found.append(x)
            if arrivals == _ENOUGH:
                break
        off = [np.abs(x - self._middle) / self._half for x in found]
        far = [max(0.0, float(np.max(o)) - 1.0 - _ALIKE) for o in off]
        order = sorted(range(len(found)), key=lambda k: (max(0.0, far[k] - 0.5), float(np.sum(off[k]))))
        linearised = [self._linearised(found[k], far[k]) for k in order]
        regular = [e for e in linearised if e is not None]
        return regular, len(linearised) - len(regular)

    def _domain(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """States to start from, at rest, (STARTS, n), and the ends of each entry of x in the domain."""
        scene, names = self._inside.scene, self._inside.states
        drawn = draw_states(scene, STARTS, seed=5)
        box = domain_box(scene, draw_states(scene, 64, seed=6)) if callable(scene.domain) else domain_box(scene, {})
        starts = np.hstack([0 * drawn[n] if n == "u" else drawn[n] for n in names])
        low, high = (np.concatenate([box[n][end] for n in names]) for end in (0, 1))
        return starts, low, high

    def _descend(self, of: "_Function", start: FloatArray) -> tuple[FloatArray, bool]:
        """A zero of a function of x, or where it is smallest nearby; whether it is zero there.

        Along the motions that there are, so that a quaternion keeps its length; and u = 0 where q' = C u.
        """
        from scipy.optimize import least_squares  # here, for it takes long to load

        x = start
        for _ in range(1 if self._everywhere else 3):  # where x bends, the Jacobian is exact at the start alone
            B, at = self._tangent(x), x
            B = B[:, np.all(B[self._at_zero] == 0, axis=0)]

            def value(move: FloatArray, B: FloatArray = B, at: FloatArray = at) -> FloatArray:
                return np.nan_to_num(of[0](self._along(at, B @ move)), nan=1e150, posinf=1e150, neginf=-1e150)

            def jacobian(move: FloatArray, B: FloatArray = B, at: FloatArray = at) -> FloatArray:
                return np.nan_to_num(of[1](self._along(at, B @ move)) @ B)

            scale = np.linalg.norm(B * self._half[:, None], axis=0)
            with np.errstate(all="ignore"):
                found = least_squares(
                    value, np.zeros(B.shape[1]), jacobian, x_scale=scale, xtol=1e-10, ftol=1e-10, gtol=1e-10,
                    max_nfev=_STEPS,
                )  # fmt: skip
                move = found.x
                for _ in range(2):  # what Newton's steps give for nothing
                    move = move - np.linalg.lstsq(jacobian(move), value(move), rcond=1e-10)[0]
            better = np.linalg.norm(value(move)) < np.linalg.norm(value(found.x))
            x = self._along(at, B @ (move if better else found.x))
        size = float(np.linalg.norm(of[0](x)))
        return x, size <= 1e-9 * (1 + float(np.max(np.abs(of[1](x)), initial=0.0)) * (1 + float(np.max(np.abs(x)))))

    def _tangent(self, x: FloatArray) -> FloatArray:
        """Columns that span the directions in which motions lead from x."""
        if self._everywhere:
            return np.eye(self._n)
        own = _spanned(np.array(self._reachable(x[: self._n_q])))
        B = np.zeros((self._n, self._n - self._n_q + own.shape[1]))
        B[: self._n_q, : own.shape[1]] = own
        B[self._n_q :, own.shape[1] :] = np.eye(self._n - self._n_q)
        return B

    def _along(self, x: FloatArray, move: FloatArray) -> FloatArray:
        """x moved, in small parts each of which keeps to the tangent where that is less than the whole space."""
        q, own = x[: self._n_q], move[: self._n_q]
        if self._everywhere:
            return x + move
        parts = 32
        for _ in range(parts):
            half = q + own / (2 * parts)
            basis = _spanned(np.array(self._reachable(half)))
            q = q + basis @ (basis.T @ own) / parts
        return np.concatenate([q, x[self._n_q :] + move[self._n_q :]])

    def _linearised(self, x: FloatArray, far: float) -> Equilibrium | None:
        """None where the constraints are dependent at x, or a row all but vanishes beside its size in the domain."""
        A, B = self._field[1](x), self._tangent(x)
        rows = self._held[1](x) @ B / np.where(self._sizes > 0, self._sizes, 1.0)[:, None]
        if len(rows) and not np.min(np.linalg.svd(rows, compute_uv=False)) > _ALIKE:
            return None
        free = B @ np.linalg.svd(rows)[2][len(rows) :].T
        inner = free.T @ A @ free
        scale = max(1.0, float(np.max(np.abs(A), initial=0.0)))
        if not np.all(np.isfinite(inner)) or np.max(np.abs(A @ free - free @ inner), initial=0.0) > _ALIKE * scale:
            return None
        values, vectors = np.linalg.eig(inner) if inner.size else (np.zeros(0), np.zeros((0, 0)))
        values = _without_rounded_zeros(values, max(1.0, float(np.linalg.norm(inner))))
        order = np.lexsort((-values.imag, -values.real))
        tau = np.array(self._controls(x)).ravel()
        return Equilibrium(x, tau, values[order], (free @ vectors)[:, order], far)


_Function = tuple[Callable[[FloatArray], FloatArray], Callable[[FloatArray], FloatArray]]
"""A function of x, (k,), and its Jacobian (k, n)."""


def _with_jacobian(x: Any, expression: Any) -> _Function:
    value = ca.Function("value", [x], [expression])
    jacobian = ca.Function("jacobian", [x], [ca.jacobian(expression, x)])
    return lambda at: np.array(value(at)).ravel(), lambda at: np.array(jacobian(at))


def _spanned(matrix: FloatArray) -> FloatArray:
    """Orthonormal columns that span those of a matrix."""
    left, sigma, _ = np.linalg.svd(matrix, full_matrices=False)
    return left[:, sigma > 1e-9 * np.max(sigma, initial=1e-300)]


def _without_rounded_zeros(values: Any, scale: float) -> Any:
    """Eigenvalues that are zero but for rounding made so.

    A zero of multiplicity k comes out as k numbers of a size of the k-th root of eps around it; the coefficients of
    their polynomial, which are well conditioned, tell them from small eigenvalues.
    """
    order = np.argsort(np.abs(values))
    for k in range(len(values), 0, -1):
        near = order[:k]
        coefficients = np.abs(np.poly(values[near])[1:])
        if np.all(coefficients <= 1e-11 * scale ** np.arange(1, k + 1)):
            return np.where(np.isin(np.arange(len(values)), near), 0.0, values)
    return values


def invariants_of(scene: Scene) -> int:
    """How many functions of q no motion changes, the length of a quaternion, say."""
    reachable = _reachable(scene)
    n = int(scene.mechanism.q.size1())
    at = np.random.default_rng(8).uniform(-1, 1, n)
    return n - int(np.linalg.matrix_rank(np.array(reachable(at)), rtol=1e-9))


def _reachable(scene: Scene) -> Any:
    """A function of q: a matrix whose columns span where q can be led, by C, D and their Lie brackets.

    Of a quaternion it leaves out the direction of its length.
    """
    mech = scene.mechanism
    q, n = mech.q, mech.q.size1()
    if mech.C is None:
        return ca.Function("reachable", [q], [ca.DM.eye(n)])
    columns = [mech.C[:, k] for k in range(mech.C.size2()) if not mech.C[:, k].is_zero()]
    columns += [] if mech.D is None or mech.D.is_zero() else [mech.D]
    given: list[tuple[Any, Any]] = [(f.symbol, f.default) for f in scene.parameters]
    given += [] if mech.t is None else [(mech.t, 0.0)]
    for symbol, value in given:
        columns = [ca.substitute(c, symbol, ca.SX(ca.DM(value))) for c in columns]
    at = np.random.default_rng(8).uniform(-1, 1, n)
    while True:
        rank = _rank(q, columns, at)
        if rank == n:
            return ca.Function("reachable", [q], [ca.DM.eye(n)])
        more = [*columns]
        for i, a in enumerate(columns):
            for b in columns[:i]:
                bracket = ca.jtimes(b, q, a) - ca.jtimes(a, q, b)
                if _rank(q, [*more, bracket], at) > _rank(q, more, at):
                    more.append(bracket)
        if len(more) == len(columns):
            return ca.Function("reachable", [q], [ca.horzcat(*columns)])
        columns = more


def _rank(q: Any, columns: list[Any], at: FloatArray) -> int:
    value = np.array(ca.Function("value", [q], [ca.densify(ca.horzcat(*columns))])(at))
    return int(np.linalg.matrix_rank(value, rtol=1e-9))
