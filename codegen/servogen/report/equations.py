"""A scene in formulas: as the user wrote it, as the textbook derives it, and as the generated code computes it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca

from servogen.derive.formulation import Formulation
from servogen.derive.passive import HELD
from servogen.ir.lower import lower_expressions
from servogen.ir.program import Input, Program
from servogen.law.law import shapes
from servogen.law.steps import React
from servogen.optimise.merge import merge
from servogen.plan.module import Kernel, Module
from servogen.report.formulas import Formulas, formulas
from servogen.report.mathml import formula, math, mo, symbol, tag
from servogen.scene.constraints import expression_of, theta_parts
from servogen.scene.scene import Scene


@dataclass(frozen=True)
class Equations:
    """Each part a caption and its formulas; derived: a line, its shape and its source."""

    written: tuple[tuple[str, Formulas], ...]
    derived: tuple[tuple[str, str, str], ...]
    computed: tuple[tuple[str, Formulas], ...]


def equations(scene: Scene, formulation: Formulation, module: Module) -> Equations:
    """All formulas of one scene."""
    return Equations(_written(scene), _derived(formulation), _computed(scene, module))


def _written(scene: Scene) -> tuple[tuple[str, Formulas], ...]:
    mech = scene.mechanism
    motion = "q' = " + ("C u" if mech.C is not None else "u") + (" + D" if mech.D is not None else "")
    names = [n for n in ("C", "D", "Q", "P", "G") if getattr(mech, n) is not None]
    first = math(
        formula(motion),
        mo(","),
        tag("mspace", width="2em"),
        formula("Q u' = P + G tau" + (HELD if mech.passive else "")),
    )
    symbols = _in_order(scene)
    model = _formulas([(n, getattr(mech, n)) for n in names], symbols)
    parts = [("The mechanism", Formulas(model.operations, model.definitions, (first, *model.lines)))]
    for held in mech.passive:
        shown = _formulas([("chi", held.chi)], symbols)
        parts.append((f"{held.name}, passive", replace(shown, lines=(math(formula("chi = 0")), *shown.lines))))
    for c in scene.constraints:
        shown = _formulas([(c.symbol, expression_of(c)), *theta_parts(c).items()], symbols)
        lines = (math(formula(c.wish)), *shown.lines)
        parts.append((f"{c.name}, {c.word}", Formulas(shown.operations, shown.definitions, lines)))
    if isinstance(scene.y, ca.SX):
        parts.append(("The free vector", _formulas([("y", scene.y)], symbols)))
    if scene.weighs_by_inverse_mass:
        parts.append(("The weight", Formulas(0, (), (math(formula("W = Q^-1")),))))
    elif scene.weight is not None:
        parts.append(("The weight", _formulas([("W", scene.weight)], symbols)))
    return tuple(parts)


def _derived(formulation: Formulation) -> tuple[tuple[str, str, str], ...]:
    """The quantities, and what the steps of the law leave behind them, the answer at last."""
    scene, system = formulation.scene, formulation.scene.system
    control = formulation.law.routine("control")
    sizes = shapes(formulation.law)
    answers = []
    for step in control.steps:
        if isinstance(step, React):
            answers.append(("R = J^T (J Q^-1 J^T)^+ (b - J Q^-1 P)", step.into, "17"))
    metric = "" if scene.weight is None else f", {system.matrix}^+ in the metric of W"
    metric += ", level by level" if scene.cascaded else ""
    inner = f"({system.right} - {system.matrix} y)" if scene.y is not None else system.right
    free = "y + " if scene.y is not None else ""
    answers.append((f"{system.symbol} = {free}{system.matrix}^+ {inner}{metric}", control.result, system.equation))
    return (
        *_quantities(formulation),
        *(
            (math(formula(text), display=False), "{}×{}".format(*sizes[name]), f"Eq. ({number})")
            for text, name, number in answers
        ),
    )


def _quantities(formulation: Formulation) -> tuple[tuple[str, str, str], ...]:
    return tuple(
        (
            math(symbol(q.name), mo("="), formula(q.formula), display=False),
            f"{q.expression.size1()}×{q.expression.size2()}",
            q.equation,
        )
        for q in formulation.quantities
    )


def _computed(scene: Scene, module: Module) -> tuple[tuple[str, Formulas], ...]:
    """The kernels of the tick, and before them what prepare leaves in the model."""
    names = _names(scene)
    parts = []
    prepared = module.prepare.program
    own = {f.name for f in module.parameters}
    kept = tuple(o for o in prepared.outputs if o.name not in own and not o.name.startswith("mass_"))
    if kept:
        kept = tuple(replace(o, name=names(o.name, 0)) for o in kept)
        shown = formulas(Program(prepared.name, prepared.inputs, prepared.instrs, kept), names)
        parts.append(("Once, in prepare", shown))
    program = _at_tick(module).program
    kept = tuple(o for o in program.outputs if not o.name.startswith("mass_"))
    parts.append(("At each tick", formulas(Program(program.name, program.inputs, program.instrs, kept), names)))
    return tuple(parts)


def _at_tick(module: Module) -> Kernel:
    """The kernel to show: matrix and right side at once where an entry point hands them out, else that of control."""
    assert module.system is not None
    both = f"{module.system.matrix}_{module.system.right}"
    control = module.control
    assert control is not None
    return next((e.kernel for e in module.entry_points if e.name == both), control)


def _names(scene: Scene) -> Any:
    """(input, index) -> the name of the user's symbol; what prepare computes takes a letter that no symbol has."""
    fields = [*scene.input_fields(), *(scene.parameters or ())]
    users = {f.name: [s.name() for s in f.symbol.nonzeros()] for f in fields}
    users.setdefault("tau", [s.name() for s in scene.mechanism.tau.nonzeros()])
    letters = {name[:1] for names in users.values() for name in names}
    letter = next((x for x in "ckhgfbaed" if x not in letters), "computed_")

    def name(field: str, index: int) -> str:
        return users[field][index] if field in users else letter + field[1:]

    return name


def _in_order(scene: Scene) -> list[Any]:
    """The scene's symbols as one writes them in a product: parameters, references, coordinates, rates, controls."""
    mech = scene.mechanism
    own = [f.symbol for f in (*(scene.parameters or ()), *(scene.references or ()))]
    return [s for x in (*own, mech.q, mech.u, mech.tau) for s in x.nonzeros()]


def _formulas(named: Sequence[tuple[str, Any]], symbols: Sequence[Any]) -> Formulas:
    """SX matrices as the user wrote them, repeated terms once; symbols: in the order of a product's factors."""
    used = {s.__hash__(): s for s in ca.symvar(ca.vertcat(*(ca.vec(ca.densify(e)) for _, e in named)))}
    ordered = [s for s in symbols if used.pop(s.__hash__(), None) is not None] + list(used.values())
    inputs = [(Input(f"s{k}", 1), s) for k, s in enumerate(ordered)]
    program = merge(lower_expressions("written", inputs, list(named)))
    return formulas(program, lambda field, _: ordered[int(field[1:])].name())
