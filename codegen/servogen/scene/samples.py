"""The states at which a scene is looked at before anything is generated: drawn once, and handed from stage to stage."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from servogen.results import FloatArray
from servogen.scene.domain import domain_box, draw_states
from servogen.scene.scene import Scene, State

EXAMINED = 32
"""States at which Q, the weight and the rows of the constraints are examined."""

AT_DEFAULTS = EXAMINED // 4
"""So many of these, the first, have the parameters at their defaults."""

JUDGED = 24
"""States at which the accuracy of the optimiser's rewrites is judged."""

SEARCHED = 256
"""States between which zeros of rows are searched; the box of a domain that is given as a function is theirs."""


@dataclass(frozen=True, eq=False)
class Samples:
    """States of a scene's domain, name -> array (N, size) for every input that the scene may have.

    examined, with as many values of the parameters: the first AT_DEFAULTS are the defaults, the others lie between half
    and twice of them, for parameters change at run time. judged: with tau, and the parameters' defaults. searched.
    """

    scene: Scene
    examined: State
    parameters: State
    judged: State
    searched: State

    @property
    def box(self) -> dict[str, tuple[FloatArray, FloatArray]]:
        """name -> (lowest, highest) entries of each input in the domain."""
        return domain_box(self.scene, self.searched)

    def values(self, expression: Any) -> FloatArray:
        """An SX of inputs and parameters at the states examined: array (EXAMINED, rows, columns)."""
        fields = self.scene.input_fields()
        symbols = [f.symbol for f in fields] + [f.symbol for f in self.scene.parameters]
        columns = [ca.DM(self.examined[f.name].T) for f in fields]
        columns += [ca.DM(self.parameters[f.name].T) for f in self.scene.parameters]
        function = ca.Function("sample", symbols, [ca.densify(expression)])
        values = np.array(function.map(EXAMINED)(*columns))
        rows, cols = expression.shape
        return values.reshape(rows, EXAMINED, cols).transpose(1, 0, 2)


@lru_cache(maxsize=128)
def draw_samples(scene: Scene) -> Samples:
    """The states of one scene, the same at each call. SceneError for a domain that gives none."""
    return Samples(
        scene,
        examined=draw_states(scene, EXAMINED),
        parameters={f.name: _around_default(f.default, k) for k, f in enumerate(scene.parameters)},
        judged=_judged(scene),
        searched=draw_states(scene, SEARCHED, seed=4),
    )


def _around_default(default: tuple[float, ...], seed: int) -> FloatArray:
    """Values of one parameter, array (EXAMINED, size)."""
    factors = 2.0 ** np.random.default_rng([7, seed]).uniform(-1, 1, (EXAMINED, len(default)))
    factors[:AT_DEFAULTS] = 1.0
    return np.asarray(np.array(default) * factors)


def _judged(scene: Scene) -> State:
    states = draw_states(scene, JUDGED, seed=2) | {f.name: np.array([f.default]) for f in scene.parameters}
    generator = np.random.default_rng(3)
    states.setdefault("tau", 2 * generator.random((JUDGED, scene.controls)) - 1)
    return states
