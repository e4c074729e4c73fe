"""Where a simulated run of a scene starts, how long it lasts, what is drawn and what stops it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from servogen.errors import SceneError
from servogen.results import FloatArray
from servogen.scene.convert import column, to_sx
from servogen.scene.domain import draw_states
from servogen.scene.scene import Scene
from servogen.scene.symbols import chains

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
    references: name -> function of time, lambda t: SX, for references (and y) that move; their rates r_dot and r_ddot,
        where the scene declares them, are its derivatives. What is not here is constant, see start.
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
    references: Mapping[str, Callable[[Any], Any]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    sigma_min: float | None = None
    tau_max: float | None = None
    method: str = "rk4"

    def __post_init__(self) -> None:
        for what in ("start", "outputs", "decay", "stop", "references", "units"):
            if not isinstance(getattr(self, what), Mapping):
                raise SceneError(f"simulation: {what} = {getattr(self, what)!r}; give {{'name': ...}}")
        for what in ("outputs", "stop"):
            checked = {n: _scalar(e, f"simulation: {what}[{n!r}]") for n, e in getattr(self, what).items()}
            object.__setattr__(self, what, checked)
        for name in ("duration", "step", "sigma_min", "tau_max"):
            value, optional = getattr(self, name), name in ("sigma_min", "tau_max")
            number = isinstance(value, int | float | np.integer | np.floating) and np.isfinite(value)
            if not (number and value > 0) and not (value is None and optional):
                remedy = "give a positive number" + (", or None" if optional else "")
                raise SceneError(f"simulation: {name} = {value!r}; {remedy}")
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
    named += [(f"decay[{n!r}]", e) for n, pair in simulation.decay.items() for e in pair]
    for what, expression in named:
        for symbol in ca.symvar(expression):
            if symbol.__hash__() not in known:
                raise SceneError(
                    f"simulation: {what} holds the symbol {symbol.name()!r}, which is not an input of scene "
                    f"{scene.name!r}; use its q, u, tau, t, parameters and references"
                )
    moving_references(scene, simulation, ca.SX.sym("t"))
    names = {"psi", "phi", *simulation.outputs, *(n for n, _ in known_symbols(scene))}
    for name in simulation.units:
        if name not in names:
            raise SceneError(
                f"simulation: units[{name!r}] belongs to nothing drawn; there are {', '.join(sorted(names))}"
            )


def known_symbols(scene: Scene) -> list[tuple[str, Any]]:
    """(name, SX symbol) of everything an output may use: parameters, inputs and tau."""
    fields = [(f.name, f.symbol) for f in (*scene.parameters, *scene.input_fields())]
    return fields if scene.system.tau_is_state else [*fields, ("tau", scene.mechanism.tau)]


def moving_references(scene: Scene, simulation: Simulation, t: Any) -> dict[str, Any]:
    """name -> SX of t for every reference that moves, its declared rates included, and for y."""
    assert scene.references is not None
    chain = {c.chain[0].name: c.chain for c in chains(scene.references)}
    moving: dict[str, Any] = {}
    for name, function in simulation.references.items():
        if name not in chain and not (name == "y" and scene.y == "input"):
            raise SceneError(
                f"simulation: references[{name!r}] is no reference; there are {', '.join(chain) or 'none'}"
            )
        fields = [(f.name, f.size) for f in chain[name]] if name in chain else [("y", scene.controls)]
        value = column(function(t), f"simulation: references[{name!r}]", fields[0][1])
        for field_name, _ in fields:
            moving[field_name] = value
            value = ca.jacobian(value, t)
    return moving


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
            known = ", ".join(n for n in values if n != "t")
            raise SceneError(f"start: {name!r} is no state or input; there are {known}")
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
