"""The law that every kind of scene ends with: the system solved for the controls, in the metric of a weight."""

from collections.abc import Sequence

from servogen.derive.formulation import Quantity, Weight
from servogen.law.law import Law, Routine
from servogen.law.steps import STATE, SYSTEM, Cascade, Evaluate, Invert, Multiply, React, Solve, Step
from servogen.scene.scene import Scene


def controlling(
    scene: Scene,
    quantities: Sequence[Quantity],
    weight: Weight | None,
    entries: tuple[tuple[str, ...], ...],
    before: tuple[React, ...] = (),
    routines: tuple[Routine, ...] = (),
) -> Law:
    """pinv and control for the scene's system, Eqs. (10), (16) and (54).

    before: steps that leave the system's right side. routines: others, which stand before control.
    """
    system, shape = scene.system, scene.system_shape
    matrix = system.matrix if weight is None else f"{system.matrix}_w"
    free = _free(scene, weight)
    made = {step.into for step in before}
    read = [matrix, *(n for s in before for n in (s.matrix, s.right, s.jacobian))]
    read += [name for name in (system.right, free) if name and name not in made and not name.startswith(STATE)]
    found = system.answer if weight is None else "sigma"
    switches = tuple((STATE + name, rows) for name, rows in scene.switches)
    steps: tuple[Step, ...]
    if scene.cascaded:
        steps = (Cascade(found, SYSTEM, matrix, system.right, scene.levels, free, switches),)
    else:
        steps = (Solve(found, SYSTEM, matrix, system.right, free),)
    if weight is not None:
        read.append("recover")
        steps = (*steps, Multiply(system.answer, "recover", found, weight.pattern))
    inverse = f"{system.matrix}_pinv"
    return Law(
        scene.name,
        inputs=(
            *([("y", (scene.controls, 1))] if free == f"{STATE}y" else []),
            *((name, (1, 1)) for name, _ in scene.switches),
        ),
        quantities=tuple((q.name, q.expression.shape) for q in quantities),
        solvers=((SYSTEM, shape),),
        entries=entries,
        routines=(
            Routine("pinv", (Invert(inverse, SYSTEM, system.matrix),), inverse, arguments=((system.matrix, shape),)),
            *routines,
            Routine("control", (Evaluate(tuple(read)), *before, *steps), system.answer),
        ),
    )


def _free(scene: Scene, weight: Weight | None) -> str:
    """What the solver is given for y: nothing, the input as it is, or a quantity."""
    if scene.y is None:
        return ""
    if weight is not None:
        return "y_w"
    return f"{STATE}y" if isinstance(scene.y, str) else "y"
