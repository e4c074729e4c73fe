"""Module -> source files: the templates are printed with what the planner decided."""

import hashlib
import json
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from servogen.errors import SceneError
from servogen.plan.known import known_operations
from servogen.plan.module import Kernel, Module, cost_of
from servogen.plan.solver import BITS, solver_context, solver_operations
from servogen.render.kernels import pieces, reads, statements
from servogen.render.literals import literal
from servogen.render.mathematics import math_context
from servogen.results import STATUS_MEANING, Status
from servogen.scene.names import comment_safe
from servogen.version import VERSION

PLANT_STATUSES = (Status.OK, Status.NONFINITE, Status.SINGULAR_MASS, Status.OVERFLOW)
"""What a function can return that solves nothing by a pseudo-inverse."""


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
    return templates


def render(module: Module, casadi_abi: bool = False) -> tuple[SourceFile, ...]:
    """<prefix>.h, <prefix>.c, CMakeLists.txt and manifest.json of a scene, of a solver alone or of a plant.

    casadi_abi: also <prefix>_casadi.c, which `casadi.external` loads (scenes only).
    """
    _check_defaults(module)
    prefix = module.target.prefix
    templates = environment()
    context = _context(module)
    kind = "package" if module.solver is not None else "plant"
    files = [
        SourceFile(f"{prefix}.h", templates.get_template(f"{kind}.h.j2").render(context)),
        SourceFile(f"{prefix}.c", templates.get_template(f"{kind}.c.j2").render(context)),
        SourceFile("CMakeLists.txt", templates.get_template("CMakeLists.txt.j2").render(context)),
    ]
    if casadi_abi:
        shim = templates.get_template("casadi.c.j2").render(context | _shim(module))
        files.append(SourceFile(f"{prefix}_casadi.c", shim))
    return (*files, SourceFile("manifest.json", _manifest(module, files)))


def _context(module: Module) -> dict[str, Any]:
    scalar = module.target.scalar
    kernels = module.kernels
    own = module.target.prefix if module.own_functions else ""
    lit = partial(literal, scalar=scalar)
    if module.solver is not None:
        numbers = solver_context(module.solver, module.target.prefix, lit)
    else:
        statuses = [(s.name, int(s), STATUS_MEANING[s]) for s in PLANT_STATUSES]
        numbers = {"lit": lit, "bits": BITS[scalar], "statuses": statuses}
    named = module.context() | numbers
    return named | {
        "version": VERSION,
        "title": _title(module),
        "math": module.needs_libm,
        "cost": lambda program: cost_of(program.operations()),
        "prepare_cost": cost_of(module.prepare.program.operations()),
        "solver_cost": _solver_cost(module),
        "guards_anywhere": bool(module.prepare.guards or any(k.guards for k in kernels)),
        "statements": partial(statements, scalar=scalar, own=own),
        "pieces": partial(pieces, scalar=scalar, own=own),
        "pieces_anywhere": any(k.chunks for k in kernels),
        "own_functions": module.own_functions,
        "mt": math_context(scalar) if module.own_functions else None,
        "reads": reads,
        "initialiser": partial(_initialiser, scalar=scalar),
        "emit": _emitted(module),
        "info_type": f"{module.target.prefix}_info",
        "in_prepare": module.control.known.kernel if module.control and module.control.known else None,
        "checked": _checked(module),
        "scene_y": _scene_y(module),
    }


def _shim(module: Module) -> dict[str, Any]:
    """The arguments of the external function: parameters, then inputs, each a dense column."""
    assert module.control is not None
    fields = [("params", f) for f in module.parameters] + [("in", f) for f in module.inputs]
    arguments = [
        {"index": k, "struct": struct, "name": f.name, "size": f.size, "default": f.default or (0.0,)}
        for k, (struct, f) in enumerate(fields)
    ]
    return {"arguments": arguments, "answer": module.control.system.answer}


def _emitted(module: Module) -> dict[str, bool]:
    """Which functions of the solver the package calls; no other is printed."""
    known = module.control is not None and module.control.known is not None
    return {"solve": not known, "pinv": True, "known": known}


def _checked(module: Module) -> list[Kernel]:
    """The kernels of control whose results no solver looks at."""
    kernels: list[Kernel] = []
    control = module.control
    if control is not None and control.reaction is not None:
        kernels += [control.kernel, control.reaction.kernel]
    if control is not None and control.projection is not None and not control.curvature:
        kernels.append(control.projection)
    return kernels


def _scene_y(module: Module) -> str | None:
    """Where y comes from in the user's words: weighted, an input is an expression to the solver."""
    if module.control is None or module.control.y is None:
        return None
    return "input" if any(f.name == "y" for f in module.inputs) and module.control.y else module.control.y


def _title(module: Module) -> str:
    if module.solver is None:
        return f"functions of scene {module.scene}: {', '.join(e.name for e in module.entry_points)}"
    return f"controller of scene {module.scene}" if module.control else f"pseudo-inverse {module.scene}"


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
    if module.control is not None and module.control.known is not None:
        total = known_operations(module.solver, module.control.y is not None)["apply"]["total"]
        return f"{total} operations, no factorisation"
    costs = solver_operations(module.solver)
    if "closed_form" in costs:
        return f"{costs['closed_form']['total']} operations, closed form"
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
        "entry_points": _entry_points(module, costs),
    }
    if module.solver is not None:
        manifest["solver"] = module.solver.to_json() | {"operations": costs}
        manifest["solver"]["known"] = module.control.known.when if module.control and module.control.known else None
    manifest["files"] = {f.name: hashlib.sha256(f.text.encode()).hexdigest() for f in files}
    if module.entry_points:
        manifest["prepare"] = {"operations": module.prepare.program.operations(), "skipped": []}
        manifest["parameters"] = {f.name: _struct_field(f) for f in module.parameters}
        manifest["inputs"] = {f.name: _struct_field(f) for f in module.inputs}
    return json.dumps(manifest, indent=2) + "\n"


def _struct_field(f: Any) -> dict[str, Any]:
    return {"size": f.size, "default": list(f.default), "unit": f.unit, "text": f.text}


def _entry_points(module: Module, solver_counts: dict[str, Any] | None) -> dict[str, Any]:
    """Operations of each entry point; those that solve say the solver's own in "solver_operations"."""
    points: dict[str, Any] = {}
    for entry in module.entry_points:
        points[entry.name] = {
            "operations": entry.kernel.program.operations(),
            "skipped": list(module.skipped.get(entry.name, ())),
        }
    if solver_counts is None:
        return points
    nothing = {"total": 0}
    points["pinv"] = {"operations": nothing, "solver_operations": solver_counts, "skipped": []}
    if module.control is None:
        points["solve"] = {"operations": nothing, "solver_operations": solver_counts, "skipped": []}
        return points
    control = module.control
    if control.reaction is not None:
        points["R"] = {
            "operations": control.reaction.kernel.program.operations(),
            "solver_operations": solver_operations(control.reaction.solver),
            "skipped": [],
        }
    assert module.solver is not None
    points["control"] = {
        "operations": control.kernel.program.operations(),
        "solver_operations": known_operations(module.solver, control.y is not None) if control.known else solver_counts,
        "skipped": list(module.skipped["control"]),
    }
    if control.projection is not None:
        points["project"] = {
            "operations": control.projection.program.operations(),
            "solver_operations": solver_counts,
            "skipped": ["iteration: phi is affine in tau"] if not control.curvature else [],
        }
        points["step"] = {
            "operations": _sum(control.kernel.program.operations(), control.projection.program.operations()),
            "solver_operations": solver_counts,
            "skipped": [],
        }
    return points


def _sum(a: dict[str, int], b: dict[str, int]) -> dict[str, int]:
    return {key: a.get(key, 0) + b.get(key, 0) for key in {**a, **b}}
