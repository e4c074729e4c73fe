"""Program -> Module: entry points, binding times, the solver's shape, names and what is skipped."""

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence

from servogen.derive.formulation import Formulation, Quantity
from servogen.derive.lower import MASS_PIVOT, MASS_SCALE
from servogen.ir.infix import infix
from servogen.ir.program import Input, Program
from servogen.law.law import Law, Routine, check_legal, restricted
from servogen.law.steps import SYSTEM, Apply, Evaluate, Invert, Limit, Project, Solve, Step, handed_out
from servogen.plan.bounds import plan_bounds
from servogen.plan.cascade import plan_cascade
from servogen.plan.chunks import split
from servogen.plan.known_matrix import plan_known_matrix
from servogen.plan.mathematics import Math, pair_angles
from servogen.plan.module import EntryPoint, Kernel, KnownMatrix, Module, Prepare, Result, StructField, Target
from servogen.plan.skipped import what_is_skipped
from servogen.plan.solver import SolverPlan, plan_solver
from servogen.plan.stage import Guards, Staged, cut, stage
from servogen.scalars import EPSILON, Scalar
from servogen.scene.scene import Scene
from servogen.scene.solver import Solver
from servogen.scene.symbols import Field
from servogen.scene_program import SceneProgram


def plan(
    formulation: Formulation,
    optimised: SceneProgram,
    target: Target,
    noise: Sequence[float] | None = None,
    entry_points: Sequence[str] | None = None,
) -> Module:
    """Every decision about the C of one scene.

    noise: per row of the solver's matrix, at or below which it counts as zero where the user gave no atol.
    entry_points: functions to leave in, with what they call; None: all.
    """
    scene = formulation.scene
    law = formulation.law if entry_points is None else restricted(formulation.law, entry_points)
    staged = stage(_needed(optimised, formulation, law), formulation.mass.joining)
    cutter = _Cutter(staged, formulation.quantities, optimised.free_of_mass, target.math)
    entries = [EntryPoint("_".join(names), cutter.kernel(*names)) for names in law.entries]
    solvers = _plan_solvers(formulation, noise, law, target)
    known = _plan_known_matrix(law, staged, cutter, solvers)
    if known is not None and solvers[SYSTEM].method != "cod":  # inverted once: the exact value costs no tick anything
        solvers[SYSTEM] = dataclasses.replace(solvers[SYSTEM], sigma_min="exact")
    law = check_legal(_at_hand(law, known.name) if known is not None else law)
    for step in law.steps():
        if isinstance(step, Evaluate | Project):
            cutter.kernel(*handed_out(step))
    if known is not None and known.kernel is not None:
        cutter.add(known.kernel)
    inputs = _used(scene.input_fields(), staged.tick, {name for name, _ in law.inputs})
    return Module(
        scene=scene.name,
        target=target,
        scene_hash=scene_hash(scene, optimised.program),
        parameters=_parameters(scene),
        model=_model(scene, staged),
        inputs=inputs,
        prepare=_prepare(staged, target),
        kernels=cutter.kernels(),
        entry_points=tuple(entries),
        law=law,
        mass_tolerance=_mass_tolerance(scene, target.scalar),
        system=scene.system,
        solvers=solvers,
        known_matrix=known,
        limits=plan_bounds(law, solvers),
        cascade=plan_cascade(law, solvers),
        skipped=what_is_skipped(formulation, optimised, law, known, solvers, inputs, staged),
    )


def _needed(optimised: SceneProgram, formulation: Formulation, law: Law) -> Program:
    """The scene's program less the quantities that nothing in the law evaluates, and tests of Q that none needs."""
    used = {name for names in law.entries for name in names}
    used |= {n for step in law.steps() if isinstance(step, Evaluate | Project) for n in handed_out(step)}
    kept = {q.name for q in formulation.quantities if q.name in used}
    if any(q.needs_mass for q in formulation.quantities if q.name in used):
        kept |= {MASS_PIVOT, MASS_SCALE}
    outputs = tuple(o for o in optimised.program.outputs if o.name in kept)
    return dataclasses.replace(optimised.program, outputs=outputs)


def _plan_solvers(
    formulation: Formulation, noise: Sequence[float] | None, law: Law, target: Target
) -> dict[str, SolverPlan]:
    """The law's solvers; tolerances per row, and damping, are the user's for the scene's own system alone."""
    users = formulation.scene.solver
    other = Solver(method=users.method, rank=users.rank)
    planned = {
        name: _plan_system(formulation.scene, noise, target.scalar)
        if name == SYSTEM
        else plan_solver(*shape, target.scalar, other)
        for name, shape in law.solvers
    }
    return {name: dataclasses.replace(solver, root=_root(target)) for name, solver in planned.items()}


def _plan_known_matrix(
    law: Law, staged: Staged, cutter: "_Cutter", solvers: Mapping[str, SolverPlan]
) -> KnownMatrix | None:
    """The matrix of the scene's system where no state changes it; a projection needs its solver all the same."""
    projected = any(isinstance(step, Project) for step in law.steps())
    if projected or not any(isinstance(step, Solve) and step.solver == SYSTEM for step in law.steps()):
        return None
    return plan_known_matrix(staged, cutter.result(law.matrix_of(SYSTEM)), solvers[SYSTEM])


def _at_hand(law: Law, matrix: str) -> Law:
    """The law with the pseudo-inverse of that matrix at hand: solves apply it, and nothing but limits evaluates it."""

    limited = any(isinstance(step, Limit) and step.matrix == matrix for step in law.steps())

    def staged(step: Step) -> Step:
        if isinstance(step, Evaluate) and not limited:
            return Evaluate(tuple(name for name in step.into if name != matrix))
        if isinstance(step, Solve) and step.matrix == matrix:
            return Apply(step.into, step.solver, step.matrix, step.right, step.free)
        return step

    routines = [dataclasses.replace(r, steps=tuple(map(staged, r.steps))) for r in law.routines]
    return dataclasses.replace(law, routines=tuple(routines))


def _plan_system(scene: Scene, noise: Sequence[float] | None, scalar: Scalar) -> SolverPlan:
    """The solver of the scene's system, without a root; rows' tolerances that the user left open are their noise."""
    solver = scene.solver
    if solver.atol is None and noise is not None:
        solver = dataclasses.replace(solver, atol=tuple(noise))
    return plan_solver(*scene.system_shape, scalar, solver)


def plan_solver_only(m: int, l: int, target: Target, solver: Solver, limits: bool = False) -> Module:
    """The pseudo-inverse alone; limits: its answer within limits that the caller gives."""
    nothing = Program("nothing", (), (), ())
    planned = plan_solver(m, l, target.scalar, solver)
    name = f"pinv_{m}x{l}"
    law = _solver_law(name, m, l, limits)
    bounds = plan_bounds(law, {SYSTEM: planned})
    text = repr(planned) + (repr(bounds) if bounds else "")
    digest = hashlib.sha256(text.encode()).hexdigest()
    planned = dataclasses.replace(planned, root=_root(target))
    return Module(
        scene=name,
        target=target,
        scene_hash=digest,
        parameters=(),
        model=(),
        inputs=(),
        prepare=Prepare(nothing),
        kernels=(),
        entry_points=(),
        law=law,
        mass_tolerance=0.0,
        solvers={SYSTEM: planned},
        limits=bounds,
    )


def _solver_law(name: str, m: int, l: int, limits: bool) -> Law:
    """Its two functions, of matrices that the caller gives."""
    S, z, y = ("S", (m, l)), ("z", (m, 1)), ("y", (l, 1))
    solve = Routine("solve", (Solve("tau", SYSTEM, "S", "z", "y"),), "tau", (S, z, y))
    if limits:
        free = Solve("start", SYSTEM, "S", "z", "y")
        limit = Limit("tau", SYSTEM, "start", "S", "z", "lower", "upper", "y")
        solve = Routine("solve", (free, limit), "tau", (S, z, y, ("lower", (l, 1)), ("upper", (l, 1))))
    invert = Routine("pinv", (Invert("S_pinv", SYSTEM, "S"),), "S_pinv", (S,))
    return check_legal(Law(name, solvers=((SYSTEM, (m, l)),), routines=(solve, invert)))


def plan_functions(
    scene: Scene, quantities: Sequence[Quantity], optimised: SceneProgram, target: Target, joining: int = 0
) -> Module:
    """One entry point that computes all quantities together: the plant of a simulation. joining: see `stage`."""
    program = optimised.program
    staged = stage(program, joining)
    cutter = _Cutter(staged, quantities, optimised.free_of_mass, target.math)
    kernel = cutter.kernel(*(q.name for q in quantities))
    tau = Field("tau", scene.mechanism.tau, (0.0,) * scene.controls)
    fields = {f.name: f for f in scene.input_fields()}
    fields.setdefault("tau", tau)
    return Module(
        scene=scene.name,
        target=target,
        scene_hash=scene_hash(scene, program),
        parameters=_parameters(scene),
        model=_model(scene, staged),
        inputs=_used(tuple(fields.values()), staged.tick, {"q", "u", "tau"}),
        prepare=_prepare(staged, target),
        kernels=cutter.kernels(),
        entry_points=(EntryPoint(kernel.name, kernel),),
        law=check_legal(_law_of(scene.name, quantities)),
        mass_tolerance=_mass_tolerance(scene, target.scalar),
    )


def _law_of(name: str, quantities: Sequence[Quantity]) -> Law:
    """A law that hands out quantities, all at once, and solves nothing."""
    shapes = tuple((q.name, q.expression.shape) for q in quantities)
    return Law(name, quantities=shapes, entries=(tuple(q.name for q in quantities),))


def _root(target: Target) -> str:
    """The square root that the solver calls: the package's own, or ""."""
    return f"{target.prefix}_sqrt" if target.math == "own" else ""


def scene_hash(scene: Scene, program: Program) -> str:
    """SHA-256 of everything that decides the package but the target."""
    text = [str(program), repr(scene.solver), repr(scene.name)]
    text += [repr((f.name, f.default, f.unit, f.text)) for f in (*scene.parameters, *scene.input_fields())]
    if scene.cascaded:
        text.append(repr((scene.levels, scene.switches)))
    if scene.sides is not None:
        text += [
            scene.sides.policy,
            *(repr(side if isinstance(side, str) else side.open) for _, side in scene.sides.each()),
        ]
    return hashlib.sha256("\n".join(text).encode()).hexdigest()


def _prepare(staged: Staged, target: Target) -> Prepare:
    guards = staged.prepare_guards
    return Prepare(staged.prepare, guards.count, guards.joining, pair_angles(staged.prepare, target.math))


class _Cutter:
    """Cuts kernels from the tick program, each set of outputs once; those free of Q need no test of its pivots."""

    def __init__(
        self, staged: Staged, quantities: Sequence[Quantity], free_of_mass: frozenset[str], math: Math
    ) -> None:
        self._free_of_mass = free_of_mass
        self._staged = staged
        self._math: Math = math
        self._quantities = {q.name: q for q in quantities}
        self._kernels: dict[str, Kernel] = {}

    def kernel(self, *names: str) -> Kernel:
        label = "_".join(names)
        if label not in self._kernels:
            quantities = [self._quantities[n] for n in names]
            dividing = any(q.needs_mass and q.name not in self._free_of_mass for q in quantities)
            guards = self._staged.tick_guards if dividing else Guards()
            outputs = names + ((MASS_PIVOT, MASS_SCALE) if guards.count else ())
            results = tuple(self.result(q.name) for q in quantities)
            program = cut(self._staged.tick, label, outputs)
            chunks = split(program)
            pairs = () if chunks else pair_angles(program, self._math)  # a pair cannot cross from piece to piece
            self._kernels[label] = Kernel(label, program, results, guards.count, guards.joining, chunks, pairs)
        return self._kernels[label]

    def result(self, name: str) -> Result:
        q = self._quantities[name]
        return Result(q.name, q.expression.size1(), q.expression.size2(), q.equation, q.formula)

    def add(self, kernel: Kernel) -> None:
        self._kernels[kernel.name] = kernel

    def kernels(self) -> tuple[Kernel, ...]:
        return tuple(self._kernels.values())


def _used(fields: Sequence[Field], tick: Program, always: set[str]) -> tuple[StructField, ...]:
    leaves = {i.const[0] for i in tick.instrs if isinstance(i.const, tuple)}
    return tuple(_struct_field(f) for f in fields if f.name in leaves | always)


def _struct_field(f: Field) -> StructField:
    return StructField(f.name, f.size, f.unit, f.text, f.default)


def _parameters(scene: Scene) -> tuple[StructField, ...]:
    return tuple(_struct_field(f) for f in scene.parameters)


def _model(scene: Scene, staged: Staged) -> tuple[StructField, ...]:
    known = {f.name: f for f in scene.parameters}
    fields = []
    for i in staged.tick.inputs:
        if i.kind == "model":
            parameter = known.get(i.name)
            fields.append(_struct_field(parameter) if parameter else _computed_field(i, staged.prepare))
    return tuple(fields)


def _computed_field(i: Input, prepare: Program) -> StructField:
    """A field that prepare computes, its formula as the text."""
    return StructField(i.name, i.size, text=infix(prepare, prepare.output(i.name).nodes[0]))


def _mass_tolerance(scene: Scene, scalar: Scalar) -> float:
    return float(scene.mechanism.Q.size1()) * EPSILON[scalar]
