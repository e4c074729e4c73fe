"""States brought onto the passive constraints: q by Newton's method, then u by its nearest admissible neighbour."""

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from servogen.results import FloatArray
from servogen.scene.passive import PassiveHolonomic
from servogen.scene.scene import Scene, State

_STEPS = 50
_LONGEST = 0.5
"""The largest change of q in one step: a longer one is shortened, so that the nearest branch is found."""
CLOSED = 1e-10
"""A chi that is not larger, relative to the terms it is made of, is rounding."""


class Closer:
    """Brings states of a scene onto its passive constraints; parameters are at their defaults unless given."""

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
        meant = ca.vertcat(ca.SX(0, 1), *(c.meant for c in mech.passive if isinstance(c, PassiveHolonomic)))
        self._meant = ca.Function("meant", [f.symbol for f in fields], [meant])
        self._function = ca.Function("closing", [f.symbol for f in fields], outputs)
        self._names = [f.name for f in fields]
        self._defaults = {f.name: np.array(f.default) for f in fields}

    def _is_meant(self, states: State) -> NDArray[np.bool_]:
        """Per state, whether this solution of chi = 0 is the one that is meant."""
        (found,) = self._stacks(self._meant, states)
        return np.asarray(np.all(found > 0, axis=(1, 2)))

    def _at(self, states: State) -> list[FloatArray]:
        """chi and its slope along u, what must vanish of the rates and its slope, C: each with N in front."""
        return self._stacks(self._function, states)

    def _stacks(self, function: Any, states: State) -> list[FloatArray]:
        """A function's results at N states, each with N in front."""
        count = len(states["q"])
        given = [
            np.broadcast_to(states.get(n, self._defaults[n]), (count, self._defaults[n].size)) for n in self._names
        ]
        stacks = [np.array(x) for x in function.map(count).call([ca.DM(np.array(v, dtype=float).T) for v in given])]
        return [x.reshape(len(x), count, x.shape[1] // count).transpose(1, 0, 2) for x in stacks]

    def residual(self, states: State) -> FloatArray:
        """Per state the largest entry of chi, and of its rate or that of rolling."""
        chi, _, slow, _, _ = self._at(states)
        return np.asarray(np.max(np.abs(np.concatenate([chi, slow], axis=1)), axis=(1, 2), initial=0.0))

    def close(self, states: State) -> tuple[State, NDArray[np.bool_]]:
        """The states with the nearest q and u that satisfy every passive constraint, and for which there are some.

        states: name -> (N, size); what is left out is at its default.
        """
        q, u = states["q"].astype(float), states["u"].astype(float)
        with np.errstate(all="ignore"):
            for _ in range(_STEPS):
                chi, along, _, _, C = self._at(states | {"q": q})
                step = -(C @ _inverse(along) @ chi)[:, :, 0]
                size = np.max(np.abs(step), axis=1, initial=0.0)
                q = q + step * np.minimum(1.0, _LONGEST / np.maximum(size, 1e-300))[:, None]
                if np.all(size <= 1e-14 * (1 + np.max(np.abs(q), axis=1))):
                    break
            _, _, slow, J, _ = self._at(states | {"q": q, "u": u})
            u = u - (_inverse(J) @ slow)[:, :, 0]
            chi, along, slow, J, _ = self._at(states | {"q": q, "u": u})
            good = (
                self._is_meant(states | {"q": q})
                & _small(chi, along)
                & _small(slow, J)
                & np.all(np.isfinite(q), axis=1)
                & np.all(np.isfinite(u), axis=1)
            )
        return states | {"q": q, "u": u}, good


def _inverse(matrices: FloatArray) -> FloatArray:
    """The pseudo-inverse of each; zero, which moves nothing, for those that are not finite."""
    good = np.all(np.isfinite(matrices), axis=(1, 2), keepdims=True)
    return np.asarray(np.linalg.pinv(np.where(good, matrices, 0.0), rcond=1e-10))


def _small(values: FloatArray, slopes: FloatArray) -> NDArray[np.bool_]:
    """Per state, whether the values are rounding beside their slopes."""
    size = np.maximum(1.0, np.max(np.abs(slopes), axis=(1, 2), initial=0.0))
    return np.asarray(np.max(np.abs(values), axis=(1, 2), initial=0.0) <= CLOSED * size)
