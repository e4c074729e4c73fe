"""Where a simulated run of a scene starts, how long it lasts, what is drawn and what stops it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from servogen.errors import SceneError
from servogen.results import FloatArray
from servogen.scene.convert import to_sx
from servogen.scene.domain import draw_states
from servogen.scene.scene import Scene

METHODS = ("rk4", "dop8")
"""The rows of sim_methods in firmware_sim/simulate/loop.c, in its order."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """Defaults of `servogen simulate`, all optional; a scene file defines it as `simulation`.

    start: q, u, tau (controls-involved scenes), y and references at t = 0, by name; what is left out is drawn from the
        domain (q, u, tau) or takes its default. tau is projected onto phi = 0 before the run.
    duration, step: seconds.
    outputs: name -> SX scalar of q, u, tau, t, parameters and references, drawn along the trajectory.
    decay: name of an output -> (rate, limit): it ought to follow limit + (value(0) - limit) exp(rate t); numbers or SX
        of parameters and references.
    stop: name -> SX scalar; the run ends with that name where it becomes <= 0.
    motion: name of a reference -> SX of t and the parameters: it moves along it instead of standing still. Give its
        rates (`r_dot`) as well where they are references.
    sigma_min, tau_max: margins; the run ends where the smallest singular value of the raw S (A, G) falls to the one,
        or a control's magnitude exceeds the other.
    method: "rk4", or "dop8", the order-8 formula of Dormand and Prince.
    units: of q, u, tau, psi (or phi) and the outputs by name, for the axes.
    """

    start: Mapping[str, Any] = field(default_factory=dict)
    duration: float = 10.0
    step: float = 1e-3
    outputs: Mapping[str, Any] = field(default_factory=dict)
    decay: Mapping[str, tuple[Any, Any]] = field(default_factory=dict)
    stop: Mapping[str, Any] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    motion: Mapping[str, Any] = field(default_factory=dict)
    sigma_min: float | None = None
    tau_max: float | None = None
    method: str = "rk4"

    def __post_init__(self) -> None:
        for what in ("outputs", "stop"):
            checked = {n: _scalar(e, f"simulation: {what}[{n!r}]") for n, e in getattr(self, what).items()}
            object.__setattr__(self, what, checked)
        object.__setattr__(self, "motion", {n: to_sx(e, f"simulation: motion[{n!r}]") for n, e in self.motion.items()})
        for name in ("sigma_min", "tau_max"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0):
                raise SceneError(f"simulation: {name} = {value!r}; give a positive number, or None")
        if self.method not in METHODS:
            raise SceneError(f"simulation: method {self.method!r}; choose {' or '.join(METHODS)}")
        for name in self.decay:
            if name not in self.outputs:
                raise SceneError(f"simulation: decay[{name!r}] belongs to no output; add it to outputs")
        decay = {n: tuple(_scalar(e, f"simulation: decay[{n!r}]") for e in pair) for n, pair in self.decay.items()}
        object.__setattr__(self, "decay", decay)

    @property
    def events(self) -> tuple[str, ...]:
        """What can end a run, in the order of the generated loop."""
        margins = [] if self.sigma_min is None else [f"sigma_min <= {self.sigma_min:g}"]
        margins += [] if self.tau_max is None else [f"|tau| > {self.tau_max:g}"]
        return (*self.stop, *margins)


def check_simulation(scene: Scene, simulation: Simulation) -> None:
    """SceneError where the simulation names what the scene does not have."""
    known = {s.__hash__() for _, symbol in known_symbols(scene) for s in symbol.nonzeros()}
    named = [(f"outputs[{n!r}]", e) for n, e in simulation.outputs.items()]
    named += [(f"stop[{n!r}]", e) for n, e in simulation.stop.items()]
    named += [(f"motion[{n!r}]", e) for n, e in simulation.motion.items()]
    sizes = {f.name: f.size for f in scene.references or ()}
    for name, expression in simulation.motion.items():
        if sizes.get(name) != expression.numel():
            raise SceneError(
                f"simulation: motion[{name!r}] has {expression.numel()} entries; give one of the references "
                f"{', '.join(f'{n} ({s})' for n, s in sizes.items())}"
            )
    named += [(f"decay[{n!r}]", e) for n, pair in simulation.decay.items() for e in pair]
    for what, expression in named:
        for symbol in ca.symvar(expression):
            if symbol.__hash__() not in known:
                raise SceneError(
                    f"simulation: {what} holds the symbol {symbol.name()!r}, which is not an input of scene "
                    f"{scene.name!r}; use its q, u, tau, t, parameters and references"
                )
    names = {"psi", "phi", *simulation.outputs, *(n for n, _ in known_symbols(scene))}
    for name in simulation.units:
        if name not in names:
            raise SceneError(
                f"simulation: units[{name!r}] belongs to nothing that is drawn; there are {', '.join(names)}"
            )


def known_symbols(scene: Scene) -> list[tuple[str, Any]]:
    """(name, SX symbol) of everything an output may use: parameters, inputs and tau."""
    assert scene.parameters is not None
    fields = [(f.name, f.symbol) for f in (*scene.parameters, *scene.input_fields())]
    return fields if scene.kind == "controls" else [*fields, ("tau", scene.mechanism.tau)]


def start_values(scene: Scene, simulation: Simulation, given: Mapping[str, Any] | None = None) -> dict[str, FloatArray]:
    """Every input at t = 0 as an array (size,), tau included; `given` goes before simulation.start.

    SceneError for unknown names and wrong sizes.
    """
    drawn = draw_states(scene, 1)
    values = {
        f.name: np.asarray(drawn[f.name][0] if f.name in ("q", "u", "tau") else f.default, dtype=float)
        for f in scene.input_fields()
    }
    values.setdefault("tau", np.zeros(scene.controls))
    values["t"] = np.zeros(1)
    for name, value in {**simulation.start, **(given or {})}.items():
        if name not in values or name == "t":
            raise SceneError(f"start: {name!r} is no state or input; there are {', '.join(set(values) - {'t'})}")
        values[name] = sized(value, values[name].size, f"start: {name}")
    return values


def sized(value: Any, size: int, what: str) -> FloatArray:
    """A number or a list as an array (size,); SceneError otherwise."""
    try:
        array = np.atleast_1d(np.asarray(value, dtype=float)).ravel()
    except (TypeError, ValueError):
        raise SceneError(f"{what} = {value!r}; give {size} numbers") from None
    if array.size != size:
        raise SceneError(f"{what} has {array.size} entries; it must have {size}")
    return array


def _scalar(expression: Any, what: str) -> Any:
    sx = to_sx(expression, what)
    if not sx.is_scalar():
        raise SceneError(f"{what} has shape {sx.size1()}x{sx.size2()}; give a scalar expression")
    return sx
