"""What the generated code ought to answer at given states: 50-digit values, expected statuses, and how far off
correctly rounded code may be.

Tolerances are no guesses: S, z, A, B may differ by the first-order rounding bound of their own operations
(ir/rounding.py), what a routine of the law leaves by what its steps do to these errors (answers.py).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from servogen import exact
from servogen.compiler import optimised_scene, reference
from servogen.derive.lower import MASS_PIVOT, MASS_SCALE
from servogen.ir.balls import ZERO, balls, working
from servogen.ir.evaluate import evaluate, evaluate_exactly
from servogen.ir.rounding import rounding_bounds
from servogen.law.law import Routine, of_the_state, shapes
from servogen.law.steps import STATE, SYSTEM, Advance, Call, Evaluate, Project
from servogen.plan.module import Module
from servogen.plan.stage import cut
from servogen.results import Control, FloatArray, Info, Status
from servogen.scene.domain import boundary_states, draw_states
from servogen.scene.scene import Scene, State
from servogen.scene.solver import Solver
from servogen.singular import pseudo_solution
from servogen.textbook import pseudo_inverse
from servogen.textbook.policy import policy_for
from servogen.verify.answers import (
    BAR,
    Answer,
    Exact,
    Point,
    Surroundings,
    advanced,
    answer_of,
    norm,
    solved,
    unknown,
    worse,
)
from servogen.verify.projection import Projection
from servogen.verify.vectors import ANY_ANSWER, ANY_RANK, ANY_STATUS, EntryVectors, OutputVectors, VectorSet

STEP_DT = 1e-3
"""dt of the vectors of step, in seconds."""

_SECOND_ORDER = 1.01  # first-order bounds are off by their square


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
        self.scene, self.module, self.drawn = scene, module, drawn
        self.law, self.shapes = module.law, shapes(module.law)
        self.scalar = module.target.scalar
        self.policies = {
            name: policy_for(*shape, self.scalar, scene.solver, module.solver.atol)
            if name == SYSTEM
            else policy_for(*shape, self.scalar, Solver(rank=scene.solver.rank))
            for name, shape in self.law.solvers
        }
        self.solver = self.policies[SYSTEM]
        self.dtype = np.dtype(self.scalar).type
        with np.errstate(over="ignore"):
            self.inputs = {n: v.astype(self.dtype) for n, v in states.items()}
        self.parameters = {f.name: np.array(f.default, self.dtype).reshape(1, -1) for f in module.parameters}
        self.count = len(next(iter(self.inputs.values())))
        formulation, optimised = optimised_scene(scene)
        needing = {q.name for q in formulation.quantities if q.needs_mass} - optimised.free_of_mass
        self.of_mass = frozenset({*needing, MASS_PIVOT, MASS_SCALE})
        self.joining = formulation.mass.joining
        self.program, self.exact = optimised.program, optimised.exact
        self.names = [o.name for o in self.program.outputs if o.name not in (MASS_PIVOT, MASS_SCALE)]
        self.problems: list[str] = []
        self.finite = np.array([self._inputs_finite(k) for k in range(self.count)])
        self.points = self._points(self.inputs)
        self._answers: dict[str, list[Answer]] = {}

    def _inputs_finite(self, k: int) -> bool:
        return all(np.all(np.isfinite(self.inputs[f.name][k])) for f in self.module.looked_at)

    def _points(self, inputs: dict[str, Any]) -> list[Point]:
        everything = inputs | self.parameters
        floats = {n: np.array(v, dtype=float) for n, v in everything.items()}
        bounds = rounding_bounds(self.program, floats, self.scalar)
        rounded = evaluate(self.program, everything, self.dtype)
        points = []
        pairs = zip(evaluate_exactly(self.program, everything), evaluate_exactly(self.exact, everything), strict=True)
        for k, (values, unoptimised) in enumerate(pairs):
            at = {n: _row(v, k).ravel() for n, v in rounded.items()}
            status = self._status(k, at)
            refused = (
                self.of_mass if status in (Status.SINGULAR_MASS, Status.DEAD_CENTRE) else frozenset()
            )  # divided by what is 0
            given = {n: v for n, v in values.items() if n not in refused}
            self._compare(k, given, unoptimised)
            limits: dict[str, FloatArray] = {
                n: _row(v, k) * _SECOND_ORDER + _radii(values[n]) for n, v in bounds.items()
            }
            points.append(Point(values, limits, at, status))
        return points

    def _compare(self, k: int, values: dict[str, Exact], unoptimised: dict[str, Exact]) -> None:
        """Note where optimisation changed an output: two balls of one value have a point in common."""
        for name, entries in values.items():
            for x, y in zip(entries, unoptimised[name], strict=True):
                if x.is_finite() and y.is_finite() and not x.overlaps(y):
                    change = f"{y.str(20, radius=False)} became {x.str(20, radius=False)}"
                    self.problems.append(f"optimisation changed {name} at state {k}: {change}; report this defect")

    def _status(self, k: int, at: dict[str, FloatArray]) -> Status:
        """Status of the code that needs Q, in the order the generated code tests in."""
        if not self.finite[k]:
            return Status.NONFINITE
        if MASS_PIVOT in at:
            of_mass = len(at[MASS_PIVOT]) - self.joining
            for i, (pivot, scale) in enumerate(zip(at[MASS_PIVOT], at[MASS_SCALE], strict=True)):
                if not np.isfinite(pivot):
                    return Status.OVERFLOW
                if not pivot > self.dtype(self.module.mass_tolerance) * scale:
                    return Status.SINGULAR_MASS if i < of_mass else Status.DEAD_CENTRE
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

    def answers(self, name: str) -> list[Answer]:
        """What a routine of the law ought to answer at each state."""
        if name not in self._answers:
            self._answers[name] = self._walked(self.law.routine(name))
        return self._answers[name]

    def _walked(self, routine: Routine) -> list[Answer]:
        first = routine.steps[0]
        if isinstance(first, Evaluate):
            return [self._evaluating(routine, k) for k in range(self.count)]
        if isinstance(first, Project):
            return self._projecting(routine, Moved(self.points, self.inputs[_input(first)], np.zeros(self.count)))
        return self._calling(routine)

    def _evaluating(self, routine: Routine, k: int) -> Answer:
        """An evaluation and steps on what it leaves: the greatest status counts, the first negative one ends it."""
        kernel = self.module.kernel(routine.evaluated())
        size = self.shapes[routine.result][0]
        status: int = self._evaluated(k, routine.evaluated(), bool(kernel.guards))
        if status < 0:
            return unknown(size, status, 0)
        inputs = {n: v[k] for n, v in self.inputs.items()}
        at = Surroundings(self.points[k], inputs, self.policies)
        for step in routine.steps[1:]:
            assert not isinstance(step, Evaluate)
            answer = answer_of(step, at)
            if answer.status < 0:
                return unknown(size, answer.status, answer.rank)
            status = worse(status, answer.status)
            at.answers[step.into] = answer
        return Answer(answer.tau, answer.tolerance, status, answer.rank)

    def _calling(self, routine: Routine) -> list[Answer]:
        """Calls, between them an input advanced along what the first one answered."""
        first, advance, last = routine.steps
        assert isinstance(first, Call)
        assert isinstance(advance, Advance)
        assert isinstance(last, Call)
        rates, start, dt = self.answers(first.routine), self.inputs[_input(advance)], float(self.dtype(STEP_DT))
        ways = [advanced(advance, start[k], rates[k], dt) for k in range(self.count)]
        moved = np.array([values for values, _ in ways], dtype=object)
        carried = np.array([error + 2 * self.solver.epsilon * norm(values) for values, error in ways])
        there = Moved(self._points(self.inputs | {_input(advance): moved}), moved, carried)
        after = self._projecting(self.law.routine(last.routine), there)
        return [self._after(*pair) for pair in zip(rates, after, strict=True)]

    def _after(self, before: Answer, after: Answer) -> Answer:
        """The answer of a call behind another: the greater status, the first negative one."""
        if before.status < 0:
            return Answer(before.tau, np.inf, before.status, 0)
        if after.status < 0:
            return after
        return Answer(after.tau, after.tolerance, worse(before.status, after.status), after.rank)

    def vector_set(self) -> VectorSet:
        """Test vectors of every entry point, for the harness."""
        fields = tuple((f.name, f.size) for f in self.module.inputs)
        entries = [self._entry_vectors(e.name, tuple(r.name for r in e.kernel.results), bool(e.kernel.guards))
                   for e in self.module.entry_points]  # fmt: skip
        entries += [self._routine_vectors(routine) for routine in self.law.routines]
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

    def _pinv_vectors(self, routine: Routine) -> EntryVectors:
        """S+ of the matrices the scalar's own evaluation gives, against exact rationals."""
        m, l = self.solver.m, self.solver.l
        matrix = self.law.matrix_of(SYSTEM)
        matrices = np.stack([p.rounded[matrix] for p in self.points]).astype(self.dtype)
        values, tolerance, status, rank = [], [], [], []
        for flat in matrices:
            S = flat.reshape(m, l).astype(float)
            refused, info = pseudo_inverse.pinv(S, self.solver)
            truth, kappa = self._pseudo_inverse(S, info) if info.status >= 0 else (refused, 1.0)
            size = norm(truth)
            limit = BAR * self.solver.epsilon * kappa * size + float(np.finfo(self.scalar).smallest_subnormal)
            values.append(truth.ravel())
            tolerance.append(np.full(m * l, limit if info.status >= 0 and np.isfinite(size) else np.inf))
            status.append(int(info.status))
            rank.append(info.rank)
        stacked = np.stack(values)
        drawn = stacked[: self.drawn]
        scale = float(np.max(np.abs(drawn[np.isfinite(drawn)]), initial=0.0))
        expected, limits = _comparable(stacked, np.stack(tolerance), self.scalar)
        output = OutputVectors.of(routine.result, expected, limits, scale, self.scalar)
        given = {"S": matrices}
        ranks = np.array(rank)
        return EntryVectors(
            routine.name, "pinv", (output,), np.array(status), ranks, arguments=given, domain=self.drawn
        )

    def _pseudo_inverse(self, S: FloatArray, info: Info) -> tuple[FloatArray, float]:
        """S+ and the condition of what it keeps: exact at full rank, else by the SVD at 50 digits."""
        S = pseudo_inverse.counted_rows(S, self.solver)
        if info.status != Status.REGULARISED and info.rank in (0, min(S.shape)):
            sigma = np.linalg.svd(S, compute_uv=False)
            with np.errstate(divide="ignore"):  # of subnormal rows the smallest may vanish: nothing to compare there
                kappa = float(sigma[0] / sigma[-1]) if info.rank else 1.0
            return exact.nearest(exact.pinv(exact.rational(S))), kappa
        nothing = np.zeros(S.shape[1])
        columns = [pseudo_solution(S, e, nothing, info.rank, self.solver.damping) for e in np.eye(len(S))]
        return np.array([[float(v) for v in column] for column, _ in columns]).T, columns[0][1]

    def _routine_vectors(self, routine: Routine) -> EntryVectors:
        """Vectors of a routine: of the state with or without info, or of matrices that the caller gives."""
        if not of_the_state(routine):
            return self._pinv_vectors(routine)
        answers = self.answers(routine.name)
        values = np.array([a.tau for a in answers], dtype=object)
        tolerance = np.stack([np.full(values.shape[1], a.tolerance) for a in answers])
        known = [abs(float(v)) for a in answers[: self.drawn] if np.isfinite(a.tolerance) for v in a.tau]
        expected, limits = _comparable(values, tolerance, self.scalar)
        output = OutputVectors.of(routine.result, expected, limits, max(known, default=0.0), self.scalar)
        status = np.array([a.status for a in answers])
        if not routine.info:
            return EntryVectors(routine.name, "plain", (output,), status, domain=self.drawn)
        rank = np.array([a.rank if a.status not in (ANY_ANSWER, ANY_STATUS) else ANY_RANK for a in answers])
        numbers = (float(self.dtype(STEP_DT)),) * len(routine.arguments)
        return EntryVectors(routine.name, "control", (output,), status, rank, numbers, domain=self.drawn)

    def _projecting(self, routine: Routine, moved: "Moved") -> list[Answer]:
        """The nearest vectors to those of `moved` for which the value of the routine's step vanishes."""
        (step,) = routine.steps
        assert isinstance(step, Project)
        if not step.curvature:
            return [self._projected(step, k, moved) for k in range(self.count)]
        projection = Projection(cut(self.program, "projection", step.quantities), step, self.scalar)
        near = getattr(reference(self.scene, self.scalar), routine.name)
        return [self._bent(k, projection, near, moved) for k in range(self.count)]

    def _bent(self, k: int, projection: Projection, near: Callable[..., Control], moved: "Moved") -> Answer:
        """What a projection gives at state k, near what the textbook's iteration finds, if it finds anything."""
        nothing = unknown(self.solver.l, ANY_STATUS)
        if not self.finite[k]:
            return unknown(self.solver.l, Status.NONFINITE, 0)
        if not np.isfinite(moved.carried[k]):
            return nothing
        inputs = {n: v[k] for n, v in self.inputs.items()}
        start = balls(moved.tau[k])
        guess = near(**(inputs | {_input(projection.step): np.array([float(v) for v in start])}))
        if guess.info.status < 0 or guess.info.rank < self.solver.m or guess.info.status == Status.REGULARISED:
            return nothing
        held = {n: v[k : k + 1] for n, v in self.inputs.items()} | self.parameters
        held = {n: np.array(v, dtype=float) for n, v in held.items()}
        found = projection.nearest(held, start, guess.value, float(moved.carried[k]))
        if found is None or norm(np.array([float(v) for v in found.tau]) - guess.value) > 2 * found.tolerance:
            return nothing
        return Answer(found.tau, found.tolerance, Status.OK, self.solver.m)

    def _projected(self, step: Project, k: int, moved: "Moved") -> Answer:
        """tau - A+ phi, exact where phi is affine in tau."""
        l, point, tau = self.solver.l, moved.points[k], moved.tau[k]
        status = Status.OK if self.finite[k] else Status.NONFINITE
        if status == Status.OK and not all(np.all(np.isfinite(point.rounded[n])) for n in step.quantities):
            status = Status.OVERFLOW
        if status < 0:
            return unknown(l, status, 0)
        values = point.values | {step.value: [-v for v in point.values[step.value]]}
        rounded = point.rounded | {step.value: -point.rounded[step.value]}
        negated = Point(values, point.bounds, rounded, point.status)
        move = solved(negated, step.matrix, step.value, None, self.policies[step.solver])
        start = balls(tau)
        with working():
            answer = [a + b for a, b in zip(start, move.tau, strict=True)]
        size = norm(start) + norm(move.tau)
        tolerance = move.tolerance + self.solver.epsilon * size + 2 * float(moved.carried[k])
        return Answer(answer, tolerance, move.status, move.rank)


@dataclass(frozen=True, eq=False)
class Moved:
    """The states with another input, tau (N, l): what the program says there, and the 2-norms of tau's errors."""

    points: list[Point]
    tau: Any
    carried: FloatArray


def _input(step: Advance | Project) -> str:
    """The input that it moves."""
    return step.of.removeprefix(STATE)


def _radii(values: Exact) -> FloatArray:
    """How far the truth itself may be off."""
    return np.array([float(v.rad()) for v in values])


def _row(values: FloatArray, k: int) -> FloatArray:
    """Row k; a constant quantity has one row for all."""
    return np.asarray(values[k if len(values) > 1 else 0])


def _comparable(expected: Any, tolerance: FloatArray, scalar: str) -> tuple[Any, FloatArray]:
    """Values and tolerances with what cannot be compared (not finite, or beyond the scalar) taken out."""
    largest = float(np.finfo(scalar).max)
    sizes = np.array([[abs(float(v)) for v in row] for row in expected])
    good = np.isfinite(sizes) & (sizes < largest / 4) & np.isfinite(tolerance)
    return np.where(good, expected, 0.0 if expected.dtype != object else ZERO), np.where(good, tolerance, np.inf)
