"""Program -> Module: entry points, binding times, the solver's shape, names and what is skipped."""

import dataclasses
import hashlib
from collections.abc import Sequence

from servogen.derive.formulation import Formulation, MassTreatment, Quantity
from servogen.derive.ideal import REACTION
from servogen.derive.lower import MASS_PIVOT, MASS_SCALE
from servogen.ir.infix import infix
from servogen.ir.program import Input, Program
from servogen.plan.chunks import split
from servogen.plan.known import plan_known
from servogen.plan.mathematics import Math, pair_angles
from servogen.plan.module import (
    ControlPlan,
    EntryPoint,
    Kernel,
    Module,
    Prepare,
    Reaction,
    Result,
    StructField,
    Target,
)
from servogen.plan.noise import row_noise
from servogen.plan.skipped import what_is_skipped
from servogen.plan.solver import SolverPlan, plan_solver
from servogen.plan.stage import Staged, cut, stage
from servogen.scalars import EPSILON, Scalar
from servogen.scene.scene import Scene
from servogen.scene.solver import Solver
from servogen.scene.symbols import Field
from servogen.scene_program import SceneProgram

PROJECTION_CAP = 25
"""Iterations of project where phi is not affine in tau; Newton's method ends in far fewer or not at all."""

AFFINE_CAP = 2
"""Iterations of project where it is: one is exact, another takes back the rounding of a start far away."""


def plan(formulation: Formulation, optimised: SceneProgram, target: Target) -> Module:
    """Every decision about the C of one scene."""
    scene, program = formulation.scene, optimised.program
    staged = stage(program)
    cutter = _Cutter(staged, formulation.quantities, optimised.free_of_mass, target.math)
    system = scene.system
    names = (system.constraint, "T", "F") if scene.kind == "ideal" else (system.constraint, system.matrix, system.right)
    entry_points = [EntryPoint(name, cutter.kernel(name)) for name in names]
    if scene.kind != "ideal":
        entry_points.append(EntryPoint(f"{system.matrix}_{system.right}", cutter.kernel(system.matrix, system.right)))
    solver = dataclasses.replace(plan_scene_solver(formulation, optimised, target.scalar), root=_root(target))
    control = _plan_control(formulation, staged, cutter, solver)
    always = ({"tau"} if system.tau_is_state else set()) | ({"y"} if control.y == "input" else set())
    inputs = _used(scene.input_fields(), staged.tick, always)
    return Module(
        scene=scene.name,
        target=target,
        scene_hash=scene_hash(scene, program),
        parameters=_parameters(scene),
        model=_model(scene, staged),
        inputs=inputs,
        prepare=Prepare(staged.prepare, staged.prepare_guards, pair_angles(staged.prepare, target.math)),
        kernels=cutter.kernels(),
        entry_points=tuple(entry_points),
        control=control,
        solver=solver,
        mass_tolerance=_mass_tolerance(scene, target.scalar),
        skipped=what_is_skipped(formulation, optimised, control, solver, inputs, staged),
    )


def plan_scene_solver(formulation: Formulation, optimised: SceneProgram, scalar: Scalar) -> SolverPlan:
    """The solver of the scene's system, without a root; rows' tolerances that the user left open are their noise."""
    scene, solver = formulation.scene, formulation.scene.solver
    if solver.atol is None:
        noise = row_noise(scene, optimised.program, formulation.factorised, scalar)
        solver = dataclasses.replace(solver, atol=noise)
    return plan_solver(*scene.system_shape, scalar, solver)


def _plan_control(formulation: Formulation, staged: Staged, cutter: "_Cutter", solver: SolverPlan) -> ControlPlan:
    """What the control function computes itself, and what it is handed."""
    scene, matrix = formulation.scene, formulation.factorised
    weight = formulation.weight
    free = "y" if weight is None else "y_w"
    y = None if scene.y is None else "input" if isinstance(scene.y, str) and weight is None else "expression"
    known = plan_known(staged, cutter.result(matrix), solver) if not scene.system.tau_is_state else None
    reaction = None
    right: tuple[str, ...] = (scene.system.right,)
    if scene.kind == "ideal":
        right = REACTION
        planned = plan_solver(scene.rows, scene.rows, solver.scalar, _reaction_solver(scene.solver))
        planned = dataclasses.replace(planned, root=solver.root)
        reaction = Reaction(cutter.kernel(*REACTION), planned, scene.system_shape[0])
    names = ((matrix,) if known is None else ()) + right
    names += (free,) if y == "expression" else ()
    names += ("recover",) if weight is not None else ()
    kernel = cutter.kernel(*names)
    if known is not None and known.kernel is not None:
        cutter.add(known.kernel)
    curvature = formulation.curvature
    bends = ("curvature",) if curvature else ()
    system = scene.system
    projection = cutter.kernel(system.constraint, system.matrix, *bends) if system.tau_is_state else None
    cap = 0 if projection is None else PROJECTION_CAP if curvature else AFFINE_CAP
    pattern = weight.pattern if weight is not None else ()
    return ControlPlan(kernel, system, matrix, y, free, pattern, known, reaction, projection, cap, curvature)


def _reaction_solver(solver: Solver) -> Solver:
    """For J Q^-1 J^T: tolerances per row, and damping, are the user's for G alone."""
    return Solver(method=solver.method, rank=solver.rank)


def plan_solver_only(m: int, l: int, target: Target, solver: Solver) -> Module:
    """The pseudo-inverse alone."""
    nothing = Program("nothing", (), (), ())
    planned = plan_solver(m, l, target.scalar, solver)
    name = f"pinv_{m}x{l}"
    digest = hashlib.sha256(repr(planned).encode()).hexdigest()
    planned = dataclasses.replace(planned, root=_root(target))
    return Module(name, target, digest, (), (), (), Prepare(nothing), (), (), None, planned, 0.0)


def plan_functions(
    scene: Scene, quantities: Sequence[Quantity], mass: MassTreatment, optimised: SceneProgram, target: Target
) -> Module:
    """One entry point that computes all quantities together: the plant of a simulation."""
    program = optimised.program
    staged = stage(program)
    cutter = _Cutter(staged, quantities, optimised.free_of_mass, target.math)
    kernel = cutter.kernel(*(q.name for q in quantities))
    tau = Field("tau", scene.mechanism.tau, (0.0,) * scene.controls)
    fields = scene.input_fields() if scene.system.tau_is_state else (*scene.input_fields(), tau)
    return Module(
        scene=scene.name,
        target=target,
        scene_hash=scene_hash(scene, program),
        parameters=_parameters(scene),
        model=_model(scene, staged),
        inputs=_used(fields, staged.tick, {"q", "u", "tau"}),
        prepare=Prepare(staged.prepare, staged.prepare_guards, pair_angles(staged.prepare, target.math)),
        kernels=cutter.kernels(),
        entry_points=(EntryPoint(kernel.name, kernel),),
        control=None,
        solver=None,
        mass_tolerance=_mass_tolerance(scene, target.scalar),
    )


def _root(target: Target) -> str:
    """The square root that the solver calls: the package's own, or ""."""
    return f"{target.prefix}_sqrt" if target.math == "own" else ""


def scene_hash(scene: Scene, program: Program) -> str:
    """SHA-256 of everything that decides the package but the target."""
    text = [str(program), repr(scene.solver), repr(scene.name)]
    text += [repr((f.name, f.default, f.unit, f.text)) for f in (*scene.parameters, *scene.input_fields())]
    return hashlib.sha256("\n".join(text).encode()).hexdigest()


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
            guarded = self._staged.tick_guards if dividing else 0
            outputs = names + ((MASS_PIVOT, MASS_SCALE) if guarded else ())
            results = tuple(self.result(q.name) for q in quantities)
            program = cut(self._staged.tick, label, outputs)
            chunks = split(program)
            pairs = () if chunks else pair_angles(program, self._math)  # a pair cannot cross from piece to piece
            self._kernels[label] = Kernel(label, program, results, guarded, chunks, pairs)
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
