"""What the code of each entry point does without, and why: the lines "skipped" of the manifest and of the report.

Work can be saved at four times, and the lines come in this order: when the scene was derived (the model has no D, say),
when the program was optimised, when the module was planned (what parameters decide moves to prepare), and at each tick
(a certificate proves that the SVD is not needed).
"""

from collections.abc import Mapping, Sequence

from servogen.derive.formulation import Formulation
from servogen.ir.program import Program
from servogen.law.law import Law
from servogen.law.steps import SYSTEM
from servogen.plan.module import KnownMatrix, StructField
from servogen.plan.solver import SolverPlan
from servogen.plan.stage import Staged, cut
from servogen.scene_program import SceneProgram


def what_is_skipped(
    formulation: Formulation,
    optimised: SceneProgram,
    law: Law,
    known: KnownMatrix | None,
    solvers: Mapping[str, SolverPlan],
    inputs: Sequence[StructField],
    staged: Staged,
) -> dict[str, tuple[str, ...]]:
    """Lines "what: why" by entry point: those that hand out the system's matrix or right side, and control.

    inputs: the fields of the input struct, which are the inputs that some output depends on.
    """
    system = formulation.scene.system
    of_the_system = {system.matrix, system.right}
    parts_of = {"_".join(names): names for names in law.entries if set(names) <= of_the_system}
    if law.has("control"):
        parts_of["control"] = law.routine("control").evaluated()
    planned = _planned(formulation, inputs, staged)
    found = {
        name: (*_derived(formulation, optimised, parts), *_optimised(optimised, parts), *planned)
        for name, parts in parts_of.items()
    }
    if law.has("control"):
        found["control"] += (*_of_the_solver(formulation, known, solvers[SYSTEM]),)
    return found


def _derived(formulation: Formulation, optimised: SceneProgram, parts: Sequence[str]) -> list[str]:
    """What derivation left out: terms that the model does not have, and the inverse of Q."""
    mechanism = formulation.scene.mechanism
    lines = list(_about_mass(formulation, optimised, parts))
    if mechanism.C is None:
        lines.append("C: q' = u")
    if mechanism.D is None:
        lines.append("D: absent")
    if mechanism.t is None:
        lines.append("t: the model does not depend on time")
    return lines


def _about_mass(formulation: Formulation, optimised: SceneProgram, parts: Sequence[str]) -> tuple[str, ...]:
    """How an entry point that hands out `parts` does without the inverse of Q.

    Where optimisation has cancelled the solve with Q from these parts, Q is neither factorised nor tested; else the
    reason says which factorisation stands in for the inverse.
    """
    needing = {q.name for q in formulation.quantities if q.needs_mass} & set(parts)
    if not formulation.mass.pivots or not needing or not needing <= optimised.free_of_mass:
        return (f"inverse of Q: {formulation.mass.reason}",)
    return (
        "factorisation of Q: the solve cancels, its answer is an expression without Q's pivots",
        "test at each tick that Q is regular: nothing divides by its pivots, Q is positive definite at states of the "
        "domain and parameters from half to twice their defaults",
    )


def _optimised(optimised: SceneProgram, parts: tuple[str, ...]) -> list[str]:
    """What optimisation left out: how many operations, and its remarks (rewrites refused for their rounding, say)."""
    before, left = (_operations(program, parts) for program in (optimised.exact, optimised.program))
    lines = [f"{before - left} of {before} operations: fewer give the same values"] if left < before else []
    return [*lines, *optimised.remarks]


def _operations(program: Program, parts: tuple[str, ...]) -> int:
    return cut(program, program.name, parts).operations()["total"]


def _planned(formulation: Formulation, inputs: Sequence[StructField], staged: Staged) -> list[str]:
    """What planning left out of the tick: inputs on which no output depends, and operations that prepare does once."""
    left = {i.name for i in inputs}
    lines = [f"{f.name}: no output depends on it" for f in formulation.scene.input_fields() if f.name not in left]
    early = staged.prepare.operations()["total"]
    return [*lines, f"{early} operations of parameters alone: done once, in prepare"] if early else lines


def _of_the_solver(formulation: Formulation, known: KnownMatrix | None, solver: SolverPlan) -> list[str]:
    """What the solver does without, always or (the SVD) at each tick at which a certificate allows it."""
    matrix = formulation.scene.system.matrix
    lines = []
    if formulation.scene.cascaded:
        lines.append("projectors onto null spaces: rows lose their parts along directions, each of which is found once")
        if solver.method == "auto":
            lines.append("SVD, at each tick and level: not where a certificate proves the rank that the QR finds")
    elif known is not None:
        where = "at generation" if known.when == "generation" else "in prepare"
        lines.append(f"factorisation of {matrix}: no state changes it, its pseudo-inverse is computed {where}")
    elif solver.form != "full":
        lines.append(f"SVD: {matrix} is a {solver.form}, the closed form is exact")
    elif solver.method == "cod":
        lines.append("SVD: the rank is decided by the pivots of a QR")
    elif solver.method == "auto":
        lines.append("SVD, at each tick: not where a certificate proves that normal equations or QR give its answer")
    if formulation.weight is not None:
        lines.append(f"inverse of W: {formulation.weight.reason}")
    if formulation.scene.y is None:
        lines.append("null-space projector: y is absent")
    return lines
