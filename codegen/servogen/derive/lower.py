"""A scene's model and its quantities as programs over its inputs and parameters."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import casadi as ca

from servogen.derive.formulation import Formulation, MassTreatment, Quantity
from servogen.ir.lower import lower_expressions
from servogen.ir.program import Input, Program
from servogen.scene.scene import Scene

MASS_PIVOT, MASS_SCALE = "mass_pivot", "mass_scale"


def lower(formulation: Formulation) -> Program:
    """All quantities of a formulation, and the pivots of Q with their scales."""
    return lower_quantities(formulation.scene, formulation.quantities, formulation.mass)


def lower_quantities(scene: Scene, quantities: Sequence[Quantity], mass: MassTreatment | None = None) -> Program:
    """Named quantities as one program."""
    outputs = [(q.name, q.expression) for q in quantities]
    if mass is not None and mass.pivots:
        outputs += [(MASS_PIVOT, ca.vertcat(*mass.pivots)), (MASS_SCALE, ca.vertcat(*mass.scales))]
    return lower_expressions(scene.name, scene_inputs(scene), outputs)


@lru_cache(maxsize=128)
def lower_model(scene: Scene) -> Program:
    """Q, P and G as the scene writes them, before anything is solved, and W where it gives one of its own."""
    mech = scene.mechanism
    outputs = [("Q", mech.Q), ("P", mech.P), ("G", mech.G)]
    if scene.weight is not None and not scene.weighs_by_inverse_mass:
        outputs.append(("W", scene.weight))
    return lower_expressions("model", scene_inputs(scene), outputs)


def scene_inputs(scene: Scene) -> list[tuple[Input, Any]]:
    """Every parameter and input the scene may have, tau included, with its symbol."""
    inputs = [(Input(f.name, f.size, "parameter"), f.symbol) for f in scene.parameters]
    inputs += [(Input(f.name, f.size), f.symbol) for f in scene.input_fields()]
    if not scene.tau_is_input:  # the plant takes tau, and so may a servo scene's program
        inputs.append((Input("tau", scene.controls), scene.mechanism.tau))
    return inputs


def parameter_defaults(scene: Scene) -> dict[str, list[float]]:
    """name -> default values, as inputs of the program."""
    return {f.name: list(f.default) for f in scene.parameters}
