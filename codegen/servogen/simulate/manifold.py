"""A run on the passive constraints: its start is brought onto them, and what it drifts from them is measured."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from servogen.errors import SceneError
from servogen.results import FloatArray
from servogen.scene.closing import Closer
from servogen.scene.scene import Scene, State


def closed_start(
    scene: Scene, inputs: Mapping[str, FloatArray], plant: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """q and u of a start, on that plant's passive constraints. SceneError, with the residual, if none is near."""
    if not scene.mechanism.passive:
        return {"q": inputs["q"], "u": inputs["u"]}
    state = {n: np.asarray(v).reshape(1, -1) for n, v in {**inputs, **plant}.items()}
    found, (good,) = closed_starts(scene, state)
    if not good:
        names = ", ".join(repr(c.name) for c in scene.mechanism.passive)
        raise SceneError(
            f"start: passive constraints ({names}) are off by {Closer(scene).residual(state)[0]:.3g}, and "
            "Newton's method finds no q and u near by that satisfy them; start from a state that does"
        )
    return {n: v[0] for n, v in found.items()}


def closed_starts(scene: Scene, states: State) -> tuple[dict[str, FloatArray], NDArray[np.bool_]]:
    """q and u of N starts, each name -> (N, size) with its plant's parameters, brought onto the passive constraints,
    and where that succeeded (N,)."""
    found, good = Closer(scene).close(states)
    return {n: found[n] for n in ("q", "u")}, good


def drift_of(scene: Scene, columns: Mapping[str, FloatArray]) -> FloatArray:
    """Per row (N,) the largest entry of chi and of chi'; empty where there are no passive constraints."""
    if not scene.mechanism.passive:
        return np.zeros(0)
    return Closer(scene).residual(dict(columns))
