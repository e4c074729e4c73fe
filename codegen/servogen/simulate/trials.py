"""The same run on machines that are not the model: heavier, noisy, late, weak, or known only roughly."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from servogen.scene.scene import Scene
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.machine import Actuators
from servogen.simulate.trajectory import Trajectory

TICK = 1e-3
"""Seconds between two ticks of the controller in every trial but the first."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A machine in words, and the run on it."""

    machine: str
    run: Trajectory


def trials(loop: ClosedLoop) -> tuple[Trial, ...]:
    """The run as the simulation has it, then with a controller of a tick a millisecond on machines with one flaw each.

    Every parameter in kg (kg m^2) a fifth larger in the plant; noise of a ten-thousandth of the range that is claimed
    for q and a thousandth of u's; a delay of two ticks; actuators that give 0.8 of the largest torque of the first run.
    """
    first = loop.run()
    found = [Trial("as the simulation has it", first)]
    if not len(first.t):
        return tuple(found)
    for words, machine in _machines(loop.scene, first).items():
        found.append(Trial(words, loop.run(step=TICK, hold=TICK, **machine)))
    return tuple(found)


def not_tried(scene: Scene) -> str:
    """What `trials` leaves out for this scene, and how to have it; empty where nothing."""
    if _masses(scene):
        return ""
    return (
        "no heavier machine, for no parameter is in kg: make masses sg.Parameter, of a robot sg.urdf.load(payload=...)"
    )


def scattered(loop: ClosedLoop, first: Trajectory) -> tuple[str, dict[str, Any]]:
    """A machine that nobody knows exactly, in words and as options of ClosedLoop.runs.

    Where the simulation says what varies, that on its own machine. Else a tick a millisecond, noisy sensors as in
    `trials`, every parameter in kg (kg m^2) within a tenth of its value, q and u at the start within a hundredth of the
    range that is claimed for them.
    """
    if loop.simulation.spread:
        return "what the simulation's spread draws, on its machine", {}
    nq, width = first.q.shape[1], _widths(first)
    masses = dict.fromkeys(_masses(loop.scene), 0.1)
    spread = masses | {"q": 0.01 * width[:nq], "u": 0.01 * width[nq:]}
    told = "starts within 1 % of the range claimed, noisy sensors, ticks of 1 ms"
    told = f"masses within 10 %, {told}" if masses else told
    return told, {"spread": spread, "noise": _noise(first), "step": TICK, "hold": TICK}


def _widths(first: Trajectory) -> Any:
    """Of the ranges that are claimed for q and u; a turn where none is."""
    width = first.claim.high - first.claim.low
    return np.where(np.isfinite(width), width, 2 * np.pi)


def _noise(first: Trajectory) -> dict[str, Any]:
    nq, width = first.q.shape[1], _widths(first)
    return {"q": 1e-4 * width[:nq], "u": 1e-3 * width[nq:]}


def _masses(scene: Scene) -> dict[str, Any]:
    """Every parameter in kg or kg m^2, with its value."""
    return {f.name: np.asarray(f.default) for f in scene.parameters if "kg" in f.unit}


def _machines(scene: Scene, first: Trajectory) -> dict[str, dict[str, Any]]:
    masses = {n: 1.2 * value for n, value in _masses(scene).items()}
    machines: dict[str, dict[str, Any]] = {"a tick of 1 ms": {}}
    if masses:
        machines["masses 20 % larger"] = {"plant": masses}
    machines["noisy sensors"] = {"noise": _noise(first)}
    machines["2 ms late"] = {"delay": 2 * TICK}
    machines["0.8 of the torque"] = {"actuators": Actuators(limit=0.8 * np.max(np.abs(first.tau), axis=0))}
    return machines
