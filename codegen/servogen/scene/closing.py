"""States brought onto the passive constraints: q by Newton's method, then u by its nearest admissible neighbour."""

from typing import Any

import casadi as ca
import numpy as np

from servogen.results import FloatArray
from servogen.scene.passive import PassiveHolonomic
from servogen.scene.scene import Scene, State

_STEPS = 50
_LONGEST = 0.5
"""The largest change of q in one step: a longer one is shortened, so that the nearest branch is found."""
CLOSED = 1e-10
"""A chi that is not larger, relative to the terms it is made of, is rounding."""


class Closer:
    """Brings states of a scene onto its passive constraints, at the parameters' defaults."""

    def __init__(self, scene: Scene) -> None:
        mech = scene.mechanism
        fields = (*scene.input_fields(), *scene.parameters)
        holonomic = [c.chi for c in mech.passive if isinstance(c, PassiveHolonomic)]
        rolling = [c.chi for c in mech.passive if not isinstance(c, PassiveHolonomic)]
        chi = ca.vertcat(ca.SX(0, 1), *holonomic)
        moving, rate = mech.q, mech.q_dot
        if mech.t is not None:
            moving, rate = ca.vertcat(mech.q, mech.t), ca.vertcat(mech.q_dot, 1)
        slow = ca.vertcat(ca.jtimes(chi, moving, rate), *rolling)
        C = ca.SX.eye(mech.q.size1()) if mech.C is None else mech.C
        along = ca.mtimes(ca.jacobian(chi, mech.q), C)
        outputs = [ca.densify(x) for x in (chi, along, slow, ca.jacobian(slow, mech.u), C)]
        self._function = ca.Function("closing", [f.symbol for f in fields], outputs)
        self._names = [f.name for f in fields]
        self._defaults = {f.name: np.array(f.default) for f in fields}

    def _at(self, state: dict[str, FloatArray]) -> list[FloatArray]:
        given = self._defaults | state
        return [np.array(x) for x in self._function(*(ca.DM(given[n]) for n in self._names))]

    def residual(self, state: dict[str, FloatArray]) -> float:
        """The largest entry of chi, and of its rate or that of rolling."""
        chi, _, slow, _, _ = self._at(state)
        return float(np.max(np.abs([*chi.ravel(), *slow.ravel()]), initial=0.0))

    def close(self, state: dict[str, FloatArray]) -> dict[str, FloatArray] | None:
        """The state with the nearest q and u that satisfy every passive constraint; None where Newton finds none."""
        q, u = state["q"].astype(float), state["u"].astype(float)
        for _ in range(_STEPS):
            chi, along, _, _, C = self._at(state | {"q": q})
            if not np.all(np.isfinite(along)):
                return None
            change = -np.linalg.pinv(along, rcond=1e-10) @ chi.ravel() if chi.size else np.zeros(C.shape[1])
            step = C @ change
            size = np.max(np.abs(step), initial=0.0)
            q = q + step * min(1.0, _LONGEST / max(size, 1e-300))
            if size <= 1e-14 * (1 + np.max(np.abs(q))):
                break
        chi, along, _, _, _ = self._at(state | {"q": q})
        if np.max(np.abs(chi), initial=0.0) > CLOSED * max(1.0, np.max(np.abs(along), initial=0.0)):
            return None
        _, _, slow, J, _ = self._at(state | {"q": q, "u": u})
        u = u - np.linalg.pinv(J, rcond=1e-10) @ slow.ravel()
        _, _, slow, J, _ = self._at(state | {"q": q, "u": u})
        if np.max(np.abs(slow), initial=0.0) > CLOSED * max(1.0, np.max(np.abs(J), initial=0.0)):
            return None
        return state | {"q": q, "u": u}


def closed(scene: Scene, states: State) -> tuple[State, Any]:
    """States brought onto the passive constraints one by one, and which of them could be."""
    closer, count = Closer(scene), len(states["q"])
    found = {name: values.copy() for name, values in states.items()}
    good = np.zeros(count, bool)
    for k in range(count):
        state = closer.close({name: values[k] for name, values in states.items()})
        if state is not None:
            good[k] = True
            found["q"][k], found["u"][k] = state["q"], state["u"]
    return found, good
