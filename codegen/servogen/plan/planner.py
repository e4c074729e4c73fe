"""Program -> Module: entry points, binding times, the solver's shape, names and what is skipped."""

import hashlib
from collections.abc import Sequence

from servogen.derive.formulation import Formulation, MassTreatment, Quantity
from servogen.derive.lower import MASS_PIVOT, MASS_SCALE
from servogen.ir.infix import infix
from servogen.ir.program import Input, Program
from servogen.plan.module import ControlPlan, EntryPoint, Kernel, Module, Prepare, Result, StructField, Target
from servogen.plan.solver import SolverPlan, plan_solver
from servogen.plan.stage import Staged, cut, stage
from servogen.scene.scene import Scene
from servogen.scene.solver import EPSILON, Scalar, Solver
from servogen.scene.symbols import Field

PROJECTION_CAP = 25
"""Iterations of project where phi is not affine in tau; Newton's method ends in far fewer or not at all."""


def plan(formulation: Formulation, program: Program, target: Target) -> Module:
    """Every decision about the C of one scene."""
    scene = formulation.scene
    staged = stage(program)
    cutter = _Cutter(staged, formulation.quantities)
    matrix, right = formulation.system
    constraint = formulation.constraint
    entry_points = [
        EntryPoint(constraint, cutter.kernel(constraint)),
        EntryPoint(matrix, cutter.kernel(matrix)),
        EntryPoint(right, cutter.kernel(right)),
        EntryPoint(f"{matrix}_{right}", cutter.kernel(matrix, right)),
    ]
    y = None if scene.y is None else "input" if isinstance(scene.y, str) else "expression"
    system = (matrix, right, "y") if y == "expression" else (matrix, right)
    projection = cutter.kernel(constraint, matrix) if scene.kind == "controls" else None
    cap = 0 if projection is None else 1 if formulation.affine_in_tau else PROJECTION_CAP
    control = ControlPlan(cutter.kernel(*system), (matrix, right), y, projection, cap)
    always = {"tau"} if scene.kind == "controls" else {"y"} if y == "input" else set()
    inputs = _used(scene.input_fields(), staged.tick, always)
    solver = plan_solver(scene.rows, scene.controls, target.scalar, scene.solver)
    return Module(
        scene=scene.name,
        target=target,
        scene_hash=scene_hash(scene, program),
        parameters=_parameters(scene),
        model=_model(scene, staged),
        inputs=inputs,
        prepare=Prepare(staged.prepare, staged.prepare_guards),
        kernels=cutter.kernels(),
        entry_points=tuple(entry_points),
        control=control,
        solver=solver,
        mass_tolerance=_mass_tolerance(scene, target.scalar),
        skipped=_skipped(scene, formulation.mass, solver, inputs, staged),
    )


def plan_solver_only(m: int, l: int, target: Target, solver: Solver) -> Module:
    """The pseudo-inverse alone."""
    nothing = Program("nothing", (), (), ())
    planned = plan_solver(m, l, target.scalar, solver)
    name = f"pinv_{m}x{l}"
    digest = hashlib.sha256(repr(planned).encode()).hexdigest()
    return Module(name, target, digest, (), (), (), Prepare(nothing), (), (), None, planned, 0.0)


def plan_functions(
    scene: Scene, quantities: Sequence[Quantity], mass: MassTreatment, program: Program, target: Target
) -> Module:
    """One entry point that computes all quantities together: the plant of a simulation."""
    staged = stage(program)
    cutter = _Cutter(staged, quantities)
    kernel = cutter.kernel(*(q.name for q in quantities))
    tau = Field("tau", scene.mechanism.tau, (0.0,) * scene.controls)
    fields = scene.input_fields() if scene.kind == "controls" else (*scene.input_fields(), tau)
    return Module(
        scene=scene.name,
        target=target,
        scene_hash=scene_hash(scene, program),
        parameters=_parameters(scene),
        model=_model(scene, staged),
        inputs=_used(fields, staged.tick, {"q", "u", "tau"}),
        prepare=Prepare(staged.prepare, staged.prepare_guards),
        kernels=cutter.kernels(),
        entry_points=(EntryPoint(kernel.name, kernel),),
        control=None,
        solver=None,
        mass_tolerance=_mass_tolerance(scene, target.scalar),
    )


def scene_hash(scene: Scene, program: Program) -> str:
    """SHA-256 of everything that decides the package but the scalar and the prefix."""
    assert scene.parameters is not None
    text = [str(program), repr(scene.solver), repr(scene.name)]
    text += [repr((f.name, f.default, f.unit, f.text)) for f in (*scene.parameters, *scene.input_fields())]
    return hashlib.sha256("\n".join(text).encode()).hexdigest()


class _Cutter:
    """Cuts kernels from the tick program, each set of outputs once."""

    def __init__(self, staged: Staged, quantities: Sequence[Quantity]) -> None:
        self._staged = staged
        self._quantities = {q.name: q for q in quantities}
        self._kernels: dict[str, Kernel] = {}

    def kernel(self, *names: str) -> Kernel:
        label = "_".join(names)
        if label not in self._kernels:
            quantities = [self._quantities[n] for n in names]
            guarded = self._staged.tick_guards if any(q.needs_mass for q in quantities) else 0
            outputs = names + ((MASS_PIVOT, MASS_SCALE) if guarded else ())
            results = tuple(
                Result(q.name, q.expression.size1(), q.expression.size2(), q.equation, q.formula) for q in quantities
            )
            self._kernels[label] = Kernel(label, cut(self._staged.tick, label, outputs), results, guarded)
        return self._kernels[label]

    def kernels(self) -> tuple[Kernel, ...]:
        return tuple(self._kernels.values())


def _used(fields: Sequence[Field], tick: Program, always: set[str]) -> tuple[StructField, ...]:
    leaves = {i.const[0] for i in tick.instrs if isinstance(i.const, tuple)}
    return tuple(_struct_field(f) for f in fields if f.name in leaves | always)


def _struct_field(f: Field) -> StructField:
    return StructField(f.name, f.size, f.unit, f.text, f.default)


def _parameters(scene: Scene) -> tuple[StructField, ...]:
    assert scene.parameters is not None
    return tuple(_struct_field(f) for f in scene.parameters)


def _model(scene: Scene, staged: Staged) -> tuple[StructField, ...]:
    assert scene.parameters is not None
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


def _skipped(
    scene: Scene, mass: MassTreatment, solver: SolverPlan, inputs: Sequence[StructField], staged: Staged
) -> dict[str, tuple[str, ...]]:
    """What this scene does not need, by entry point, with the reason."""
    system: list[str] = [f"inverse of Q: {mass.reason}"]
    if scene.mechanism.C is None:
        system.append("C: q' = u")
    if scene.mechanism.D is None:
        system.append("D: absent")
    if scene.mechanism.t is None:
        system.append("t: the model does not depend on time")
    unused = [f.name for f in scene.input_fields() if f.name not in {i.name for i in inputs}]
    system += [f"{name}: no output depends on it" for name in unused]
    early = staged.prepare.operations()["total"]
    if early:
        system.append(f"{early} operations of parameters alone: done once, in prepare")
    control = list(system)
    if solver.kind != "full":
        control.append(f"SVD: S is a {solver.kind}, the closed form is exact")
    if scene.y is None:
        control.append("null-space projector: y is absent")
    matrix, right = ("S", "z") if scene.kind == "servo" else ("A", "B")
    by_entry = {name: tuple(system) for name in (matrix, right, f"{matrix}_{right}")}
    return by_entry | {"control": tuple(control)}
