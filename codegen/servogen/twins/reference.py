"""The reference: the textbook formulas of the paper in numpy, without our derivation, optimiser or solver."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from servogen.derive.controls import BENT_CAP
from servogen.derive.formulation import MassFindings
from servogen.derive.ideal import dependent_columns
from servogen.derive.passive import independent_rows
from servogen.derive.rows import Behind, behind, constraint_rows
from servogen.results import INFO_INTEGERS, INFO_REALS, Batch, Control, FloatArray, Info, Status, refusal
from servogen.scalars import EPSILON, Scalar
from servogen.scene.constraints import ControlsInvolved, Holonomic, Output
from servogen.scene.limits import INPUTS, Side
from servogen.scene.passive import PassiveHolonomic
from servogen.scene.samples import EXAMINED, draw_samples
from servogen.scene.scene import Scene
from servogen.scene.solver import Solver
from servogen.scene.symbols import chains
from servogen.scene.system import Function
from servogen.textbook import pseudo_inverse
from servogen.textbook.cascade import Switch, solve_switched
from servogen.textbook.limits import solve_within
from servogen.textbook.policy import Policy, policy_for
from servogen.twins.batch import States
from servogen.twins.interface import Twin, finite

_WITHOUT_MASS = {"psi": "psi", "phi": "psi", "A": "A", "closure": "closure"}
"""What needs no Q -> what it is called among the parts."""


Noise = Callable[[Scene, Scalar], Sequence[float] | None]
"""Per row of the system's matrix, the rounding noise of the generated code where the row vanishes."""


def reference_twin(scene: Scene, scalar: Scalar, noise: Noise) -> "ReferenceTwin":
    """The scene computed straight from Eqs. (1)-(12), (36)-(41) and (54): Jacobians by CasADi, the rest by numpy.

    For float32, inputs, parameters and results are rounded to it; the computation itself stays in float64.
    """
    return _class_of(scene)(scene, scalar, noise)


Solve = Callable[[Any], Any]
"""X -> Q^-1 X of SX, the way its caller wants it."""


def textbook_system(scene: Scene, solve: Solve, rows: bool = False) -> tuple[Any, Any]:
    """The matrix and the right side of the scene's system as SX, as the paper writes them.

    rows: of a product J Q^-1 X, Q is solved with for the rows of J, so that its second product is a short one.
    """
    parts = _textbook_parts(scene, solve)
    if scene.mechanism.passive:
        solve, shift = _constrained(scene, solve)
        parts["X"] = parts["X"] + ca.mtimes(parts["J"], shift)
    return _class_of(scene).written(scene, parts | {"product": lambda X: _product(parts["J"], X, solve, rows)}, solve)


def _constrained(scene: Scene, solve: Solve) -> tuple[Solve, Any]:
    """X -> u' under forces X and those of the passive constraints without their drift, and what that adds to u'."""
    kept, given = independent_rows(draw_samples(scene)), _passive_parts(scene)
    J, j = given["passive_J"][kept, :], given["passive_j"][kept]
    held = solve(J.T)
    A = ca.mtimes(J, held)

    def answer(X: Any) -> Any:
        free = solve(X)
        return free - ca.mtimes(held, ca.solve(A, ca.mtimes(J, free)))

    return answer, -ca.mtimes(held, ca.solve(A, j))


def _product(J: Any, X: Any, solve: Solve, rows: bool) -> Any:
    """J Q^-1 X; rows: by (Q^-1 J^T)^T of a symmetric Q."""
    return ca.mtimes(solve(J.T).T, X) if rows else ca.mtimes(J, solve(X))


def _class_of(scene: Scene) -> "type[ReferenceTwin]":
    return {"servo": ReferenceServo, "ideal": ReferenceIdeal, "controls": ReferenceControls}[scene.kind]


class ReferenceTwin(Twin):
    """A scene's textbook formulas behind the interface of a twin."""

    def __init__(self, scene: Scene, scalar: Scalar, noise: Noise) -> None:
        self._noise = noise
        self._function, self._names = _jacobians(scene)
        self._fixed = set(self._names["fixed"])
        self._parameters: dict[str, FloatArray] = {}
        super().__init__(scene, scalar)

    @cached_property
    def _policy(self) -> Policy:
        """What counts as rank; a row's default tolerance is the noise of the code, which only the code knows."""
        solver = self.scene.solver
        noise = self._noise(self.scene, self.scalar) if solver.atol is None else None
        return policy_for(*self.scene.system_shape, self.scalar, solver, noise)

    @cached_property
    def _definite(self) -> bool:
        """Whether Q is symmetric and positive definite over the domain: then any other is as bad as a singular one."""
        defaults = {f.name: np.array(f.default) for f in self.scene.parameters}
        drawn = draw_samples(self.scene).examined
        for k in range(EXAMINED):
            Q = self._parts({n: v[k] for n, v in drawn.items()} | defaults)["Q"]
            size = np.sqrt(np.abs(np.diag(Q)))
            if not np.array_equal(Q, Q.T) or not np.all(size > 0):
                return False
            if not np.linalg.eigvalsh(Q / np.outer(size, size))[0] > 1e-13:  # a unit decides nothing, nor does rounding
                return False
        return True

    def _singular(self, Q: FloatArray) -> bool:
        """Whether Q, its rows and columns scaled to one, has a condition beyond 1 / (4 n eps), or the wrong sign."""
        if self._definite and np.any(np.diag(Q) <= 0):
            return True
        return _ill_conditioned(Q, EPSILON[self.scalar])

    @cached_property
    def _joined(self) -> tuple[int, FloatArray]:
        """The rank of the passive constraints' J over the domain, and the largest diagonal of J Q^-1 J^T."""
        defaults = {f.name: np.array(f.default) for f in self.scene.parameters}
        drawn, rank, largest = draw_samples(self.scene).examined, 0, np.zeros(1)
        for k in range(EXAMINED):
            given = self._parts({n: v[k] for n, v in drawn.items()} | defaults)
            J = given["passive_J"]
            rank = max(rank, int(np.linalg.matrix_rank(J, rtol=1e-9)))
            largest = np.maximum(largest, np.diag(J @ np.linalg.solve(given["Q"], J.T)))
        return rank, largest

    def _dead(self, given: dict[str, FloatArray]) -> bool:
        """Whether the passive constraints lose rank, as J Q^-1 J^T shows it beside its size over the domain."""
        if "passive_J" not in given:
            return False
        J = given["passive_J"]
        A = J @ np.linalg.solve(given["Q"], J.T)
        if not np.all(np.isfinite(A)):
            return False
        rank, largest = self._joined
        sigma = np.linalg.svd(A / np.sqrt(np.outer(largest, largest)), compute_uv=False)
        return bool(sigma[rank - 1] <= 4 * len(A) * EPSILON[self.scalar])

    def _prepare(self, parameters: dict[str, FloatArray]) -> Status:
        rounded = {n: self._round(v) for n, v in parameters.items()}
        if not finite(rounded.values()):
            return Status.NONFINITE
        before = self._parameters
        self._parameters = rounded
        status = self._of_parameters()
        if status < 0:
            self._parameters = before
        return status

    def _of_parameters(self) -> Status:
        """What prepare finds in the matrices that no input changes: a singular Q, a weight or an S that does not exist.

        Other values of parameters alone that overflow are told by the code in prepare, here when they are needed.
        """
        given = self.parts({f.name: np.array(f.default) for f in self.scene.input_fields()})
        if "Q" in self._fixed and self._singular(given["Q"]):
            return Status.SINGULAR_MASS
        if "weight" in self._fixed and not np.all(np.isfinite(_root(given["weight"]))):
            return Status.OVERFLOW
        if self.scene.kind == "servo" and {"J", "Q", "G"} <= self._fixed:
            with np.errstate(all="ignore"):
                S = given["J"] @ np.linalg.solve(given["Q"], given["G"])
            if not finite([self._round(S)]):
                return Status.OVERFLOW
        return Status.OK

    def _round(self, value: Any) -> FloatArray:
        with np.errstate(over="ignore"):
            return np.asarray(value).astype(self.dtype).astype(float)

    def system(self, inputs: dict[str, FloatArray], *names: str) -> tuple[Status, dict[str, FloatArray]]:
        """(status, {"psi", "S", "z", "y"} or {"phi", "A", "B", "y"}); empty where the status is negative.

        names: these quantities alone, with the status that they have (psi, phi and A need no Q).
        """
        rounded = {n: self._round(v) for n, v in inputs.items()}
        if not finite(v for n, v in rounded.items() if n in self._names["used"]):
            return Status.NONFINITE, {}
        given = self.parts(inputs)
        if names and set(names) <= set(_WITHOUT_MASS):
            result = {n: given[_WITHOUT_MASS[n]] for n in names}
        elif self._singular(given["Q"]):
            return Status.SINGULAR_MASS, {}
        elif self._dead(given):
            return Status.DEAD_CENTRE, {}
        else:
            try:
                with np.errstate(all="ignore"):
                    result = self._textbook(given, rounded)
            except np.linalg.LinAlgError:  # a pivot underflowed to exactly zero
                return Status.OVERFLOW, {}
        result = {n: result[n] for n in names or result}
        if not finite(self._round(v) for v in result.values()):
            return Status.OVERFLOW, {}
        return Status.OK, result

    def parts(self, inputs: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """What the formulas are made of: psi, J, X, the prescribed rate, Q, P, G, y, and the weight if there is one."""
        return self._parts({n: self._round(v) for n, v in inputs.items()} | self._parameters)

    def _parts(self, given: dict[str, FloatArray]) -> dict[str, FloatArray]:
        values = self._function(*(ca.DM(given[n]) for n in self._names["in"]))
        return {n: np.array(v, dtype=float) for n, v in zip(self._names["out"], values, strict=True)}

    def _textbook(self, given: dict[str, FloatArray], inputs: dict[str, FloatArray]) -> dict[str, FloatArray]:
        raise NotImplementedError

    @staticmethod
    def written(scene: Scene, parts: dict[str, Any], solve: Solve) -> tuple[Any, Any]:
        """Matrix and right side as SX; parts: those of _textbook_parts, and product: X -> J Q^-1 X."""
        raise NotImplementedError

    def _evaluate(self, name: str, inputs: dict[str, FloatArray]) -> FloatArray:
        status, result = self.system(inputs, name)
        offered = self.scene.system.function(name)
        assert offered is not None
        shape = self.scene.shape_of(offered)
        return result[name].reshape(shape).astype(self.dtype) if status >= 0 else np.full(shape, np.nan, self.dtype)

    def _pinv(self, matrix: FloatArray) -> tuple[FloatArray, Info]:
        inverse, info = pseudo_inverse.pinv(self._round(matrix), self._policy)
        if info.status < 0:
            inverse = np.full(inverse.shape, np.nan)
        return inverse.astype(self.dtype), info

    def _control(self, entry: str, inputs: dict[str, FloatArray], last: FloatArray, *numbers: float) -> Control:
        matrix, right = self.scene.system.matrix, self.scene.system.right
        weight = () if self.scene.weight is None else ("weight",)
        status, result = self.system(inputs, matrix, right, "y", *weight)
        if status < 0:
            return Control(last, refusal(status))
        S = result[matrix].reshape(self.scene.system_shape)
        y = result["y"].ravel()
        switches = [(rows, float(self._round(inputs[name])[0])) for name, rows in self.scene.switches]
        if any(not np.isfinite(a) for _, a in switches):
            return Control(last, refusal(Status.NONFINITE))
        if "weight" not in result:
            tau, info = self._solved(S, result[right].ravel(), y, switches, last)
        else:
            with np.errstate(all="ignore"):
                tau, info = self._weighted(S, result[right].ravel(), y, result["weight"], switches, last)
        if info.status == Status.NONFINITE:  # of a finite system: it overflowed on the way
            return Control(last, refusal(Status.OVERFLOW))
        if self.scene.sides is not None and info.status >= 0:
            tau, info = self._within(S, result[right].ravel(), y, (np.asarray(tau), info), inputs, last)
        return Control(np.asarray(tau).astype(self.dtype), info)

    def _within(
        self,
        S: FloatArray,
        z: FloatArray,
        y: FloatArray,
        start: tuple[FloatArray, Info],
        inputs: dict[str, FloatArray],
        last: FloatArray,
    ) -> tuple[FloatArray, Info]:
        """The answer within limits; start: that without."""
        sides, given = self.scene.sides, self.parts(inputs)
        assert sides is not None
        limits = []
        for name, side in sides.each():
            if isinstance(side, str):
                limits.append(self._round(inputs[INPUTS[name]]).ravel())
                continue
            own = self._round(given[name]).ravel()
            if not np.all(np.isfinite(own)):
                return last, refusal(Status.OVERFLOW)
            own[list(side.open)] = -np.inf if name == "lower" else np.inf
            limits.append(own)
        slowed = given["prescribed"].ravel() if sides.policy == "keep_direction" else None
        metric = self._metric(given)
        return solve_within(
            S, z, y, limits[0], limits[1], self._policy, last, metric=metric, slowed=slowed, start=start
        )

    def _metric(self, given: dict[str, FloatArray]) -> FloatArray | None:
        """T with T^T T = W, where there is a weight."""
        if "weight" not in given:
            return None
        root = _root(given["weight"])
        metric: FloatArray = np.linalg.inv(root) if self.scene.weighs_by_inverse_mass else root.T
        return metric

    def _each(self, states: States) -> Iterator[tuple[int, Status, dict[str, FloatArray]]]:
        """One state after the other, with what prepare says of its parameters; then those of before hold again."""
        try:
            for k in range(states.count):
                inputs, parameters = states.one(k)
                yield k, self._prepare(parameters) if parameters else Status.OK, inputs
        finally:
            if states.parameters:
                self._prepare(self._prepared)

    def _control_batch(
        self, entry: str, states: States, value: FloatArray, threads: int | None, *numbers: float
    ) -> Batch:
        infos = []
        for k, status, inputs in self._each(states):
            answer = Control(value[k], refusal(status))
            if status >= 0:
                answer = self._control(entry, inputs, value[k], *numbers)
            value[k] = answer.value
            infos.append(answer.info)
        types = dict.fromkeys(INFO_INTEGERS, np.dtype(np.int32)) | dict.fromkeys(INFO_REALS, self.dtype)
        types |= {"scale": self.dtype, "active": np.dtype(np.int32)}
        columns: list[Any] = [np.array([getattr(i, n) for i in infos], dtype) for n, dtype in types.items()]
        levels = len(self.scene.levels) if self.scene.cascaded else 0
        for n, kind in (("level_rank", np.dtype(np.int32)), ("level_residual", self.dtype)):
            rows = [getattr(i, n) or [0] * levels for i in infos]
            columns.append(np.array(rows, kind).reshape(len(rows), levels))
        return Batch(value, *columns)

    def _evaluate_batch(self, offered: Function, states: States, threads: int | None) -> FloatArray:
        shape = self.scene.shape_of(offered)
        refused = np.full(shape, np.nan, self.dtype)
        rows = [self._evaluate(offered.name, given) if ok >= 0 else refused for _, ok, given in self._each(states)]
        return np.array(rows, self.dtype).reshape(states.count, *shape)

    def _solved(
        self, S: FloatArray, z: FloatArray, y: FloatArray, switches: Sequence[Switch], last: FloatArray | None = None
    ) -> tuple[FloatArray, Info]:
        """y + S+ (z - S y), or the same level by level."""
        if self.scene.cascaded:
            return solve_switched(S, z, y, self.scene.levels, switches, self._policy, last)
        return pseudo_inverse.solve(S, z, y, self._policy, last)

    def _weighted(
        self,
        S: FloatArray,
        z: FloatArray,
        y: FloatArray,
        W: FloatArray,
        switches: Sequence[Switch],
        last: FloatArray,
    ) -> tuple[FloatArray, Info]:
        """y + W^-1/2 (S W^-1/2)+ (z - S y), which is y + W^-1 S^T (S W^-1 S^T)+ (z - S y): by W's eigenvectors.

        W: the weight; where that is Q^-1, Q itself, whose eigenvectors are the same.
        """
        values, vectors = np.linalg.eigh(W)
        values = 1 / values if self.scene.weighs_by_inverse_mass else values
        root = (vectors * np.sqrt(values)) @ vectors.T
        inverse = (vectors / np.sqrt(values)) @ vectors.T
        sigma, info = self._solved(S @ inverse, z, root @ y, switches)
        return (inverse @ sigma, info) if info.status >= 0 else (last, info)


class ReferenceServo(ReferenceTwin):
    """S = psi_u Q^-1 G and z = -psi_u Q^-1 P - X + Theta psi."""

    def _control(self, entry: str, inputs: dict[str, FloatArray], last: FloatArray, *numbers: float) -> Control:
        answer = super()._control(entry, inputs, last, *numbers)
        levels = len(self.scene.levels)
        if not self.scene.cascaded or answer.info.status >= 0:
            return answer
        return Control(last, replace(answer.info, level_rank=[0] * levels, level_residual=[0.0] * levels))

    @staticmethod
    def written(scene: Scene, parts: dict[str, Any], solve: Solve) -> tuple[Any, Any]:
        S, drift = parts["product"](parts["G"]), parts["product"](parts["P"])
        return _taken_out(scene, S, parts["prescribed"] - parts["X"] - drift)

    @cached_property
    def _takes_out(self) -> Any:
        """S and z -> the same with the rows that others stand behind taken out of these; None where there are none."""
        if _apart(self.scene) is None:
            return None
        S, z = ca.SX.sym("S", *self.scene.system_shape), ca.SX.sym("z", self.scene.rows)
        return ca.Function("takes_out", [S, z], [*_taken_out(self.scene, S, z)])

    def _textbook(self, given: dict[str, FloatArray], inputs: dict[str, FloatArray]) -> dict[str, FloatArray]:
        J = given["J"]
        gain, drift, multipliers = _motion(given, inputs)
        S = J @ gain
        z = -J @ drift - given["X"] + given["prescribed"]
        if self._takes_out is not None:
            S, z = (np.array(v, dtype=float) for v in self._takes_out(S, z))
        y = inputs["y"] if "y" in inputs else given["y"]
        return {"psi": given["psi"].ravel(), "S": S, "z": z.ravel(), "y": y} | multipliers | _weight(given)


class ReferenceIdeal(ReferenceTwin):
    """R = Q T^-1 F - P by the nonminimal form T u' = F, Eqs. (13)-(17), (26); u_D chosen at each state."""

    def __init__(self, scene: Scene, scalar: Scalar, noise: Noise) -> None:
        self._reaction = policy_for(scene.rows, scene.rows, scalar, Solver(rank=scene.solver.rank))
        self._dependent = dependent_columns(draw_samples(scene), constraint_rows(scene).J)
        super().__init__(scene, scalar, noise)

    @staticmethod
    def written(scene: Scene, parts: dict[str, Any], solve: Solve) -> tuple[Any, Any]:
        J, product = parts["J"], parts["product"]
        right = parts["prescribed"] - parts["X"] - product(parts["P"])
        return parts["G"], ca.mtimes(J.T, ca.solve(product(J.T), right))

    def _textbook(self, given: dict[str, FloatArray], inputs: dict[str, FloatArray]) -> dict[str, FloatArray]:
        J, Q, P = given["J"], given["Q"], given["P"].ravel()
        b = (given["prescribed"] - given["X"]).ravel()
        unit = np.ldexp(1.0, -pseudo_inverse.symmetric_units(J @ np.linalg.solve(Q, J.T)))
        J, b = unit[:, None] * J, unit * b
        inertia = J @ np.linalg.solve(Q, J.T)
        _, info = pseudo_inverse.solve(inertia, b - J @ np.linalg.solve(Q, P), None, self._reaction)
        R = np.full(len(P), 0.0 if info.status >= 0 else np.nan)
        if info.rank > 0:
            from scipy.linalg import qr  # here, for it takes a third of the time to import servogen

            rows, right = _independent_rows(J, b, info.rank)
            chosen = tuple(sorted(qr(rows, pivoting=True, mode="r")[1][: info.rank]))
            T, F = nonminimal_form(Q, P, rows, right, chosen)
            R = Q @ np.linalg.solve(T, F) - P
        y = inputs["y"] if "y" in inputs else given["y"]
        status = np.array([float(info.status)])
        return {"psi": given["psi"].ravel(), "G": given["G"], "R": R, "y": y, "reaction": status} | _weight(given)

    def _evaluate(self, name: str, inputs: dict[str, FloatArray]) -> FloatArray:
        if name not in ("T", "F"):
            return super()._evaluate(name, inputs)
        T, F = self.nonminimal(inputs)[1]
        return (T if name == "T" else F).astype(self.dtype)

    def nonminimal(self, inputs: dict[str, FloatArray]) -> tuple[Status, tuple[FloatArray, FloatArray]]:
        """(status, (T, F)) with the code's u_D; NaN, and OVERFLOW, where the block of J to invert is singular."""
        rounded = {n: self._round(v) for n, v in inputs.items()}
        n = self.scene.mechanism.u.size1()
        nothing = np.full((n, n), np.nan), np.full(n, np.nan)
        if not finite(v for name, v in rounded.items() if name in self._names["used"]):
            return Status.NONFINITE, nothing
        given = self.parts(inputs)
        b = (given["prescribed"] - given["X"]).ravel()
        try:
            with np.errstate(all="ignore"):
                T, F = nonminimal_form(given["Q"], given["P"].ravel(), given["J"], b, self._dependent)
        except np.linalg.LinAlgError:
            return Status.OVERFLOW, nothing
        good = finite([self._round(T), self._round(F)])
        return (Status.OK, (T, F)) if good else (Status.OVERFLOW, nothing)

    def _control(self, entry: str, inputs: dict[str, FloatArray], last: FloatArray, *numbers: float) -> Control:
        status, result = self.system(inputs)
        answer = super()._control(entry, inputs, last)
        if status < 0 or answer.info.status < 0:
            return answer
        reaction = Status(int(result["reaction"][0]))
        if reaction < 0:
            return Control(last, refusal(reaction))
        return Control(answer.value, _with_status(answer.info, max(reaction, answer.info.status)))


def _motion(
    given: dict[str, FloatArray], inputs: dict[str, FloatArray]
) -> tuple[FloatArray, FloatArray, dict[str, FloatArray]]:
    """gain and drift of u' = drift + gain tau, and with passive constraints their multipliers under tau.

    Those by the dense Karush-Kuhn-Tucker system [Q, -J^T; J, 0] [u'; lam] = [P + G tau; -j], by least squares where its
    rows are redundant, so that lam has the least norm.
    """
    Q, forces = given["Q"], np.hstack([given["G"], given["P"].reshape(-1, 1)])
    if "passive_J" not in given:
        solved = np.linalg.solve(Q, forces)
        return solved[:, :-1], solved[:, -1:], {}
    J, j = given["passive_J"], given["passive_j"].reshape(-1, 1)
    n, p = len(Q), len(J)
    matrix = np.block([[Q, -J.T], [J, np.zeros((p, p))]])
    right = np.vstack([forces, np.hstack([np.zeros((p, forces.shape[1] - 1)), -j])])
    size = 1 / np.sqrt(np.maximum(np.max(np.abs(matrix), axis=1), 1e-300))
    size[:n] = 1 / np.sqrt(np.abs(np.diag(Q)))
    size[n:] = 1.0  # the multipliers' least norm is in their own units
    solved = size[:, None] * np.linalg.lstsq(size[:, None] * matrix * size, size[:, None] * right, rcond=1e-11)[0]
    lam = solved[n:, -1] + solved[n:, :-1] @ inputs["tau"].ravel()
    return solved[:n, :-1], solved[:n, -1:], {"lam": lam}


def nonminimal_form(
    Q: FloatArray, P: FloatArray, J: FloatArray, b: FloatArray, dependent: tuple[int, ...]
) -> tuple[FloatArray, FloatArray]:
    """T (n, n) and F (n,) of T u' = F for constraint rows J u' = b, Eqs. (15), (26)."""
    n = len(Q)
    independent = [j for j in range(n) if j not in dependent]
    Z = np.zeros((n, len(independent)))
    Z[independent, range(len(independent))] = 1.0
    Z[list(dependent)] = -np.linalg.solve(J[:, list(dependent)], J[:, independent])
    return np.vstack([Z.T @ Q, J]), np.concatenate([Z.T @ P, b])


def _independent_rows(J: FloatArray, b: FloatArray, rank: int) -> tuple[FloatArray, FloatArray]:
    """As many rows as the rank, with the same solutions as J u' = b in the least-squares sense."""
    if rank == len(J):
        return J, b
    left, sigma, right = np.linalg.svd(J, full_matrices=False)
    return right[:rank], (left.T @ b)[:rank] / sigma[:rank]


class ReferenceControls(ReferenceTwin):
    """A = phi_tau and B by the four terms of Eq. (40)."""

    @staticmethod
    def written(scene: Scene, parts: dict[str, Any], solve: Solve) -> tuple[Any, Any]:
        u_dot = solve(parts["P"] + ca.mtimes(parts["G"], scene.mechanism.tau))
        return parts["A"], parts["prescribed"] - parts["X"] - ca.mtimes(parts["J"], u_dot)

    def _textbook(self, given: dict[str, FloatArray], inputs: dict[str, FloatArray]) -> dict[str, FloatArray]:
        gain, drift, multipliers = _motion(given, inputs)
        u_dot = drift + gain @ inputs["tau"].reshape(-1, 1)
        B = given["prescribed"] - given["X"] - given["J"] @ u_dot
        y = inputs["y"] if "y" in inputs else given["y"]
        return {"phi": given["psi"].ravel(), "A": given["A"], "B": B.ravel(), "y": y} | multipliers | _weight(given)

    def _control(self, entry: str, inputs: dict[str, FloatArray], last: FloatArray, *numbers: float) -> Control:
        if entry == "control":
            return super()._control(entry, inputs, last)
        if entry == "project":
            return self._project(inputs, last)
        (dt,) = numbers
        if not np.isfinite(dt):
            return Control(last, refusal(Status.NONFINITE))
        rate = super()._control("control", inputs, last)
        if rate.info.status < 0:
            return Control(last, rate.info)
        with np.errstate(over="ignore"):
            moved = inputs["tau"] + dt * rate.value
        if not finite([self._round(moved)]):
            return Control(last, refusal(Status.OVERFLOW))
        projected = self._project(inputs | {"tau": moved}, last)
        if 0 <= projected.info.status < rate.info.status:
            return Control(projected.value, _with_status(projected.info, rate.info.status))
        return projected

    def _project(self, inputs: dict[str, FloatArray], last: FloatArray) -> Control:
        """Newton's method on Lagrange's conditions of the nearest point: tau - start + A^T force = 0, phi = 0."""
        start = now = inputs["tau"]
        near, before = math.sqrt(EPSILON[self.scalar]), 0.0
        m, l = self.scene.rows, self.scene.controls
        for _ in range(BENT_CAP):
            status, result = self.system(inputs | {"tau": now}, "phi", "A")
            if status < 0:
                return Control(last, refusal(status))
            A, phi = result["A"].reshape(m, l), result["phi"].ravel()
            inverse, _ = pseudo_inverse.pinv(A, self._policy)
            bends = self.parts(inputs | {"tau": now})["bends"].reshape(m, l, l)
            with np.errstate(all="ignore"):
                force = inverse.T @ (start - now)
                L = _root(np.eye(l) + np.tensordot(force, bends, 1))
                L = L if np.all(np.isfinite(L)) else np.eye(l)
                inner = np.linalg.solve(L, A.T).T
                back = np.linalg.solve(L, start - now - A.T @ force)
            if not finite([inner, back]):
                return Control(last, refusal(Status.OVERFLOW))
            move, info = pseudo_inverse.solve(inner, -phi, back, self._policy)
            if info.status < 0:
                return Control(last, info)
            change = np.linalg.solve(L.T, np.asarray(move, dtype=float))
            now = now + change
            if not finite([self._round(now)]):
                return Control(last, refusal(Status.OVERFLOW))
            size, step = np.max(np.abs([now, start])), np.max(np.abs(change))
            if step <= 8 * EPSILON[self.scalar] * size or (step <= near * size and 2 * step >= before > 0):
                return Control(now.astype(self.dtype), info)
            before = step
        return Control(last, refusal(Status.NOT_CONVERGED))


def _root(matrix: FloatArray) -> FloatArray:
    """L with L L^T = matrix, NaN where the matrix is not positive definite."""
    try:
        return np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        return np.full(matrix.shape, np.nan)


def _weight(given: dict[str, FloatArray]) -> dict[str, FloatArray]:
    """The weight, or the Q that it is the inverse of; nothing where there is none."""
    return {"weight": given["weight"]} if "weight" in given else {}


def _with_status(info: Info, status: Status) -> Info:
    return replace(info, status=status)


def _ill_conditioned(Q: FloatArray, epsilon: float) -> bool:
    """Whether Q, its rows and columns scaled to one, has a condition number beyond 1 / (4 n eps): what LAPACK makes of
    a singular value of 0 lies within."""
    rows = np.max(np.abs(Q), axis=1, keepdims=True)
    if not np.all(np.isfinite(Q)) or np.any(rows == 0):
        return not np.any(~np.isfinite(Q))
    scaled = Q / rows
    with np.errstate(invalid="ignore"):  # a column of zeros
        scaled = scaled / np.max(np.abs(scaled), axis=0, keepdims=True)
    if not np.all(np.isfinite(scaled)):
        return True
    sigma = np.linalg.svd(scaled, compute_uv=False)
    return bool(sigma[-1] <= 4 * len(Q) * epsilon * sigma[0])


def _jacobians(scene: Scene) -> tuple[Any, dict[str, list[str]]]:
    """CasADi functions of what the textbook formulas are made of, every partial derivative a full Jacobian."""
    mech = scene.mechanism
    fields = [*scene.input_fields(), *scene.parameters]
    parts = _textbook_parts(scene, lambda right: ca.solve(mech.Q, right))
    parts["y"] = scene.y if isinstance(scene.y, ca.SX) else ca.SX.zeros(scene.controls)
    if scene.weight is not None:
        parts["weight"] = mech.Q if scene.weighs_by_inverse_mass else scene.weight
    if mech.passive:
        parts |= _passive_parts(scene)
    if scene.sides is not None:
        parts |= {name: side.expression for name, side in scene.sides.each() if isinstance(side, Side)}
    everything = ca.vertcat(*(ca.vec(ca.densify(p)) for p in parts.values()))
    always = {"y", "tau"} if mech.passive else {"y"}  # the multipliers are of tau
    used = [f.name for f in fields if f.name in always or ca.depends_on(everything, f.symbol)]
    inputs = ca.vertcat(*(f.symbol for f in scene.input_fields()))
    fixed = [name for name, part in parts.items() if not ca.depends_on(ca.densify(part), inputs)]
    names = {"in": [f.name for f in fields], "out": list(parts), "used": used, "fixed": fixed}
    return ca.Function("textbook", [f.symbol for f in fields], list(parts.values())), names


def _textbook_parts(scene: Scene, solve: Solve) -> dict[str, Any]:
    """SX of what the formulas are made of: Q, P, G, and of the constraints, row under row, psi, J, X and so on."""
    mech = scene.mechanism
    rows = [_constraint_parts(scene, c, solve) for c in scene.constraints]
    parts = {name: ca.vertcat(*(row[name] for row in rows)) for name in rows[0]}
    return parts | {"Q": mech.Q, "P": mech.P, "G": mech.G}


def _constraint_parts(scene: Scene, c: Any, solve: Solve) -> dict[str, Any]:
    if isinstance(c, ControlsInvolved):
        return {
            "psi": c.phi,
            "J": ca.jacobian(c.phi, scene.mechanism.u),
            "X": _drift(scene, c.phi),
            "A": ca.jacobian(c.phi, scene.mechanism.tau),
            "prescribed": ca.mtimes(c.Theta, c.phi),
            "bends": ca.vertcat(*(ca.densify(ca.hessian(row, scene.mechanism.tau)[0]) for row in ca.vertsplit(c.phi))),
        }
    if isinstance(c, Output):
        rates, u_dot = [c.psi], _free_motion(scene, c, solve)
        for _ in range(c.order - 1):
            through = ca.mtimes(ca.jacobian(rates[-1], scene.mechanism.u), u_dot)
            rates.append(_drift(scene, rates[-1]) + through)
        return {
            "psi": c.psi,
            "J": ca.jacobian(rates[-1], scene.mechanism.u),
            "X": _drift(scene, rates[-1]),
            "prescribed": sum(ca.mtimes(T, value) for T, value in zip(c.Theta, rates, strict=True)),
        }
    if isinstance(c, Holonomic):
        psi_dot = _drift(scene, c.psi)
        prescribed = ca.mtimes(c.Theta1, psi_dot) + ca.mtimes(c.Theta2, c.psi)
        return {
            "psi": c.psi,
            "J": ca.jacobian(psi_dot, scene.mechanism.u),
            "X": _drift(scene, psi_dot),
            "prescribed": prescribed,
        }
    return {
        "psi": c.psi,
        "J": ca.jacobian(c.psi, scene.mechanism.u),
        "X": _drift(scene, c.psi),
        "prescribed": ca.mtimes(c.Theta, c.psi),
    }


def _free_motion(scene: Scene, c: Output, solve: Solve) -> Any:
    """u' at tau = 0, for no derivative of an output below its degree knows of tau; or under the controls that make the
    rows hold which it stands behind, for it knows of no others."""
    mech = scene.mechanism
    if mech.passive:
        held, shift = _constrained(scene, solve)
        return held(mech.P) + shift
    apart = _apart(scene)
    if apart is None or c.name not in apart.names:
        return solve(mech.P)
    rows = [_constraint_parts(scene, other, solve) for other in scene.constraints if other.name not in apart.names]
    J, X, prescribed = (ca.vertcat(*(row[name] for row in rows)) for name in ("J", "X", "prescribed"))
    columns, still = list(apart.columns), ca.mtimes(J, solve(mech.P))
    S = ca.mtimes(J, solve(mech.G))
    return solve(mech.P + ca.mtimes(mech.G[:, columns], ca.solve(S[:, columns], prescribed - X - still)))


def _apart(scene: Scene) -> Behind | None:
    """Which outputs stand behind other rows, and the controls that make these hold."""
    return None if scene.mechanism.passive else behind(draw_samples(scene), MassFindings(False, False))


def _taken_out(scene: Scene, S: Any, z: Any) -> tuple[Any, Any]:
    """S and z, SX: of rows that stand behind others, less as much of these as brings the controls that make them hold
    to zero there."""
    apart = _apart(scene)
    if apart is None:
        return S, z
    names = [c.name for c in scene.constraints for _ in range(c.size)]
    back = [k for k, name in enumerate(names) if name in apart.names]
    front = [k for k, name in enumerate(names) if name not in apart.names]
    columns = list(apart.columns)
    factor = ca.solve(S[front, columns].T, S[back, columns].T).T
    S, z = ca.SX(S), ca.SX(z)
    S[back, :] = S[back, :] - ca.mtimes(factor, S[front, :])
    S[back, columns] = 0
    z[back] = z[back] - ca.mtimes(factor, z[front])
    return S, z


def _passive_parts(scene: Scene) -> dict[str, Any]:
    """J and j of J u' + j = 0, and chi with the chi' of holonomic rows below, every derivative a full Jacobian."""
    rates, chi, speeds = [], [], []
    for c in scene.mechanism.passive:
        chi.append(c.chi)
        holonomic = isinstance(c, PassiveHolonomic)
        rates.append(_drift(scene, c.chi) if holonomic else c.chi)
        speeds += rates[-1:] if holonomic else []
    rate = ca.vertcat(*rates)
    J = ca.jacobian(rate, scene.mechanism.u)
    return {"passive_J": J, "passive_j": _drift(scene, rate), "closure": ca.vertcat(*chi, *speeds)}


def _drift(scene: Scene, psi: Any) -> Any:
    """psi_q (C u + D) + psi_t + psi_r r', Eq. (5), term by term."""
    mech = scene.mechanism
    C = ca.SX.eye(mech.q.size1()) if mech.C is None else mech.C
    drift = ca.mtimes(ca.jacobian(psi, mech.q), ca.mtimes(C, mech.u))
    if mech.D is not None:
        drift += ca.mtimes(ca.jacobian(psi, mech.q), mech.D)
    if mech.t is not None:
        drift += ca.jacobian(psi, mech.t)
    assert scene.references is not None
    for chain in chains(scene.references):
        for value, derivative in zip(chain.chain, chain.chain[1:], strict=False):
            drift += ca.mtimes(ca.jacobian(psi, value.symbol), derivative.symbol)
    return drift
