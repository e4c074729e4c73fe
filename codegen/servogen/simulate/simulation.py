"""Where a simulated run of a scene starts, how long it lasts, what is drawn and what stops it."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from servogen.errors import SceneError
from servogen.remarks import say
from servogen.results import FloatArray
from servogen.scene.convert import column, to_sx
from servogen.scene.domain import draw_states
from servogen.scene.limits import INPUTS
from servogen.scene.mechanism import Mechanism
from servogen.scene.polylines import polylines
from servogen.scene.scene import Scene
from servogen.scene.symbols import Field, chains
from servogen.simulate.machine import Actuators, check_readings, machine_arrays, plant_scene
from servogen.simulate.spread import check_spread

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
        where the scene declares them, are its derivatives. Numbers, and what is left out (see start), are constant.
    sigma_min, tau_max: margins; the run ends where `info.sigma_min`, the smallest singular value of the raw S (A, G) or
        a lower bound of it, falls to the one, or a control's magnitude exceeds the other.
    method: "rk4", or "dop8", the order-8 formula of Dormand and Prince.
    domain: {"q": (lo, hi), "u": (lo, hi)}, where this run is expected to go, if not where the scene's domain says; each
        a number or a list, -inf and inf for no end. A run that goes elsewhere has left the domain, whatever psi does.
    tolerance: of psi (phi) off its prescribed decay: a share of its size over the domain, or {constraint: number} in
        psi's own unit. Default 1e-3 of its size; with a sampling controller 1e-2, and omega hold more, omega the
        fastest eigenvalue of Theta in 1/s: so much an error moves within a tick.
    units: of q, u, tau, psi (or phi), the outputs by name and the drawing, for the axes: one for all entries, "m", or
        one for each, ["m", "rad"] or "m, rad".
    drawing: the mechanism as polylines, for the report: [[a, b, c], [target]], each a list of points, 2 or 3 entries of
        SX of q, u, tau, t, parameters and references (or a matrix with points as columns); a single point is a mark. In
        space z points upwards. None: a robot of sg.urdf draws itself, other mechanisms are not drawn.

    The machine, by default exactly the controller's model, without flaws:
    plant: its own values of parameters, {"m": 2.0}; or another sg.Mechanism of as many q, u and tau.
    actuators: sg.Actuators(limit, rate, lag). noise: standard deviation of what is read of q and u, {"q": 1e-4};
        normal. quantise: the steps that it comes in. delay: from reading to acting, seconds.
    hold: seconds between two ticks of a controller that samples; tau is held in between. None: one tick a row where
        there are actuators, noise, quantisation or a delay; else the controller acts at every instant.
    disturbance: {"P": ..., "tau": ...}: forces beside P, or beside the controls, as numbers or functions of time.
    seed: of the noise, a whole number below 2^32; of many runs, the first one's.
    spread: half-widths of what many runs draw, uniform: {"m": 0.1} is 10 % of the plant's parameter either way, and
        {"q": 0.05}, {"u": ...} as much of the start in its own unit. A single run draws nothing.
    """

    start: Mapping[str, Any] = field(default_factory=dict)
    duration: float = 10.0
    step: float = 1e-3
    outputs: Mapping[str, Any] = field(default_factory=dict)
    decay: Mapping[str, tuple[Any, Any]] = field(default_factory=dict)
    stop: Mapping[str, Any] = field(default_factory=dict)
    references: Mapping[str, Callable[[Any], Any] | Any] = field(default_factory=dict)
    units: Mapping[str, Any] = field(default_factory=dict)
    sigma_min: float | None = None
    tau_max: float | None = None
    method: str = "rk4"
    domain: Mapping[str, tuple[Any, Any]] = field(default_factory=dict)
    tolerance: float | Mapping[str, float] | None = None
    drawing: Any = None
    plant: Mapping[str, Any] | Mechanism = field(default_factory=dict)
    actuators: Actuators | None = None
    noise: Mapping[str, Any] = field(default_factory=dict)
    quantise: Mapping[str, Any] = field(default_factory=dict)
    delay: float = 0.0
    hold: float | None = None
    disturbance: Mapping[str, Callable[[Any], Any] | Any] = field(default_factory=dict)
    seed: int = 0
    spread: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for what in (
            *("start", "outputs", "decay", "stop", "references", "units", "domain"),
            *("noise", "quantise", "disturbance", "spread"),
        ):
            if not isinstance(getattr(self, what), Mapping):
                raise SceneError(f"simulation: {what} = {getattr(self, what)!r}; give {{'name': ...}}")
        for what in ("outputs", "stop"):
            checked = {n: _scalar(e, f"simulation: {what}[{n!r}]") for n, e in getattr(self, what).items()}
            object.__setattr__(self, what, checked)
        for name in ("duration", "step", "sigma_min", "tau_max"):
            value, optional = getattr(self, name), name in ("sigma_min", "tau_max")
            if not _positive(value) and not (value is None and optional):
                remedy = "give a positive number" + (", or None" if optional else "")
                raise SceneError(f"simulation: {name} = {value!r}; {remedy}")
        _check_tolerance(self.tolerance)
        if self.drawing is not None:
            object.__setattr__(self, "drawing", polylines(self.drawing, "simulation: drawing"))
        self._check_machine()
        object.__setattr__(self, "units", {n: _units_text(n, u) for n, u in self.units.items()})
        if self.method not in METHODS:
            raise SceneError(f"simulation: method {self.method!r}; choose {' or '.join(METHODS)}")
        for name in self.decay:
            if name not in self.outputs:
                raise SceneError(f"simulation: decay[{name!r}] belongs to no output; add it to outputs")
        decay = {n: tuple(_scalar(e, f"simulation: decay[{n!r}]") for e in pair) for n, pair in self.decay.items()}
        object.__setattr__(self, "decay", decay)

    def _check_machine(self) -> None:
        if not isinstance(self.plant, Mapping | Mechanism):
            got = type(self.plant).__name__
            raise SceneError(f"simulation: plant is a {got}; give {{'parameter': value}}, or an sg.Mechanism")
        if not isinstance(self.actuators, Actuators | None):
            got = type(self.actuators).__name__
            raise SceneError(f"simulation: actuators is a {got}; give sg.Actuators(limit=..., rate=..., lag=...)")
        for what in ("noise", "quantise"):
            object.__setattr__(self, what, check_readings(getattr(self, what), what))
        if not _positive(self.delay) and self.delay != 0:
            raise SceneError(f"simulation: delay = {self.delay!r}; give seconds, 0 for none")
        if self.hold is not None and not _positive(self.hold):
            raise SceneError(f"simulation: hold = {self.hold!r}; give seconds between two ticks, or None")
        if not isinstance(self.seed, int | np.integer) or not 0 <= self.seed < 2**32:
            raise SceneError(f"simulation: seed = {self.seed!r}; give a whole number from 0 to 2^32 - 1")

    @property
    def events(self) -> tuple[str, ...]:
        """What can end a run, in the order of the generated loop."""
        margins = [] if self.sigma_min is None else [f"sigma_min <= {self.sigma_min:g}"]
        margins += [] if self.tau_max is None else [f"|tau| > {self.tau_max:g}"]
        return (*self.stop, *margins)

    def holding(self, references: Iterable[str]) -> "Simulation":
        """The same with these references at rest, for a run that gives their values."""
        given = set(references)
        return replace(self, references={n: r for n, r in self.references.items() if n not in given})


def _units_text(name: str, unit: object) -> str:
    """One unit, or one for each entry with commas between."""
    parts = [unit] if isinstance(unit, str) else list(unit) if isinstance(unit, Sequence) else [None]
    if not all(isinstance(part, str) for part in parts):
        raise SceneError(f"simulation: units[{name!r}] = {unit!r}; give text, or a list of it, one for each entry")
    return ", ".join(map(str, parts))


def units_of_entries(unit: str | None, count: int) -> tuple[str, ...]:
    """The unit of each of `count` entries: as many with commas between, else the whole text for each; "" for none."""
    parts = tuple(part.strip() for part in (unit or "").split(","))
    return parts if len(parts) == count else ((unit or "").strip(),) * count


def with_units_of_rates(scene: Scene, simulation: Simulation) -> Simulation:
    """Where u is q' and only q's units are told, u's are those per second."""
    units, u, q_dot = simulation.units, scene.mechanism.u, scene.mechanism.q_dot
    told = units.get("q", "").count(",") + 1
    unlike = u.shape != q_dot.shape or not ca.is_equal(q_dot, u) or told not in (1, u.numel())
    if "u" in units or "q" not in units or unlike:
        return simulation
    per_second = (f"{unit or '1'}/s" for unit in units_of_entries(units["q"], told))
    return replace(simulation, units={**units, "u": ", ".join(per_second)})


def check_simulation(scene: Scene, simulation: Simulation) -> None:
    """SceneError where the simulation names what the scene does not have."""
    known = {s.__hash__() for _, symbol in known_symbols(scene) for s in symbol.nonzeros()}
    named = [(f"outputs[{n!r}]", e) for n, e in simulation.outputs.items()]
    named += [(f"stop[{n!r}]", e) for n, e in simulation.stop.items()]
    named += [(f"decay[{n!r}]", e) for n, pair in simulation.decay.items() for e in pair]
    named += [(f"drawing[{k}]", line) for k, line in enumerate(simulation.drawing or ())]
    for what, expression in named:
        for symbol in ca.symvar(expression):
            if symbol.__hash__() not in known:
                raise SceneError(
                    f"simulation: {what} holds the symbol {symbol.name()!r}, which is not an input of scene "
                    f"{scene.name!r}; use its q, u, tau, t, parameters and references"
                )
    moving_references(scene, simulation, ca.SX.sym("t"))
    _resting_references(scene, simulation)
    _check_run_domain(scene, simulation)
    if isinstance(simulation.plant, Mapping):
        checked(simulation.plant, run_takes(scene)["parameters"], "plant")
    check_spread(scene, simulation.spread)
    plant_scene(scene, simulation)
    machine_arrays(scene, simulation, 1.0)
    names = {"psi", "phi", "drawing", *simulation.outputs, *(n for n, _ in known_symbols(scene))}
    for name in simulation.units:
        if name not in names:
            raise SceneError(
                f"simulation: units[{name!r}] belongs to nothing drawn; there are {', '.join(sorted(names))}"
            )
    sizes = {name: symbol.numel() for name, symbol in known_symbols(scene)} | {scene.system.constraint: scene.rows}
    for name, size in sizes.items():
        told = simulation.units.get(name, "").count(",") + 1
        if told not in (1, size):
            text = f"simulation: units[{name!r}] = {simulation.units[name]!r} tells {told} units of {size} entries"
            say([f"{text} and stands at each of them; give one for all, or one for each"])


def _check_run_domain(scene: Scene, simulation: Simulation) -> None:
    """The simulation's domain fits q and u, and its tolerances belong to constraints."""
    sizes = {"q": scene.mechanism.q.size1(), "u": scene.mechanism.u.size1()}
    for name, limits in simulation.domain.items():
        what = f"simulation: domain[{name!r}]"
        if name not in sizes:
            raise SceneError(f"{what} is neither q nor u; a run's domain is of these two")
        try:
            lo, hi = (np.broadcast_to(np.asarray(b, dtype=float), (sizes[name],)) for b in limits)
        except (TypeError, ValueError):
            raise SceneError(f"{what} = {limits!r}; give (lo, hi), each a number or a list of {sizes[name]}") from None
        if not np.all(lo < hi):
            raise SceneError(f"{what} = {limits!r}; give lo < hi, -inf and inf for no end")
    known = {c.name for c in scene.constraints}
    for name in simulation.tolerance if isinstance(simulation.tolerance, Mapping) else ():
        if name not in known:
            raise SceneError(f"simulation: tolerance[{name!r}] belongs to no constraint; there are {', '.join(known)}")


def known_symbols(scene: Scene) -> list[tuple[str, Any]]:
    """(name, SX symbol) of everything an output may use: parameters, inputs and tau."""
    symbols = {f.name: f.symbol for f in (*scene.parameters, *scene.input_fields())}
    return list((symbols | {"tau": scene.mechanism.tau}).items())


def run_takes(scene: Scene) -> dict[str, dict[str, int]]:
    """What ClosedLoop.run takes by name, and its size: start (limits that are inputs among it), references (y among
    them) and parameters."""
    mech = scene.mechanism
    states = {"q": mech.q.size1(), "u": mech.u.size1(), "tau": scene.controls}
    states |= {f.name: f.size for f in scene.input_fields() if f.name in INPUTS.values()}
    return {
        "start": states,
        "references": {f.name: f.size for f in scene.input_fields() if f.name not in (*states, "t")},
        "parameters": {f.name: f.size for f in scene.parameters},
    }


def moving_references(scene: Scene, simulation: Simulation, t: Any) -> dict[str, Any]:
    """name -> SX of t for every reference that moves, its declared rates included, and for y."""
    moving: dict[str, Any] = {}
    for name, what, fields in _given_references(scene, simulation):
        course = simulation.references[name]
        if callable(course):
            value = _course(course, t, what, fields[0].size)
            for f in fields:
                moving[f.name] = value
                value = ca.jacobian(value, t)
    return moving


def start_values(
    scene: Scene,
    simulation: Simulation,
    start: Mapping[str, Any] | None = None,
    references: Mapping[str, Any] | None = None,
) -> dict[str, FloatArray]:
    """Every input at t = 0 as an array (size,), tau included; `start` and `references` go before the simulation's.

    SceneError for unknown names, wrong sizes and what is not finite.
    """
    takes = run_takes(scene)
    drawn = draw_states(scene, 1)
    values = {
        f.name: np.asarray(drawn[f.name][0] if f.name in ("q", "u", "tau") else f.default, dtype=float)
        for f in scene.input_fields()
    }
    values.setdefault("tau", np.zeros(scene.controls))
    values["t"] = np.zeros(1)
    values |= checked(simulation.start, takes["start"] | takes["references"], "simulation: start")
    values |= _resting_references(scene, simulation)
    values |= checked(start or {}, takes["start"], "start")
    values |= checked(references or {}, takes["references"], "references")
    for name in (f.name for f in scene.input_fields() if f.name in INPUTS.values()):
        if name not in simulation.start and name not in (start or {}):
            raise SceneError(f"simulation: start has no {name}, the limits of tau; give a number for each control")
    return values


def checked(given: Mapping[str, Any], sizes: Mapping[str, int], what: str) -> dict[str, FloatArray]:
    """`given` as arrays of these sizes; SceneError naming `what` where it does not fit."""
    for name in given:
        if name not in sizes:
            raise SceneError(f"{what}: {name!r} is unknown; there are {', '.join(sizes) or 'none'}")
    limits = INPUTS.values()
    return {n: sized(value, sizes[n], f"{what}: {n}", finite=n not in limits) for n, value in given.items()}


def sized(value: Any, size: int, what: str, remedy: str = "", finite: bool = True) -> FloatArray:
    """A number or a list as an array (size,), without NaN and, where so wished, infinities; SceneError otherwise."""
    wanted = f"give {size} number{'s' if size > 1 else ''}{remedy}"
    try:
        array = np.atleast_1d(np.asarray(value))
        if array.dtype.kind in "USc":
            raise TypeError("text and complex numbers are no numbers here")
        array = array.astype(float).ravel()
    except (TypeError, ValueError):
        raise SceneError(f"{what} = {value!r}; {wanted}") from None
    if array.size != size:
        raise SceneError(f"{what} has {array.size} entries; it must have {size}")
    if not np.all(np.isfinite(array)) and (finite or np.any(np.isnan(array))):
        raise SceneError(f"{what} = {value!r} is not finite; {wanted}")
    return array


def _given_references(scene: Scene, simulation: Simulation) -> Iterator[tuple[str, str, tuple[Field, ...]]]:
    """(name, what to call it, the inputs it sets) of each of simulation.references."""
    assert scene.references is not None
    known = {c.chain[0].name: c.chain for c in chains(scene.references)}
    own = {*(["y"] if scene.y == "input" else []), *(name for name, _ in scene.switches)}
    known |= {f.name: (f,) for f in scene.input_fields() if f.name in own}
    for name in simulation.references:
        what = f"simulation: references[{name!r}]"
        if name not in known:
            raise SceneError(f"{what} is no reference; there are {', '.join(known) or 'none'}")
        yield name, what, known[name]


def _resting_references(scene: Scene, simulation: Simulation) -> dict[str, FloatArray]:
    """The references that simulation.references gives as numbers, their declared rates zero."""
    resting: dict[str, FloatArray] = {}
    for name, what, fields in _given_references(scene, simulation):
        value = simulation.references[name]
        if not callable(value):
            resting |= {f.name: np.zeros(f.size) for f in fields}
            resting[name] = sized(value, fields[0].size, what, ", or a function of time, as lambda t: ca.sin(t)")
    return resting


def _course(function: Callable[[Any], Any], t: Any, what: str, size: int) -> Any:
    """function(t) as a column of SX that depends on t alone."""
    remedy = "a function of time is made of its argument and casadi's functions: lambda t: ca.sin(t), not math.sin(t)"
    try:
        sx = column(function(t), what, size)
    except Exception as error:
        said = str(error) if isinstance(error, SceneError) else f"{what}: {type(error).__name__}: {error}"
        raise SceneError(f"{said}; {remedy}") from error
    for symbol in ca.symvar(sx):
        if symbol.__hash__() != t.__hash__():
            raise SceneError(f"{what} holds the symbol {symbol.name()!r}; {remedy}")
    course = ca.Function("course", [t], [sx])
    constants = [k for k in range(course.n_instructions()) if course.instruction_id(k) == ca.OP_CONST]
    if not all(np.isfinite(course.instruction_constant(k)) for k in constants):
        raise SceneError(f"{what} holds a number that is not finite; {remedy}")
    return sx


def _positive(value: Any) -> bool:
    number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return number and bool(np.isfinite(value)) and value > 0


def _check_tolerance(given: Any) -> None:
    for value in given.values() if isinstance(given, Mapping) else () if given is None else (given,):
        if not _positive(value):
            raise SceneError(
                f"simulation: tolerance = {given!r}; give a positive share of psi's size, say 1e-3, "
                "or {constraint: positive number in psi's unit}"
            )


def _scalar(expression: Any, what: str) -> Any:
    sx = to_sx(expression, what)
    if not sx.is_scalar():
        raise SceneError(f"{what} has shape {sx.size1()}x{sx.size2()}; give a scalar expression")
    return sx
