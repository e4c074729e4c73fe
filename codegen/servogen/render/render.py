"""Module -> source files: the templates are printed with what the planner decided."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from servogen.errors import SceneError
from servogen.law.law import Law, Routine, of_the_state, shapes
from servogen.law.steps import (
    STATE,
    STEPS,
    SYSTEM,
    Apply,
    Call,
    Cascade,
    Evaluate,
    Invert,
    Project,
    React,
    Solve,
    Step,
    handed_out,
    row_of,
)
from servogen.plan.module import Module, Target, cost_of
from servogen.plan.operations import cascade_operations, known_operations, solver_operations
from servogen.render import core
from servogen.render.fold import folded
from servogen.render.kernels import pieces, reads, statements
from servogen.render.lanes import lanes_context
from servogen.render.literals import literal
from servogen.render.mathematics import math_context
from servogen.render.solver_context import PLAIN, paths, solver_context, statuses
from servogen.render.unused import without_unused
from servogen.results import OF_PASSIVE, STATUS_MEANING, Status
from servogen.scalars import BITS, EPSILON, Scalar
from servogen.scene.names import comment_safe
from servogen.version import VERSION


@dataclass(frozen=True)
class SourceFile:
    """A file of a package: its name and its text."""

    name: str
    text: str


@cache
def environment(folder: str = "render") -> Environment:
    """The C templates in servogen/<folder>/templates; a name that is not defined is an error."""
    templates = Environment(
        loader=PackageLoader("servogen", f"{folder}/templates"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # C, not HTML
    )
    templates.filters["comment"] = comment_safe
    templates.filters["word"] = _word
    return templates


def render(module: Module, casadi_abi: bool = False, batch: bool = False) -> tuple[SourceFile, ...]:
    """<prefix>.h, <prefix>.c, CMakeLists.txt and manifest.json of a scene, of a solver alone or of a plant.

    casadi_abi: also <prefix>_casadi.c, which `casadi.external` loads (scenes only).
    batch: also <prefix>_batch.h and .c, many states at once.
    """
    return render_with_core(module, casadi_abi, batch)[0]


def render_with_core(
    module: Module, casadi_abi: bool = False, batch: bool = False
) -> tuple[tuple[SourceFile, ...], Mapping[str, core.Block]]:
    """The files, and what they need of the target's core; nothing where it has none."""
    _check_defaults(module)
    prefix = module.target.prefix
    templates = environment()
    context = _context(module)
    kind = "package" if module.law.routines else "plant"
    source = without_unused(templates.get_template(f"{kind}.c.j2").render(context))
    blocks: Mapping[str, core.Block] = {}
    if module.target.core:
        source, blocks = core.cut_out(source, module, _of_words(context))
    files = [
        SourceFile(f"{prefix}.h", folded(templates.get_template(f"{kind}.h.j2").render(context))),
        SourceFile(f"{prefix}.c", folded(source)),
        SourceFile("CMakeLists.txt", templates.get_template("CMakeLists.txt.j2").render(context | {"batch": batch})),
    ]
    if casadi_abi:
        shim = templates.get_template("casadi.c.j2").render(context | _shim(module))
        files.append(SourceFile(f"{prefix}_casadi.c", shim))
    if batch:
        lanes = context | lanes_context(module)
        files.append(SourceFile(f"{prefix}_batch.h", folded(templates.get_template("batch.h.j2").render(lanes))))
        many = without_unused(templates.get_template("batch.c.j2").render(lanes))
        files.append(SourceFile(f"{prefix}_batch.c", folded(many)))
    return (*files, SourceFile("manifest.json", _manifest(module, files))), blocks


def _of_words(context: dict[str, Any]) -> str:
    """All C of bits and mathematics, which depends on the scalar alone."""
    everything = context | {"own_functions": ("sqrt", "reduce", "sin", "cos", "sincos")}
    everything["mt"] = math_context(context["module"].target.scalar)
    parts = ("number.c.j2", "solver/words.c.j2", "solver/unroll.c.j2")
    return "\n".join(environment().get_template(part).render(everything) for part in parts)


def render_core(
    name: str, users: Mapping[str, Mapping[str, core.Block]], scalars: Sequence[Scalar]
) -> tuple[SourceFile, ...]:
    """<name>.h, <name>.c and CMakeLists.txt of a core. users: by prefix, what they need; scalars: theirs."""
    blocks = core.ordered(core.merged(b for needed in users.values() for b in needed.values()))
    context = {
        "core": name,
        "C": name.upper(),
        "version": VERSION,
        "users": sorted(users),
        "infos": [(Target(s, name).real, core.info_type(name, s)) for s in EPSILON if s in scalars],
        "statuses": statuses(),
        "paths": paths(),
        "inside": [
            core.prototype(b) if b.kind == "function" else b.text for b in blocks if b.kind != "function" or b.named
        ],
        "functions": [b.text if b.named else core.hidden(b) for b in blocks if b.kind == "function"],
    }
    found = {f"{name}.h": "core.h.j2", f"{name}.c": "core.c.j2", "CMakeLists.txt": "core_CMakeLists.txt.j2"}
    return tuple(SourceFile(n, environment().get_template(t).render(context)) for n, t in found.items())


def _context(module: Module) -> dict[str, Any]:
    scalar = module.target.scalar
    own = module.target.prefix if module.own_functions else ""
    lit = partial(literal, scalar=scalar)
    if module.solver is not None:
        target = module.target.prefix
        numbers = solver_context(module.solver, target, lit, module.limits, module.cascade, module.joins)
    else:
        evaluating = [s for s in (Status.OK, *STEPS[Evaluate].statuses) if module.joins or s not in OF_PASSIVE]
        numbers = {
            "lit": lit,
            "bits": BITS[scalar],
            "statuses": [(s.name, int(s), STATUS_MEANING[s]) for s in evaluating],
        }
    return (
        module.context()
        | numbers
        | _law_context(module)
        | {
            "version": VERSION,
            "title": _title(module),
            "math": module.needs_libm,
            "cost": lambda program: cost_of(program.operations()),
            "prepare_cost": cost_of(module.prepare.program.operations()),
            "solver_cost": _solver_cost(module),
            "statements": partial(statements, scalar=scalar, own=own),
            "pieces": partial(pieces, scalar=scalar, own=own),
            "pieces_anywhere": any(k.chunks for k in module.kernels),
            "own_functions": module.own_functions,
            "mt": math_context(scalar) if module.own_functions else None,
            "reads": reads,
            "initialiser": partial(_initialiser, scalar=scalar),
            "info_type": f"{module.target.prefix}_info",
            "in_prepare": module.known_matrix.kernel if module.known_matrix else None,
            "free": module.free,
            "named": _named(module),
            "solved": _solved_by(module, SYSTEM),
            "solved_by": partial(_solved_by, module),
            "core": module.target.core,
            "core_info": core.info_type(module.target.core, scalar),
        }
    )


def _law_context(module: Module) -> dict[str, Any]:
    """What the templates ask about the law."""
    law, prefix = module.law, module.target.prefix
    return {
        "sizes": {name: rows * columns for name, (rows, columns) in shapes(law).items()},
        "word": _word,
        "of_the_state": of_the_state,
        "refused_behind": _refused_behind,
        "prefix_of": lambda solver: prefix if solver == SYSTEM else f"{prefix}_{solver}",
        "first_of_the_state": next((r.name for r in law.routines if of_the_state(r)), ""),
        "printed_once": _printed_once(law),
    }


def _refused_behind(routine: Routine) -> bool:
    """Whether what a routine evaluates first is looked at by the steps behind it, which refuse what is not finite."""
    return all(row_of(step).refuses for step in routine.steps[1:])


def _word(step: Step) -> str:
    return row_of(step).word


def _printed_once(law: Law) -> dict[str, list[Step]]:
    """By routine, the steps that no routine before it takes: what their C calls is printed ahead of it."""
    told: set[Step] = set()
    found: dict[str, list[Step]] = {}
    for routine in law.routines:
        found[routine.name] = [s for s in routine.steps if s not in told]
        told |= set(routine.steps)
    return found


def _named(module: Module) -> dict[str, str]:
    """The names of the equation that `info` is about, for comments."""
    if module.system is None:
        return PLAIN
    return {"matrix": module.system.matrix, "right": module.system.right, "unknown": module.system.symbol}


def _solved_by(module: Module, solver: str) -> dict[str, str]:
    """What a solver's S, z and tau are in the scene; the reaction's is not the scene's system."""
    if solver != SYSTEM:
        return {"matrix": "J Q^-1 J^T", "right": "its right side", "unknown": "the force of the constraints"}
    return _named(module)


def _shim(module: Module) -> dict[str, Any]:
    """The arguments of the external function: parameters, then inputs, each a dense column."""
    assert module.system is not None
    fields = [("params", f) for f in module.parameters] + [("in", f) for f in module.inputs]
    arguments = [
        {"index": k, "struct": struct, "name": f.name, "size": f.size, "default": f.default or (0.0,)}
        for k, (struct, f) in enumerate(fields)
    ]
    return {"arguments": arguments, "answer": module.system.answer}


def _title(module: Module) -> str:
    if module.solver is None:
        return f"functions of scene {module.scene}: {', '.join(e.name for e in module.entry_points)}"
    return f"controller of scene {module.scene}" if module.system else f"pseudo-inverse {module.scene}"


def _check_defaults(module: Module) -> None:
    """SceneError naming the parameter whose default does not fit the type."""
    for f in module.parameters:
        try:
            _initialiser(f.default, module.target.scalar)
        except SceneError as error:
            raise SceneError(f"parameter {f.name!r}: {error}") from None


def _initialiser(values: tuple[float, ...], scalar: str) -> str:
    """C initialiser of a struct's member: a number, or numbers in braces."""
    numbers = ", ".join(literal(v, scalar) for v in values)
    return numbers if len(values) == 1 else f"{{{numbers}}}"


def _solver_cost(module: Module) -> str:
    if module.solver is None:
        return "none"
    if module.known_matrix is not None:
        total = known_operations(module.solver, module.free is not None)["apply"]["total"]
        return f"{total} operations, no factorisation"
    if module.cascade is not None:
        costs = cascade_operations(module.cascade, module.solver)
        usual = f"{costs['qr']['total']} operations (QR, level by level), " if "qr" in costs else ""
        cap = module.cascade.sweep_cap
        return f"{usual}at most {costs['svd']['total']} (SVD, {cap} sweeps a level)" if "svd" in costs else usual[:-2]
    costs = solver_operations(module.solver)
    if "closed_form" in costs:
        return f"{costs['closed_form']['total']} operations, closed form"
    if "cod" in costs:
        return f"{costs['qr']['total']} operations at full rank, at most {costs['cod']['total']} below (no iteration)"
    usual = f"{costs['normal']['total']} operations (normal equations), " if "normal" in costs else ""
    return f"{usual}at most {costs['svd']['total']} (SVD, at most {module.solver.sweep_cap} sweeps)"


def _manifest(module: Module, files: list[SourceFile]) -> str:
    costs = solver_operations(module.solver) if module.solver is not None else None
    manifest: dict[str, Any] = {
        "generator": f"servogen {VERSION}",
        "scene": module.scene,
        "scene_hash": module.scene_hash,
        "scalar": module.target.scalar,
        "prefix": module.target.prefix,
        "math": module.target.math,
        "entry_points": _entry_points(module),
    }
    if module.solver is not None:
        manifest["solver"] = module.solver.to_json() | {"operations": costs}
        manifest["solver"]["known"] = module.known_matrix.when if module.known_matrix else None
        if module.cascade is not None:
            manifest["solver"]["priorities"] = module.cascade.to_json()
        if module.limits is not None:
            manifest["solver"]["limits"] = module.limits.to_json()
    if module.target.core:
        manifest["core"] = module.target.core
    manifest["files"] = {f.name: hashlib.sha256(f.text.encode()).hexdigest() for f in files}
    if module.entry_points:
        manifest["prepare"] = {"operations": module.prepare.program.operations(), "skipped": []}
        manifest["parameters"] = {f.name: _struct_field(f) for f in module.parameters}
        manifest["inputs"] = {f.name: _struct_field(f) for f in module.inputs}
    return json.dumps(manifest, indent=2) + "\n"


def _struct_field(f: Any) -> dict[str, Any]:
    return {"size": f.size, "default": list(f.default), "unit": f.unit, "text": f.text}


def _entry_points(module: Module) -> dict[str, Any]:
    """Operations of each entry point; routines of the law say the solver's own in "solver_operations"."""
    points: dict[str, Any] = {}
    for entry in module.entry_points:
        points[entry.name] = {
            "operations": entry.kernel.program.operations(),
            "skipped": list(module.skipped.get(entry.name, ())),
        }
    for routine in module.law.routines:
        points[routine.name] = {
            "operations": _operations(module, routine),
            "solver_operations": _solving(module, routine),
            "skipped": _skipped(module, routine),
        }
    return points


def _operations(module: Module, routine: Routine) -> dict[str, int]:
    """Of the routine's own kernels, and of those of the routines that it calls."""
    total = {"total": 0}
    for step in routine.steps:
        if isinstance(step, Evaluate | Project):
            total = _sum(total, module.kernel(handed_out(step)).program.operations())
        elif isinstance(step, Call):
            total = _sum(total, _operations(module, module.law.routine(step.routine)))
    return total


def _solving(module: Module, routine: Routine) -> dict[str, Any]:
    """The operations of the solver that the routine ends with."""
    for step in reversed(routine.steps):
        if isinstance(step, Apply):
            return known_operations(module.solvers[step.solver], module.free is not None)
        if isinstance(step, Cascade):
            assert module.cascade is not None
            return cascade_operations(module.cascade, module.solvers[step.solver])
        if isinstance(step, Call):
            return _solving(module, module.law.routine(step.routine))
        if isinstance(step, Solve | Invert | Project | React):
            return solver_operations(module.solvers[step.solver])
    return {"total": 0}


def _skipped(module: Module, routine: Routine) -> list[str]:
    affine = [step for step in routine.steps if isinstance(step, Project) and not step.curvature]
    reasons = [f"iteration: {step.value} is affine in {step.of.removeprefix(STATE)}" for step in affine]
    return [*module.skipped.get(routine.name, ()), *reasons]


def _sum(a: dict[str, int], b: dict[str, int]) -> dict[str, int]:
    return {key: a.get(key, 0) + b.get(key, 0) for key in {**a, **b}}
