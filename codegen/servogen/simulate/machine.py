"""The machine a controller really runs on: another plant, sensors, a delay, actuators, disturbances."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from servogen.errors import SceneError
from servogen.results import FloatArray
from servogen.scene.convert import column
from servogen.scene.mechanism import Mechanism
from servogen.scene.passive import passive_name
from servogen.scene.scene import Scene

if TYPE_CHECKING:
    from servogen.simulate.simulation import Simulation

HOLD_SUBSTEPS = 2
"""Runge-Kutta steps between two ticks of a sampling controller: their error is far below that of the hold."""

ACTUATOR_SUBSTEPS = 4
"""The same where actuators have a rate or a lag, whose torque changes from one of these steps to the next."""

MOST_SUBSTEPS = 64
"""At most, where a delay that is no whole number of halves of a tick asks for more."""

MOST_DELAY = 32
"""Ticks: SIM_QUEUE of firmware_sim/simulate/machine.h, less one."""


@dataclass(frozen=True)
class Actuators:
    """What the controls can do, each a number for all of them or a list of l.

    limit: the largest magnitude, in tau's unit. rate: the largest change, per second. lag: the time constant of a first
    order lag, seconds. None, inf (limit, rate) or 0 (lag): none. The command is limited, then its rate, then it lags.
    """

    limit: Any = None
    rate: Any = None
    lag: Any = None

    def __post_init__(self) -> None:
        for name in ("limit", "rate", "lag"):
            given = getattr(self, name)
            if given is not None:
                object.__setattr__(self, name, _magnitudes(given, f"actuators: {name}", name != "lag"))

    @property
    def ideal(self) -> bool:
        """Whether the controls do what they are told, whatever was given to say so."""
        return not self.move and not any(math.isfinite(x) for x in self.limit or ())

    @property
    def move(self) -> bool:
        """Whether their torque changes between two ticks: there is a rate or a lag."""
        return any(math.isfinite(x) for x in self.rate or ()) or any(x > 0 for x in self.lag or ())


@dataclass(frozen=True)
class Grid:
    """Grid points a `step` apart: every row_every-th is a row, every tick_every-th a tick of a sampling controller.

    substeps: of the integrator in a step. steps: of the run. delay: in substeps. hold: seconds between ticks, or None.
    """

    step: float
    steps: int
    substeps: int
    row_every: int = 1
    tick_every: int = 1
    delay: int = 0
    hold: float | None = None


def sized_magnitudes(given: Any, size: int, what: str) -> FloatArray:
    """Checked magnitudes as an array (size,)."""
    array = np.asarray(given, float)
    if array.size not in (1, size):
        raise SceneError(f"{what} has {array.size} entries; give a number, or {size}")
    return np.broadcast_to(array, (size,)).copy()


def _magnitudes(given: Any, what: str, may_be_infinite: bool) -> tuple[float, ...]:
    """A number or a list of numbers, none of them negative, as a tuple."""
    try:
        array = np.atleast_1d(np.asarray(given, dtype=float)).ravel()
    except (TypeError, ValueError):
        raise SceneError(f"{what} = {given!r}; give a number, or a list of one for each entry") from None
    good = array.size and np.all(array >= 0) and not np.any(np.isnan(array))
    if not good or not (may_be_infinite or np.all(np.isfinite(array))):
        told = ", ".join(f"{x:g}" for x in array) or "no number"
        wanted = "numbers that are not negative" if may_be_infinite else "finite numbers that are not negative"
        raise SceneError(f"{what} = {told}; give {wanted}")
    return tuple(float(x) for x in array)


def check_readings(given: Mapping[str, Any], what: str) -> dict[str, tuple[float, ...]]:
    """noise or quantise: {"q": number or list, "u": ...}."""
    for name in given:
        if name not in ("q", "u"):
            raise SceneError(f"simulation: {what}[{name!r}] is neither q nor u, which are what sensors read")
    return {n: _magnitudes(v, f"simulation: {what}[{n!r}]", False) for n, v in given.items()}


def machine_in_words(simulation: "Simulation") -> str:
    """Its flaws, with their numbers; empty where it has none."""

    def numbers(values: Any) -> str:
        listed = np.atleast_1d(np.asarray(values, float))
        return ", ".join(f"{x:g}" for x in (listed[:1] if len(set(listed)) == 1 else listed))

    own = simulation.actuators or Actuators()
    told = [
        f"{words} {numbers(given)}{unit}"
        for words, given, unit, none in (
            ("|tau| at most", own.limit, "", math.inf),
            ("|tau'| at most", own.rate, " per second", math.inf),
            ("tau lags by", own.lag, " s", 0.0),
        )
        if any(x != none for x in given or ())
    ]
    told += [f"noise of {n} {numbers(v)}" for n, v in simulation.noise.items() if any(v)]
    told += [f"{n} read in steps of {numbers(v)}" for n, v in simulation.quantise.items() if any(v)]
    told += [f"delay {simulation.delay:g} s"] if simulation.delay else []
    told += [f"disturbed in {', '.join(simulation.disturbance)}"] if simulation.disturbance else []
    told += ["another mechanism"] if isinstance(simulation.plant, Mechanism) else []
    told += [f"seed {simulation.seed}"] if any(any(v) for v in simulation.noise.values()) else []
    return "; ".join(told)


def samples(simulation: "Simulation") -> bool:
    """Whether the machine is one on which a controller has to sample."""
    sensors = any(any(v) for given in (simulation.noise, simulation.quantise) for v in given.values())
    return sensors or simulation.delay > 0 or not (simulation.actuators or Actuators()).ideal


def machine_arrays(scene: Scene, simulation: "Simulation", substep: float) -> dict[str, FloatArray]:
    """limit, slew, keep, mean of the actuators, noise and quantum of the sensors, as firmware_sim/simulate/machine.h
    reads them: -1 where an actuator has none. substep: seconds."""
    l, mech = scene.controls, scene.mechanism
    own = simulation.actuators or Actuators()
    limit, rate, lag = (
        np.full(l, none) if getattr(own, n) is None else sized_magnitudes(getattr(own, n), l, f"actuators: {n}")
        for n, none in (("limit", math.inf), ("rate", math.inf), ("lag", 0.0))
    )
    shares = [(math.exp(-substep / x), -math.expm1(-substep / x) * x / substep) if x > 0 else (-1.0, -1.0) for x in lag]
    readings = {}
    for name, given in (("noise", simulation.noise), ("quantum", simulation.quantise)):
        what = "quantise" if name == "quantum" else name
        readings[name] = np.concatenate(
            [
                sized_magnitudes(given.get(n, 0.0), size, f"simulation: {what}[{n!r}]")
                for n, size in (("q", mech.q.size1()), ("u", mech.u.size1()))
            ]
        )
    return {
        "limit": np.where(np.isfinite(limit), limit, -1.0),
        "slew": np.where(np.isfinite(rate), rate * substep, -1.0),
        "keep": np.array([k for k, _ in shares]),
        "mean": np.array([m for _, m in shares]),
        **readings,
    }


def grid_of(simulation: "Simulation", duration: float, step: float, hold: float | bool | None) -> Grid:
    """The grid of a run; SceneError where step, hold and delay do not fit one another.

    hold: seconds between ticks; True: one at each row; None: as the simulation says, one at each row where the machine
    asks for a sampling controller, else none.
    """
    if hold is False and samples(simulation):
        raise SceneError("hold = False, but a machine with actuators, noise, steps or a delay samples; give seconds")
    if hold is None:
        hold = simulation.hold if simulation.hold is not None else samples(simulation)
    steps = math.ceil(duration / step * (1 - 1e-12))
    if hold is False:
        return Grid(duration / steps, steps, 1)
    if hold is True:
        step = hold = duration / steps
    ratio = step / hold
    ticks = max(round(ratio), 1)  # in a row
    rows = max(round(1 / ratio), 1)  # in a tick
    if not math.isclose(ratio, ticks / rows, rel_tol=1e-9):
        near = step / ticks if ratio > 1 else step * rows
        raise SceneError(
            f"hold = {hold:g} s and step = {step:g} s: one must be a multiple of the other; try hold = {near:g}"
        )
    moving = simulation.actuators is not None and simulation.actuators.move
    substeps, delay = _delayed(simulation.delay, hold, rows, ACTUATOR_SUBSTEPS if moving else HOLD_SUBSTEPS)
    return Grid(hold / rows, steps * ticks, substeps, ticks, rows, delay, hold)


def _delayed(delay: float, hold: float, rows: int, least: int) -> tuple[int, int]:
    """Substeps in a grid step, the fewest that make the delay a whole number of them, and that number."""
    if delay > MOST_DELAY * hold:
        raise SceneError(f"delay = {delay:g} s is more than {MOST_DELAY} ticks of {hold:g} s; give a longer hold")
    step = hold / rows
    for count in range(max(least // rows, 1), MOST_SUBSTEPS + 1):
        number = round(delay / step * count)
        if math.isclose(number * step, delay * count, rel_tol=1e-9, abs_tol=1e-12 * step):
            return count, number
    near = round(delay / step * least) * step / least
    raise SceneError(f"delay = {delay:g} s is no simple fraction of hold = {hold:g} s; try {near:g}")


def plant_scene(scene: Scene, simulation: "Simulation") -> Scene:
    """The scene with the plant's mechanism in place of the controller's: another one, disturbances added."""
    mech = scene.mechanism
    if isinstance(simulation.plant, Mechanism):
        mech = _in_the_scenes_symbols(scene, simulation.plant)
    if simulation.disturbance:
        mech = _disturbed(scene, mech, simulation.disturbance)
    return scene if mech is scene.mechanism else replace(scene, mechanism=mech)


def _in_the_scenes_symbols(scene: Scene, other: Mechanism) -> Mechanism:
    own = scene.mechanism
    for name in ("q", "u", "tau"):
        has, needs = getattr(other, name).size1(), getattr(own, name).size1()
        if has != needs:
            raise SceneError(
                f"simulation: plant has {has} entries of {name}, the scene's mechanism {needs}; give the same"
            )
    time = own.t if own.t is not None else other.t
    pairs = [(other.q, own.q), (other.u, own.u), (other.tau, own.tau)]
    pairs += [(other.t, time)] if other.t is not None else []
    before, after = ca.vertcat(*(a for a, _ in pairs)), ca.vertcat(*(b for _, b in pairs))
    parts = {n: getattr(other, n) for n in ("Q", "P", "G", "C", "D") if getattr(other, n) is not None}
    for c in other.passive:
        parts |= {passive_name(c, n): getattr(c, n) for n in ("chi", "stabilise")}
    turned = dict(zip(parts, ca.substitute(list(parts.values()), [before], [after]), strict=True))
    known = {s.__hash__() for s in ca.vertcat(after, *(f.symbol for f in scene.parameters)).nonzeros()}
    for name, sx in turned.items():
        for symbol in ca.symvar(sx):
            if symbol.__hash__() not in known:
                raise SceneError(
                    f"simulation: the plant's {name} holds the symbol {symbol.name()!r}; make it of its own q, u, tau, "
                    "t, of numbers, and of the scene's parameters"
                )
    passive = [replace(c, **{n: turned.pop(passive_name(c, n)) for n in ("chi", "stabilise")}) for c in other.passive]
    return Mechanism(q=own.q, u=own.u, tau=own.tau, t=time, passive=passive, **turned)


def _disturbed(scene: Scene, mech: Mechanism, disturbance: Mapping[str, Callable[[Any], Any] | Any]) -> Mechanism:
    """Q u' = P + p(t) + G (tau + tau(t))."""
    t = mech.t if mech.t is not None else ca.SX.sym("t")
    sizes = {"P": mech.u.size1(), "tau": scene.controls}
    added = {n: ca.SX.zeros(size) for n, size in sizes.items()}
    for name, course in disturbance.items():
        what = f"simulation: disturbance[{name!r}]"
        if name not in sizes:
            raise SceneError(f"{what}: name P (forces beside P, one for each of u) or tau (added to the controls)")
        try:
            added[name] = column(course(t) if callable(course) else course, what, sizes[name])
        except Exception as error:
            said = str(error) if isinstance(error, SceneError) else f"{what}: {type(error).__name__}: {error}"
            raise SceneError(
                f"{said}; give numbers or a function of time, lambda t: ca.vertcat(ca.sin(t), ...)"
            ) from error
        for symbol in ca.symvar(added[name]):
            if symbol.__hash__() != t.__hash__():
                raise SceneError(f"{what} holds the symbol {symbol.name()!r}; make it of time alone, lambda t: ...")
    return replace(mech, P=mech.P + added["P"] + ca.mtimes(mech.G, added["tau"]), t=t, known_rates=None)
