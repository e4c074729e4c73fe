"""The limits of the controls as quantities of the scene's program and a step of its law."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import casadi as ca

from servogen.derive.formulation import Quantity, Weight
from servogen.law.law import Law
from servogen.law.steps import STATE, SYSTEM, Evaluate, Limit
from servogen.scene.limits import INPUTS, Side
from servogen.scene.scene import Scene


def limit_quantities(scene: Scene, prescribed: Any, weight: Weight | None) -> tuple[Quantity, ...]:
    """What the limits need beside the system: themselves, z_1, and with a weight its L^T and the y that L^T y hides.

    prescribed: the Theta terms of z, m x 1. Nothing for a scene without limits.
    """
    if scene.sides is None:
        return ()
    found = [
        Quantity(name, side.expression, "limits", f"the {name} limits of tau")
        for name, side in scene.sides.each()
        if isinstance(side, Side)
    ]
    if scene.sides.policy == "keep_direction":
        found.append(Quantity("z_1", prescribed, "limits", "the Theta terms of z"))
    if weight is not None:
        words = "L^T, L L^T = W = Q^-1" if weight.of_mass else "L^T, L L^T = W"
        metric = ca.densify(weight.to_sigma(ca.SX.eye(scene.controls)))
        found.append(Quantity("metric", metric, "limits", words, weight.of_mass))
        if isinstance(scene.y, ca.SX):
            found.append(Quantity("y", scene.y, "Eq. (10)", "the free vector"))
    return tuple(found)


def within_limits(scene: Scene, law: Law, extra: Sequence[Quantity]) -> Law:
    """The law with the answer of control as the start of a Limit. extra: what limit_quantities gave."""
    sides = scene.sides
    if sides is None:
        return law
    routine = law.routine("control")
    first, *behind = routine.steps
    assert isinstance(first, Evaluate)
    last: Any = behind[-1]
    free = "" if scene.y is None else f"{STATE}y" if isinstance(scene.y, str) else "y"
    lower, upper = (STATE + INPUTS[name] if isinstance(side, str) else name for name, side in sides.each())
    no_lower, no_upper = (() if isinstance(side, str) else side.open for _, side in sides.each())
    limit = Limit(
        last.into,
        SYSTEM,
        start="start",
        matrix=scene.system.matrix,
        right=scene.system.right,
        lower=lower,
        upper=upper,
        free=free,
        slowed="z_1" if any(q.name == "z_1" for q in extra) else "",
        metric="metric" if any(q.name == "metric" for q in extra) else "",
        no_lower=no_lower,
        no_upper=no_upper,
    )
    needed = (limit.matrix, *(q.name for q in extra))
    evaluate = Evaluate((*first.into, *(name for name in needed if name not in first.into)))
    steps = (evaluate, *behind[:-1], replace(last, into="start"), limit)
    read = [name.removeprefix(STATE) for name in (free, lower, upper) if name.startswith(STATE)]
    known = {name for name, _ in law.inputs}
    inputs = tuple((name, (scene.controls, 1)) for name in read if name not in known)
    routines = tuple(replace(r, steps=steps) if r is routine else r for r in law.routines)
    return replace(law, inputs=(*law.inputs, *inputs), routines=routines)
