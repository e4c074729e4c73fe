"""What the generated code ought to answer at given states: 50-digit values, expected statuses, and how far off
correctly rounded code may be.

Tolerances are no guesses: S, z, A, B may differ by the first-order rounding bound of their own operations
(ir/rounding.py), tau by BAR u kappa (|tau| + |y|) for the solver and what the errors of S and z do to it.
"""

from dataclasses import dataclass
from typing import Any

import flint
import mpmath as mp
import numpy as np

from servogen import exact
from servogen.compiler import optimised_scene
from servogen.derive.lower import MASS_PIVOT, MASS_SCALE
from servogen.ir.evaluate import DIGITS, evaluate, evaluate_exactly
from servogen.ir.numbers import as_fraction
from servogen.ir.rounding import rounding_bounds
from servogen.plan import textbook_solver
from servogen.plan.module import Module
from servogen.plan.solver import SolverPlan
from servogen.plan.stage import cut
from servogen.results import Control, FloatArray, Info, Status
from servogen.scalars import EPSILON
from servogen.scene.domain import boundary_states, draw_states
from servogen.scene.scene import Scene, State
from servogen.singular import pseudo_solution
from servogen.twins.interface import ControlsTwin
from servogen.twins.reference import reference
from servogen.verify.projection import Projection
from servogen.verify.vectors import ANY_ANSWER, ANY_RANK, ANY_STATUS, EntryVectors, OutputVectors, VectorSet

BAR = 8.0
"""tau may err by BAR u kappa(S) (|tau| + |y|) beyond what the errors of S and z cost."""

STEP_DT = 1e-3
"""dt of the vectors of step, in seconds."""

_SECOND_ORDER = 1.01  # first-order bounds are off by their square
_TRUSTED = 0.05  # relative error of S beyond which first-order propagation proves nothing

Exact = list[Any]  # mpf values, row by row


@dataclass(frozen=True, eq=False)
class Point:
    """Everything about one state: the truth, and the scalar's own answers by the interpreter."""

    values: dict[str, Exact]
    bounds: dict[str, FloatArray]
    rounded: dict[str, FloatArray]
    status: Status  # of the quantities that need Q, before any solve


@dataclass(frozen=True, eq=False)
class Answer:
    """Expected tau with its tolerance (inf: not compared), status and rank."""

    tau: Exact
    tolerance: float
    status: int
    rank: int


def states_to_check(scene: Scene, count: int, seed: int = 0) -> tuple[State, list[str]]:
    """`count` states drawn from the domain and all boundary states, with the names of the latter."""
    drawn = draw_states(scene, count, seed)
    named = boundary_states(scene)
    stacked = {n: np.concatenate([drawn[n], *(state[n] for _, state in named)]) for n in drawn}
    return stacked, [name for name, _ in named]


class Truth:
    """The truth about one scene in one scalar at N states (drawn first, boundary ones last)."""

    def __init__(self, scene: Scene, module: Module, states: State, drawn: int) -> None:
        assert module.solver is not None
        assert module.control is not None
        self.scene, self.module, self.drawn = scene, module, drawn
        self.solver, self.control = module.solver, module.control
        self.scalar = module.target.scalar
        self.dtype = np.dtype(self.scalar).type
        with np.errstate(over="ignore"):
            self.inputs = {n: v.astype(self.dtype) for n, v in states.items()}
        self.parameters = {f.name: np.array(f.default, self.dtype).reshape(1, -1) for f in module.parameters}
        self.count = len(next(iter(self.inputs.values())))
        _, optimised = optimised_scene(scene)
        self.program, self.exact = optimised.program, optimised.exact
        self.names = [o.name for o in self.program.outputs if o.name not in (MASS_PIVOT, MASS_SCALE)]
        self.problems: list[str] = []
        self.finite = np.array([self._inputs_finite(k) for k in range(self.count)])
        self.points = self._points(self.inputs)
        self.reactions = [self._reaction(k) for k in range(self.count)] if self.control.reaction else []
        self.answers = [self._answer(k) for k in range(self.count)]

    def _inputs_finite(self, k: int) -> bool:
        return all(np.all(np.isfinite(self.inputs[f.name][k])) for f in self.module.inputs)

    def _points(self, inputs: dict[str, Any]) -> list[Point]:
        everything = inputs | self.parameters
        floats = {n: np.array(v, dtype=float) for n, v in everything.items()}
        bounds = rounding_bounds(self.program, floats, self.scalar)
        rounded = evaluate(self.program, everything, self.dtype)
        points = []
        own = rounding_bounds(self.exact, floats, "float64")
        pairs = zip(evaluate_exactly(self.program, everything), evaluate_exactly(self.exact, everything), strict=True)
        for k, (values, unoptimised) in enumerate(pairs):
            self._compare(k, values, unoptimised, {n: _row(v, k) for n, v in own.items()})
            at = {n: _row(v, k).ravel() for n, v in rounded.items()}
            limits = {n: _row(v, k) * _SECOND_ORDER for n, v in bounds.items()}
            points.append(Point(values, limits, at, self._status(k, at)))
        return points

    def _compare(
        self, k: int, values: dict[str, Exact], unoptimised: dict[str, Exact], bounds: dict[str, FloatArray]
    ) -> None:
        """Note where optimisation changed an output by more than 50 digits of the unoptimised program may err.

        bounds: the unoptimised program's error bounds in float64, from which those with 50 digits follow.
        """
        finer = mp.mpf(10) ** (2 - DIGITS) / mp.mpf(EPSILON["float64"])
        for name, entries in values.items():
            for x, y, bound in zip(entries, unoptimised[name], bounds[name], strict=True):
                if mp.isfinite(x) and mp.isfinite(y) and np.isfinite(bound):
                    slack = finer * mp.mpf(float(bound)) + mp.mpf(10) ** (2 - DIGITS) * abs(x)
                    if abs(x - y) > slack:
                        change = f"{mp.nstr(y, 20)} became {mp.nstr(x, 20)}"
                        self.problems.append(f"optimisation changed {name} at state {k}: {change}; report this defect")

    def _status(self, k: int, at: dict[str, FloatArray]) -> Status:
        """Status of the code that needs Q, in the order the generated code tests in."""
        if not self.finite[k]:
            return Status.NONFINITE
        if MASS_PIVOT in at:
            for pivot, scale in zip(at[MASS_PIVOT], at[MASS_SCALE], strict=True):
                if not np.isfinite(pivot):
                    return Status.OVERFLOW
                if not pivot > self.dtype(self.module.mass_tolerance) * scale:
                    return Status.SINGULAR_MASS
        return Status.OK

    def _evaluated(self, k: int, names: tuple[str, ...], needs_mass: bool) -> Status:
        """Status of an entry point that hands out these quantities at state k."""
        if not self.finite[k]:
            return Status.NONFINITE
        status = self.points[k].status if needs_mass else Status.OK
        if status < 0:
            return status
        good = all(np.all(np.isfinite(self.points[k].rounded[n])) for n in names)
        return Status.OK if good else Status.OVERFLOW

    def _answer(self, k: int) -> Answer:
        """control at state k."""
        control, point = self.control, self.points[k]
        results = tuple(r.name for r in control.kernel.results)
        status = self._evaluated(k, results, bool(control.kernel.guards))
        if control.reaction is None:
            return self._unweighted(
                point, self._solved(point, control.matrix, control.system.right, status, self._free(k))
            )
        reaction = self.reactions[k]
        status = (
            status if status < 0 else Status.OK if reaction.status == ANY_ANSWER else Status(min(0, reaction.status))
        )
        if status < 0 or not np.isfinite(reaction.tolerance):
            unknown = status if status < 0 else ANY_ANSWER
            return Answer([mp.mpf(0)] * self.solver.l, np.inf, unknown, ANY_RANK)
        R = np.array([float(v) for v in reaction.tau]).astype(self.dtype)
        limits = np.full(len(R), reaction.tolerance)
        with_R = Point(
            point.values | {"R": reaction.tau}, point.bounds | {"R": limits}, point.rounded | {"R": R}, status
        )
        answer = self._unweighted(point, self._solved(with_R, control.matrix, "R", status, self._free(k)))
        if 0 < answer.status <= Status.RANK_DEFICIENT_INCONSISTENT and np.any(R):
            return Answer(answer.tau, answer.tolerance, ANY_ANSWER, answer.rank)  # R's own errors decide consistency
        both = ANY_ANSWER in (answer.status, reaction.status) and answer.status >= 0
        status_of_both = (
            ANY_ANSWER if both else max(answer.status, reaction.status) if answer.status >= 0 else answer.status
        )
        return Answer(answer.tau, answer.tolerance, status_of_both, answer.rank)

    def _reaction(self, k: int) -> Answer:
        """R of ideal control forces at state k."""
        reaction, point = self.control.reaction, self.points[k]
        assert reaction is not None
        n, m = reaction.size, reaction.solver.m
        status = self._evaluated(k, tuple(r.name for r in reaction.kernel.results), bool(reaction.kernel.guards))
        point = _in_own_units(point, m) if m > 1 and status == Status.OK else point
        force = self._solved(point, "reaction_matrix", "reaction_right", status, None, reaction.solver)
        if force.status < 0 or not np.isfinite(force.tolerance):
            return Answer([mp.mpf(0)] * n, np.inf, force.status if force.status < 0 else ANY_ANSWER, force.rank)
        with mp.workdps(DIGITS):
            J = [point.values["J"][n * i : n * (i + 1)] for i in range(m)]
            R = [mp.fsum(J[i][c] * force.tau[i] for i in range(m)) for c in range(n)]
        size, reach = _norm(point.values["J"]), _norm(force.tau)
        tolerance = size * force.tolerance + _norm(point.bounds["J"]) * reach
        tolerance += (m + 1) * self.solver.epsilon * size * reach + m * float(np.finfo(self.scalar).smallest_subnormal)
        return Answer(R, tolerance, force.status, force.rank)

    def _unweighted(self, point: Point, sigma: Answer) -> Answer:
        """tau = L^-T sigma where there is a weight."""
        pattern = self.control.recover
        if not pattern or sigma.status < 0:
            return sigma
        entries = point.values["recover"]
        with mp.workdps(DIGITS):
            tau = [mp.fsum(entries[e] * sigma.tau[j] for e, j in row) for row in pattern]
        size, reach = _norm(entries), _norm(sigma.tau)
        tolerance = (
            size * sigma.tolerance + _norm(point.bounds["recover"]) * reach if sigma.tolerance < np.inf else np.inf
        )
        tolerance += (len(pattern) + 1) * self.solver.epsilon * size * reach
        return Answer(tau, tolerance, sigma.status, sigma.rank)

    def _free(self, k: int) -> str | FloatArray | None:
        if self.control.y == "input":
            return np.asarray(self.inputs["y"][k])
        return self.control.free if self.control.y == "expression" else None

    def _solved(
        self,
        point: Point,
        matrix: str,
        right: str,
        status: Status,
        free: str | FloatArray | None,
        solver: SolverPlan | None = None,
    ) -> Answer:
        """What a solve gives for the system (matrix, right) at a point; free: y, or its name among the quantities."""
        solver = solver or self.solver
        l = solver.l
        if status < 0:
            return Answer([mp.mpf(0)] * l, np.inf, status, 0)
        S, z = point.rounded[matrix].reshape(-1, l), point.rounded[right]
        y_rounded = point.rounded[free] if isinstance(free, str) else np.zeros(l) if free is None else free
        _, info = textbook_solver.solve(S, z, y_rounded, solver)
        if info.status < 0:
            return Answer([mp.mpf(0)] * l, np.inf, info.status, 0)
        y = point.values[free] if isinstance(free, str) else [mp.mpf(float(x)) for x in y_rounded]
        if info.rank == 0:
            error = _norm(point.bounds[free]) if isinstance(free, str) else 0.0
            return Answer(y, error, info.status, 0)
        if info.rank < min(solver.m, l) or info.status == Status.REGULARISED:
            return _truncated(point, matrix, right, y_rounded, info, solver)
        y_error = _norm(point.bounds[free]) if isinstance(free, str) else 0.0
        tau, tolerance = _full_rank(point, matrix, right, y, y_error, solver)
        return Answer(tau, tolerance, info.status if np.isfinite(tolerance) else ANY_ANSWER, info.rank)

    def vector_set(self) -> VectorSet:
        """Test vectors of every entry point, for the harness."""
        fields = tuple((f.name, f.size) for f in self.module.inputs)
        entries = [self._entry_vectors(e.name, tuple(r.name for r in e.kernel.results), bool(e.kernel.guards))
                   for e in self.module.entry_points]  # fmt: skip
        if self.control.reaction is not None:
            entries.append(self._reaction_vectors())
        entries += [self._pinv_vectors(), self._control_vectors("control", self.answers)]
        if self.control.projection is not None:
            projected, stepped = self._bent_projections() if self.control.curvature else self._projections()
            entries += [
                self._control_vectors("project", projected),
                self._control_vectors("step", stepped, float(self.dtype(STEP_DT))),
            ]
        params = {n: [float(x) for x in v.ravel()] for n, v in self.parameters.items()}
        inputs = {name: self.inputs[name] for name, _ in fields}
        return VectorSet(self.module.target.prefix, self.scalar, tuple(entries), params, fields, inputs)

    def expected(self, name: str) -> np.ndarray[Any, Any]:
        """A quantity's 50-digit values, object array (N, size)."""
        return np.array([p.values[name] for p in self.points], dtype=object)

    def scale(self, name: str) -> float:
        """The largest magnitude of a quantity over the drawn states, the domain."""
        values = [abs(float(v)) for p in self.points[: self.drawn] for v in p.values[name]]
        return max((v for v in values if np.isfinite(v)), default=0.0)

    def _entry_vectors(self, entry: str, names: tuple[str, ...], needs_mass: bool) -> EntryVectors:
        status = np.array([self._evaluated(k, names, needs_mass) for k in range(self.count)], dtype=int)
        outputs = []
        for name in names:
            bounds = np.stack([p.bounds[name] for p in self.points])
            values, tolerance = _comparable(self.expected(name), bounds, self.scalar)
            outputs.append(OutputVectors.of(name, values, tolerance, self.scale(name), self.scalar))
        return EntryVectors(entry, "plain", tuple(outputs), status, domain=self.drawn)

    def _pinv_vectors(self) -> EntryVectors:
        """S+ of the matrices the scalar's own evaluation gives, against exact rationals."""
        m, l = self.solver.m, self.solver.l
        matrix = self.control.matrix
        matrices = np.stack([p.rounded[matrix] for p in self.points]).astype(self.dtype)
        values, tolerance, status, rank = [], [], [], []
        for flat in matrices:
            S = flat.reshape(m, l).astype(float)
            refused, info = textbook_solver.pinv(S, self.solver)
            truth, kappa = self._pseudo_inverse(S, info) if info.status >= 0 else (refused, 1.0)
            size = _norm(truth)
            limit = BAR * self.solver.epsilon * kappa * size + float(np.finfo(self.scalar).smallest_subnormal)
            values.append(truth.ravel())
            tolerance.append(np.full(m * l, limit if info.status >= 0 and np.isfinite(size) else np.inf))
            status.append(int(info.status))
            rank.append(info.rank)
        stacked = np.stack(values)
        drawn = stacked[: self.drawn]
        scale = float(np.max(np.abs(drawn[np.isfinite(drawn)]), initial=0.0))
        expected, limits = _comparable(stacked, np.stack(tolerance), self.scalar)
        output = OutputVectors.of(f"{self.control.system.matrix}_pinv", expected, limits, scale, self.scalar)
        given = {"S": matrices}
        ranks = np.array(rank)
        return EntryVectors("pinv", "pinv", (output,), np.array(status), ranks, arguments=given, domain=self.drawn)

    def _pseudo_inverse(self, S: FloatArray, info: Info) -> tuple[FloatArray, float]:
        """S+ and the condition of what it keeps: exact at full rank, else by the SVD at 50 digits."""
        S = textbook_solver.counted_rows(S, self.solver)
        if info.status != Status.REGULARISED and info.rank in (0, min(S.shape)):
            sigma = np.linalg.svd(S, compute_uv=False)
            with np.errstate(divide="ignore"):  # of subnormal rows the smallest may vanish: nothing to compare there
                kappa = float(sigma[0] / sigma[-1]) if info.rank else 1.0
            return exact.nearest(exact.pinv(exact.rational(S))), kappa
        nothing = np.zeros(S.shape[1])
        columns = [pseudo_solution(S, e, nothing, info.rank, self.solver.damping) for e in np.eye(len(S))]
        return np.array([[float(v) for v in column] for column, _ in columns]).T, columns[0][1]

    def _control_vectors(self, entry: str, answers: list[Answer], dt: float | None = None) -> EntryVectors:
        values = np.array([a.tau for a in answers], dtype=object)
        tolerance = np.stack([np.full(self.solver.l, a.tolerance) for a in answers])
        known = [abs(float(v)) for a in answers[: self.drawn] if np.isfinite(a.tolerance) for v in a.tau]
        expected, limits = _comparable(values, tolerance, self.scalar)
        name = self.control.system.answer if entry == "control" else "tau"
        output = OutputVectors.of(name, expected, limits, max(known, default=0.0), self.scalar)
        status = np.array([a.status for a in answers])
        rank = np.array([a.rank if a.status not in (ANY_ANSWER, ANY_STATUS) else ANY_RANK for a in answers])
        call: Any = entry
        return EntryVectors(entry, call, (output,), status, rank, dt, domain=self.drawn)

    def _reaction_vectors(self) -> EntryVectors:
        """R of ideal control forces, against J^T times the exact forces of constraint."""
        values = np.array([a.tau for a in self.reactions], dtype=object)
        tolerance = np.stack([np.full(len(a.tau), a.tolerance) for a in self.reactions])
        drawn = self.reactions[: self.drawn]
        known = [abs(float(v)) for a in drawn if np.isfinite(a.tolerance) for v in a.tau]
        expected, limits = _comparable(values, tolerance, self.scalar)
        output = OutputVectors.of("R", expected, limits, max(known, default=0.0), self.scalar)
        return EntryVectors("R", "plain", (output,), np.array([a.status for a in self.reactions]), domain=self.drawn)

    def _projections(self) -> tuple[list[Answer], list[Answer]]:
        """Expected answers of project and step where phi is affine in tau: A, and so the projection, is exact."""
        projected = [self._projected(k, self.points[k], self.inputs["tau"][k], 0.0) for k in range(self.count)]
        dt = float(self.dtype(STEP_DT))
        moved = np.array([_moved(self.inputs["tau"][k], a, dt) for k, a in enumerate(self.answers)], dtype=object)
        points = self._points(self.inputs | {"tau": moved})
        stepped = []
        for k, (answer, point) in enumerate(zip(self.answers, points, strict=True)):
            if answer.status < 0:
                stepped.append(Answer(answer.tau, np.inf, answer.status, 0))
                continue
            size = _norm(moved[k])
            carried = dt * answer.tolerance + 2 * self.solver.epsilon * size
            after = self._projected(k, point, moved[k], carried)
            both = ANY_ANSWER in (answer.status, after.status)
            status = after.status if after.status < 0 else ANY_ANSWER if both else max(answer.status, after.status)
            stepped.append(Answer(after.tau, after.tolerance, status, after.rank))
        return projected, stepped

    def _bent_projections(self) -> tuple[list[Answer], list[Answer]]:
        """The same where phi is not affine in tau; where the textbook's iteration finds nothing, any status will do."""
        program = cut(self.program, "projection", ("phi", "A", "curvature"))
        projection = Projection(program, self.control.curvature, self.scalar)
        twin = reference(self.scene, self.scalar)
        assert isinstance(twin, ControlsTwin)
        dt = float(self.dtype(STEP_DT))
        projected, stepped = [], []
        for k in range(self.count):
            at = {n: v[k] for n, v in self.inputs.items()}
            start = [mp.mpf(float(v)) for v in at["tau"]]
            projected.append(self._bent(k, projection, twin.project(**at), start, 0.0))
            control = self.answers[k]
            if control.status < 0 or not np.isfinite(control.tolerance) or not self.finite[k]:
                unknown = control.status if control.status < 0 else ANY_STATUS
                stepped.append(Answer(start, np.inf, unknown, ANY_RANK))
                continue
            moved = list(_moved(at["tau"], control, dt))
            carried = dt * control.tolerance + 2 * self.solver.epsilon * _norm(moved)
            after = self._bent(k, projection, twin.step(dt, **at), moved, carried)
            known = after.status == Status.OK
            status = control.status if known else after.status  # the greater: a control's remark stays
            stepped.append(Answer(after.tau, after.tolerance, status, after.rank))
        return projected, stepped

    def _bent(self, k: int, projection: Projection, guess: Control, start: Exact, carried: float) -> Answer:
        """What project gives from `start` at state k, near what the textbook's iteration found."""
        unknown = Answer([mp.mpf(0)] * self.solver.l, np.inf, ANY_STATUS, ANY_RANK)
        if not self.finite[k]:
            return Answer(unknown.tau, np.inf, Status.NONFINITE, 0)
        if guess.info.status < 0 or guess.info.rank < self.solver.m or guess.info.status == Status.REGULARISED:
            return unknown
        inputs = {n: v[k : k + 1] for n, v in self.inputs.items()} | self.parameters
        inputs = {n: np.array(v, dtype=float) for n, v in inputs.items()}
        found = projection.nearest(inputs, start, guess.value, carried)
        if found is None or _norm(np.array([float(v) for v in found.tau]) - guess.value) > 2 * found.tolerance:
            return unknown
        return Answer(found.tau, found.tolerance, Status.OK, self.solver.m)

    def _projected(self, k: int, point: Point, tau: Any, carried: float) -> Answer:
        """tau - A+ phi, exact where phi is affine in tau; `carried` is the 2-norm of an error tau comes with."""
        l = self.solver.l
        status = Status.OK if self.finite[k] else Status.NONFINITE
        if status == Status.OK and not all(np.all(np.isfinite(point.rounded[n])) for n in ("phi", "A")):
            status = Status.OVERFLOW
        if status < 0:
            return Answer([mp.mpf(0)] * l, np.inf, status, 0)
        values = point.values | {"phi": [-v for v in point.values["phi"]]}
        rounded = point.rounded | {"phi": -point.rounded["phi"]}
        move = self._solved(Point(values, point.bounds, rounded, point.status), "A", "phi", status, None)
        start = [v if isinstance(v, mp.mpf) else mp.mpf(float(v)) for v in tau]
        with mp.workdps(DIGITS):
            answer = [a + b for a, b in zip(start, move.tau, strict=True)]
        size = _norm(start) + _norm(move.tau)
        tolerance = move.tolerance + self.solver.epsilon * size + 2 * carried
        return Answer(answer, tolerance, move.status, move.rank)


def _full_rank(
    point: Point, matrix: str, right: str, y: Exact, y_error: float, solver: SolverPlan
) -> tuple[Exact, float]:
    """tau to 50 digits, and the 2-norm by which the code may miss it."""
    m, l = solver.m, solver.l
    if not all(mp.isfinite(v) for name in (matrix, right) for v in point.values[name]):
        return y, np.inf
    S = _rational(point.values[matrix], m, l)
    inverse = exact.pinv_full(S)
    tau = exact.solution(S, inverse, _rational(point.values[right], m, 1), _rational(y, l, 1))
    sizes = np.array([float(v) for v in point.values[matrix]]).reshape(m, l)
    S_error, z_error = _norm(point.bounds[matrix]), _norm(point.bounds[right])
    sigma = np.linalg.svd(sizes, compute_uv=False)
    reach = _norm(exact.nearest(tau)) + _norm(y)
    if not np.isfinite(reach) or sigma[-1] == 0 or S_error > _TRUSTED * sigma[-1]:
        return y, np.inf
    rounding = BAR * solver.epsilon * sigma[0] / sigma[-1] * reach
    rest = exact.rational(np.array([0.0])) if m <= l else S * tau - _rational(point.values[right], m, 1)
    residual = _norm(exact.nearest(rest))
    carried = (z_error + 2 * S_error * reach + S_error * residual / sigma[-1]) / sigma[-1]
    smallest = l * float(np.finfo(solver.scalar).smallest_subnormal)
    return _values(tau), float(rounding + carried + 2 * y_error + smallest)


def _truncated(point: Point, matrix: str, right: str, y: FloatArray, info: Info, solver: SolverPlan) -> Answer:
    """tau of a system below full rank or damped: that of the SVD at 50 digits of the scalar's own S, z and y.

    The rank is the textbook's decision. Such an answer jumps with S, so nothing but the solver is judged by it.
    """
    S, z = point.rounded[matrix].reshape(solver.m, solver.l), point.rounded[right]
    tau, kappa = pseudo_solution(textbook_solver.counted_rows(S, solver), z, y, info.rank, solver.damping)
    residual = _norm(z - S @ np.array([float(v) for v in tau]))
    size = _norm(S)
    carried = kappa * residual / size if size > 0 else 0.0
    tolerance = BAR * solver.epsilon * kappa * (_norm(tau) + _norm(y) + carried)
    return Answer(tau, tolerance if np.isfinite(tolerance) else np.inf, info.status, info.rank)


def _in_own_units(point: Point, m: int) -> Point:
    """The rows of J, and with them both sides of the system of R, in the code's powers of two."""
    unit = -textbook_solver.symmetric_units(point.rounded["reaction_matrix"].reshape(m, m).astype(float))
    by_row = np.repeat(unit, len(point.values["J"]) // m)
    shifts = {"reaction_matrix": (unit[:, None] + unit).ravel(), "reaction_right": unit, "J": by_row}
    values, bounds, rounded = dict(point.values), dict(point.bounds), dict(point.rounded)
    for name, shift in shifts.items():
        values[name] = [mp.ldexp(v, int(k)) for v, k in zip(values[name], shift, strict=True)]
        with np.errstate(over="ignore"):
            bounds[name] = np.ldexp(bounds[name].ravel(), shift)
            rounded[name] = np.ldexp(rounded[name].ravel(), shift.astype(np.int32))
    return Point(values, bounds, rounded, point.status)


def _moved(tau: FloatArray, answer: Answer, dt: float) -> Exact:
    with mp.workdps(DIGITS):
        start = [mp.mpf(float(x)) for x in tau]
        if answer.status < 0 or not np.isfinite(answer.tolerance):
            return start
        return [a + dt * b for a, b in zip(start, answer.tau, strict=True)]


def _norm(values: Any) -> float:
    """2-norm of numbers of any kind, without overflow or underflow on the way."""
    sizes = np.array([abs(float(v)) for v in np.ravel(values)])
    largest = float(np.max(sizes, initial=0.0))
    return largest * float(np.linalg.norm(sizes / largest)) if 0 < largest < np.inf else largest


def _row(values: FloatArray, k: int) -> FloatArray:
    """Row k; a constant quantity has one row for all."""
    return np.asarray(values[k if len(values) > 1 else 0])


def _rational(values: Exact, rows: int, columns: int) -> exact.Matrix:
    """mpf values as exact rationals."""
    return flint.fmpq_mat(rows, columns, [_fmpq(v) for v in values])


def _fmpq(value: Any) -> Any:
    fraction = as_fraction(value)
    return flint.fmpq(fraction.numerator, fraction.denominator)


def _values(column: exact.Matrix) -> Exact:
    with mp.workdps(DIGITS):
        entries = [column[i, 0] for i in range(column.nrows())]
        return [mp.mpf(int(q.p)) / int(q.q) for q in entries]


def _comparable(expected: Any, tolerance: FloatArray, scalar: str) -> tuple[Any, FloatArray]:
    """Values and tolerances with what cannot be compared (not finite, or beyond the scalar) taken out."""
    largest = float(np.finfo(scalar).max)
    sizes = np.array([[abs(float(v)) for v in row] for row in expected])
    good = np.isfinite(sizes) & (sizes < largest / 4) & np.isfinite(tolerance)
    return np.where(good, expected, 0.0 if expected.dtype != object else mp.mpf(0)), np.where(good, tolerance, np.inf)
