"""The drawing of a mechanism along a run: polylines that the scene's file, or its robot, gives as SX."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from servogen.results import FloatArray
from servogen.scene.scene import Scene
from servogen.simulate.simulation import Simulation, known_symbols, moving_references
from servogen.simulate.trajectory import Trajectory

FRAMES_A_SECOND = 25
LEAST_FRAMES, MOST_FRAMES = 120, 250


@dataclass(frozen=True, eq=False)
class Motion:
    """Polylines at the times t (F,), seconds: each (F, k, d), k points in the plane or in space."""

    t: FloatArray
    lines: tuple[FloatArray, ...]


def motion_of(scene: Scene, simulation: Simulation, run: Trajectory) -> Motion | None:
    """The simulation's drawing along a run, or what the mechanism knows of itself; None where there is neither.

    It ends before the first row whose points are not finite. Evaluated by CasADi's virtual machine.
    """
    lines = scene.mechanism.skeleton if simulation.drawing is None else simulation.drawing
    if not lines or not len(run.t):
        return None
    wanted = min(MOST_FRAMES, max(LEAST_FRAMES, round(FRAMES_A_SECOND * float(run.t[-1] - run.t[0]))))
    rows = np.unique(np.linspace(0, len(run.t) - 1, wanted).round().astype(int))
    t = run.t[rows].astype(float)
    known: dict[str, Any] = {"t": t, "q": run.q[rows], "u": run.u[rows], "tau": run.tau[rows]}
    machine = {n: run.plant.get(n, v) for n, v in run.parameters.items()}  # it is the plant that is drawn
    known |= {n: np.tile(v, (len(rows), 1)) for n, v in (machine | run.inputs).items()}
    now = ca.SX.sym("t")
    for name, course in moving_references(scene, simulation, now).items():
        known[name] = np.array(ca.Function(name, [now], [ca.densify(course)]).map(len(rows))(t.reshape(1, -1))).T
    symbols = known_symbols(scene)
    function = ca.Function("drawing", [s for _, s in symbols], [ca.densify(ca.vertcat(*map(ca.vec, lines)))])
    given = [ca.DM(known[n].astype(float).reshape(len(rows), -1).T) for n, _ in symbols]
    values = np.array(function.map(len(rows))(*given), dtype=float).T
    finite = np.all(np.isfinite(values), axis=1)
    count = len(rows) if finite.all() else int(np.argmin(finite))
    if count == 0:
        return None
    ends = np.cumsum([line.numel() for line in lines])[:-1]
    split = np.split(values[:count], ends, axis=1)
    shaped = (v.reshape(count, line.size2(), line.size1()) for v, line in zip(split, lines, strict=True))
    return Motion(t[:count], tuple(shaped))
