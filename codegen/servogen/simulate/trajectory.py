"""What a run leaves behind."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from servogen.results import FloatArray, Status
from servogen.scene.system import SYSTEMS, Kind
from servogen.simulate.claim import Claim
from servogen.simulate.verdict import Verdict, judge

Reason = Literal["finished", "event", "controller", "plant", "stop expression", "reference"]


@dataclass(frozen=True)
class Stop:
    """Why and when a run ended.

    reason: "finished" (whole duration), "event" (a stop expression, named by `event`), or whose negative status ended
    it: "controller", "plant", "stop expression", "reference". t: of the last row, seconds.
    """

    reason: Reason
    t: float
    event: str = ""
    status: Status = Status.OK

    def __str__(self) -> str:
        if self.reason == "finished":
            return f"finished at t = {self.t:.6g} s"
        if self.reason == "event":
            return f"stopped by {self.event!r} at t = {self.t:.6g} s"
        return f"{self.reason}: {self.status.name} after t = {self.t:.6g} s"


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Rows of a run at t (N,), the start first and the instant of the stop last.

    q (N, n_q), u (N, n_u), tau (N, l) as applied at t, constraint (N, m): psi, or phi of a controls-involved scene;
    ideal (N, m): the same as prescribed by Theta from the start on.
    status (N,), rank (N,), sigma_min (N,): of the controller at t; of one that samples, the worst status since the row
    before, the others at the last tick. limited (N,): bit k is set where an actuator held control k back since then.
    outputs: name -> (N,); decay: name -> (N,), what the output ought to be. parameters (the controller's), plant (the
    plant's) and inputs (y and references at t = 0): as used.
    drift (N,): the largest entry of chi and chi' of the passive constraints at each row; empty where there are none.
    step: between rows; hold: between ticks, None where the controller acts at every instant; seconds.
    claim: what the run is held to, see verdict.
    method: of the integration; seconds: that it took on this machine.
    """

    scene: str
    kind: Kind
    step: float
    hold: float | None
    method: str
    t: FloatArray
    q: FloatArray
    u: FloatArray
    tau: FloatArray
    constraint: FloatArray
    ideal: FloatArray
    status: NDArray[np.int32]
    rank: NDArray[np.int32]
    limited: NDArray[np.int32]
    sigma_min: FloatArray
    stop: Stop
    claim: Claim
    outputs: dict[str, FloatArray] = field(default_factory=dict)
    decay: dict[str, FloatArray] = field(default_factory=dict)
    parameters: dict[str, FloatArray] = field(default_factory=dict)
    plant: dict[str, FloatArray] = field(default_factory=dict)
    inputs: dict[str, FloatArray] = field(default_factory=dict)
    drift: FloatArray = field(default_factory=lambda: np.zeros(0))
    seconds: float = 0.0

    @cached_property
    def verdict(self) -> Verdict:
        """Whether the constraints were held, and if not, what happened, when and why."""
        return judge(self)

    @property
    def constraint_name(self) -> Literal["psi", "phi"]:
        return SYSTEMS[self.kind].constraint

    @property
    def constraint_error(self) -> tuple[float, float]:
        """The largest deviation of a constraint from its prescribed decay, and when; of a run that has rows."""
        errors = np.max(np.abs(self.constraint - self.ideal), axis=1)
        row = int(np.argmax(errors))
        return float(errors[row]), float(self.t[row])

    @property
    def shares(self) -> FloatArray:
        """(N,), the largest deviation from the prescribed decay at each row, as a share of its tolerance."""
        deviation = np.abs(self.constraint - self.ideal).astype(float)
        return np.asarray(np.max(deviation / self.claim.tolerance, axis=1)) if len(self.t) else np.zeros(0)

    @property
    def decay_error(self) -> dict[str, float]:
        """By output, the largest relative deviation from what it ought to be."""
        tiny = np.finfo(float).tiny
        return {
            n: float(np.max(np.abs(self.outputs[n] - ideal) / np.maximum(np.abs(ideal), tiny)))
            for n, ideal in self.decay.items()
            if len(ideal)
        }

    @property
    def psi(self) -> FloatArray:
        """psi (N, m) of a scene whose constraints it is."""
        return self._named("psi")

    @property
    def phi(self) -> FloatArray:
        """phi (N, m) of a controls-involved scene."""
        return self._named("phi")

    def _named(self, name: str) -> FloatArray:
        if name != self.constraint_name:
            other = self.constraint_name
            raise AttributeError(f"scene {self.scene!r} has no {name}: it is a {self.kind} scene; see {other}")
        return self.constraint


def with_unit(value: float, unit: str | None, digits: int = 3) -> str:
    """A number with the digits that count, and its unit; units of several entries ("N, N m") do not tell whose."""
    return f"{value:.{digits}g} {unit}" if unit and "," not in unit else f"{value:.{digits}g}"


def rows_that_differ(a: Trajectory, b: Trajectory) -> int:
    """Rows in which two runs differ in any bit; those that only one of them has count too."""
    fields = ("t", "q", "u", "tau", "constraint", "sigma_min", "status", "rank", "limited")
    common = min(len(a.t), len(b.t))
    unlike = np.zeros(common, bool)
    for name in fields:
        x, y = (np.ascontiguousarray(getattr(run, name)[:common].reshape(common, -1)) for run in (a, b))
        unlike |= np.any(x.view(np.uint8) != y.view(np.uint8), axis=1) if common else unlike
    return int(unlike.sum()) + abs(len(a.t) - len(b.t))
