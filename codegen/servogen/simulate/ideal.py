"""What the constraints ought to do: the decay that Theta prescribes, Eqs. (4), (12)."""

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import expm

from servogen.derive.rates import rate
from servogen.results import FloatArray
from servogen.scene.constraints import Constraint, Holonomic, companion, expression_of
from servogen.scene.scene import Scene
from servogen.simulate.simulation import known_symbols


def ideal_decay(
    scene: Scene,
    start: dict[str, FloatArray],
    step: float,
    count: int,
    parameters: Mapping[str, FloatArray] | None = None,
) -> FloatArray:
    """psi (phi) at 0, step, 2 step, ... that starts as the scene does and obeys Theta: (count, m).

    start: every parameter and input at t = 0, by name. parameters: the controller's, of which Theta is made, where the
    plant has others. psi' = Theta psi; holonomic: psi'' = Theta1 psi' + Theta2 psi.
    """
    return np.hstack([_one(scene, c, start, start | dict(parameters or {}), step, count) for c in scene.constraints])


def _one(
    scene: Scene,
    constraint: Constraint,
    start: dict[str, FloatArray],
    controller: dict[str, FloatArray],
    step: float,
    count: int,
) -> FloatArray:
    state = expression_of(constraint)
    if isinstance(constraint, Holonomic):
        matrix = companion(constraint.Theta1, constraint.Theta2)
        state = ca.vertcat(state, rate(scene, state, f"constraint {constraint.name!r}: psi'"))
    else:
        matrix = constraint.Theta
    now = value_at(scene, state, start).ravel()
    forward = expm(value_at(scene, matrix, controller) * step)
    states = np.empty((count, len(now)))
    for k in range(count):
        states[k] = now
        now = forward @ now
    return states[:, : constraint.size]


def value_at(scene: Scene, expression: Any, values: Mapping[str, FloatArray]) -> FloatArray:
    """The expression at these parameters, inputs and tau, all of them given by name."""
    symbols = known_symbols(scene)
    function = ca.Function("value", [s for _, s in symbols], [ca.densify(expression)])
    return np.array(function(*(ca.DM(values[n].astype(float)) for n, _ in symbols)), dtype=float)
