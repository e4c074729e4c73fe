"""How a run of a closed loop goes where it is not as the simulation says."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from servogen.simulate.machine import Actuators
from servogen.simulate.simulation import Simulation


@dataclass(frozen=True, kw_only=True, eq=False)
class Options:
    """The keywords of ClosedLoop.run and .runs, each before what the simulation says; None: as that says.

    start: q, u, tau by name; what is left out comes from the simulation. duration, step: seconds; the step is
    shortened so that it divides the duration, but with a `hold` in seconds both last as they say.
    references: y and references by name, constant over the run; none that the simulation moves, see
    Simulation.holding. parameters: of controller and plant; plant: of the plant alone.
    hold: seconds between two ticks of the controller (`control`, or `step(dt)`), tau held in between, as in
    firmware; True: one tick a step. project: controls-involved scenes first take the nearest tau with phi = 0.
    method: "rk4" or "dop8". spread: half-widths of what many runs draw. actuators, noise, quantise, delay, seed: the
    machine, as in sg.Simulation.
    """

    start: Mapping[str, Any] | None = None
    duration: float | None = None
    step: float | None = None
    references: Mapping[str, Any] | None = None
    parameters: Mapping[str, Any] | None = None
    plant: Mapping[str, Any] | None = None
    hold: float | bool | None = None
    project: bool = True
    method: str | None = None
    spread: Mapping[str, Any] | None = None
    actuators: Actuators | None = None
    noise: Mapping[str, Any] | None = None
    quantise: Mapping[str, Any] | None = None
    delay: float | None = None
    seed: int | None = None

    def on(self, simulation: Simulation) -> Simulation:
        """The simulation on this machine."""
        machine = {n: getattr(self, n) for n in ("actuators", "noise", "quantise", "delay", "seed")}
        return replace(simulation, **{n: value for n, value in machine.items() if value is not None})


def options_of(given: Mapping[str, Any]) -> Options:
    """TypeError for a keyword that a run does not have."""
    known = [f.name for f in fields(Options)]
    for name in given:
        if name not in known:
            raise TypeError(f"run() got an unexpected keyword {name!r}; of a run there are {', '.join(known)}")
    return Options(**given)
