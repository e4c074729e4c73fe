"""What the constraints ought to do: the decay that Theta prescribes, Eqs. (4), (12)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import expm

from servogen.compiler import motion_of
from servogen.results import FloatArray
from servogen.scene.constraints import decay_of, expression_of
from servogen.scene.scene import Scene
from servogen.simulate.simulation import known_symbols


@dataclass(frozen=True, eq=False)
class Prescribed:
    """One constraint's decay: state' = matrix state, all SX; the state is psi (phi) and its rates, below its order."""

    psi: Any
    rates: Any
    matrix: Any


def prescribed(scene: Scene) -> tuple[Prescribed, ...]:
    """What is asked of each constraint."""
    found = []
    for c in scene.constraints:
        values, drift = [expression_of(c)], motion_of(scene, c)
        for _ in range(c.order - 1):
            values.append(drift.rate(values[-1], f"constraint {c.name!r}: {c.symbol}'"))
        psi, *rates = drift.filled(*values)
        found.append(Prescribed(psi, ca.vertcat(ca.SX(0, 1), *rates), decay_of(c)))
    return tuple(found)


def ideal_decay(
    scene: Scene,
    start: Mapping[str, FloatArray],
    step: float,
    count: int,
    parameters: Mapping[str, FloatArray] | None = None,
    psi: FloatArray | None = None,
) -> FloatArray:
    """psi (phi) at 0, step, 2 step, ... that starts as the scene does and obeys Theta: (count, m).

    start: every parameter and input at t = 0, by name. parameters: the controller's, of which Theta is made, where the
    plant has others. psi (m,): as it is at the start, where that is known already.
    """
    columns, row = [], 0
    for part in prescribed(scene):
        size = part.psi.size1()
        now = value_at(scene, part.psi, start).ravel() if psi is None else psi[row : row + size].astype(float)
        row += size
        now = np.concatenate([now, value_at(scene, part.rates, start).ravel()])
        forward = expm(value_at(scene, part.matrix, dict(start) | dict(parameters or {})) * step)
        states = np.empty((count, len(now)))
        for k in range(count):
            states[k] = now
            now = np.add.accumulate(forward * now, axis=1)[:, -1]  # in the order of firmware_sim/simulate/summary.c
        columns.append(states[:, :size])
    return np.hstack(columns)


def value_at(scene: Scene, expression: Any, values: Mapping[str, FloatArray]) -> FloatArray:
    """The expression at these parameters, inputs and tau, all of them given by name."""
    symbols = known_symbols(scene)
    function = ca.Function("value", [s for _, s in symbols], [ca.densify(expression)])
    return np.array(function(*(ca.DM(values[n].astype(float)) for n, _ in symbols)), dtype=float)
