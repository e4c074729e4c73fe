"""A run on the passive constraints: its start is brought onto them, and what it drifts from them is measured."""

from collections.abc import Mapping

import numpy as np

from servogen.errors import SceneError
from servogen.results import FloatArray
from servogen.scene.closing import Closer
from servogen.scene.scene import Scene


def closed_start(
    scene: Scene, inputs: Mapping[str, FloatArray], plant: Mapping[str, FloatArray]
) -> dict[str, FloatArray]:
    """q and u of a start, on that plant's passive constraints. SceneError, with the residual, if none is near."""
    if not scene.mechanism.passive:
        return {"q": inputs["q"], "u": inputs["u"]}
    closer, state = Closer(scene), {n: np.asarray(v).reshape(1, -1) for n, v in {**inputs, **plant}.items()}
    found, (good,) = closer.close(state)
    if not good:
        names = ", ".join(repr(c.name) for c in scene.mechanism.passive)
        raise SceneError(
            f"start: passive constraints ({names}) are off by {closer.residual(state)[0]:.3g}, and Newton's method "
            "finds no q and u near by that satisfy them; start from a state that does"
        )
    return {"q": found["q"][0], "u": found["u"][0]}


def drift_of(scene: Scene, columns: Mapping[str, FloatArray]) -> FloatArray:
    """Per row (N,) the largest entry of chi and of chi'; empty where there are no passive constraints."""
    if not scene.mechanism.passive:
        return np.zeros(0)
    return Closer(scene).residual(dict(columns))
