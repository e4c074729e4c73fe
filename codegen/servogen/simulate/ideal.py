"""What the constraints ought to do: the decay that Theta prescribes, Eqs. (4), (12)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import expm

from servogen.derive.rates import rate
from servogen.results import FloatArray
from servogen.scene.constraints import expression_of
from servogen.scene.scene import Scene
from servogen.simulate.simulation import known_symbols


@dataclass(frozen=True, eq=False)
class Prescribed:
    """One constraint's decay: state' = matrix state, all SX; the state is psi (phi) and, of one of order 2, psi'."""

    psi: Any
    psi_dot: Any | None
    matrix: Any


def prescribed(scene: Scene) -> tuple[Prescribed, ...]:
    """What is asked of each constraint."""
    found = []
    for c in scene.constraints:
        psi = expression_of(c)
        psi_dot = rate(scene, psi, f"constraint {c.name!r}: {c.symbol}'") if c.order == 2 else None
        found.append(Prescribed(psi, psi_dot, c.decay))
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
        if part.psi_dot is not None:
            now = np.concatenate([now, value_at(scene, part.psi_dot, start).ravel()])
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
