"""What a run is held to: where its state may go, and how far a constraint may be off its prescribed decay."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from servogen.results import FloatArray
from servogen.scene.constraints import Constraint, decay_of, expression_of
from servogen.scene.domain import draw_states
from servogen.scene.samples import draw_samples
from servogen.scene.scene import Scene
from servogen.simulate.ideal import value_at
from servogen.simulate.simulation import Simulation, known_symbols, units_of_entries

MARGIN = 0.25
"""How far beyond each end of a range of the scene's domain a state still counts as inside, in widths of the range.

A domain is where states are drawn for checks, a box somebody wrote down, not the edge of a cliff; a robot that falls
leaves it by far more. What `sg.Simulation(domain=...)` says of the run itself is taken at its word.
"""

WHOLE_TURN = 0.9
"""Of a turn: an angle's range so wide means any angle. In a narrower one the margin is at most a quarter of what is
left of the turn, so that it never closes by the margin alone."""

TOLERANCE = 1e-3
"""Of psi's size over the domain: far above any integrator's error at a sensible step, far below what a plot shows."""

SAMPLED = 1e-2
"""The same for a sampling controller, whose tau is late for what the mechanism does within a tick, and omega hold more:
omega, the fastest eigenvalue of Theta in 1/s, is the rate at which a prescribed error itself moves within one."""

STATES_OF_A_CLAIM = 200
"""States of the domain by which psi's size is read off."""


@dataclass(frozen=True, eq=False)
class Claim:
    """The entries of q and u in one row (n_q + n_u,), and the rows of psi (phi) (m,).

    low, high: where the state may go, margin included; -inf and inf where nothing is claimed. angle: entries in which
    the scene is 2 pi-periodic; they are compared at the turn nearest to the middle of their range.
    tolerance: of each row's deviation from its prescribed decay, in its own unit. relative: the same as a share of
    psi's size, NaN where the user gave it in psi's unit. names, units: of the entries; rows, row_units: of psi's rows.
    sources: by "q" and "u", who says where they may go.
    """

    low: FloatArray
    high: FloatArray
    angle: NDArray[np.bool_]
    tolerance: FloatArray
    relative: FloatArray
    names: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[str, ...]
    row_units: tuple[str, ...]
    tau_units: tuple[str, ...]
    sources: Mapping[str, str]

    def folded(self, state: FloatArray) -> FloatArray:
        """State (N, n_q + n_u) with every angle at the turn nearest to the middle of its range."""
        middle = np.zeros(len(self.angle))
        middle[self.angle] = (self.low[self.angle] + self.high[self.angle]) / 2
        turned = middle + np.remainder(state - middle + math.pi, 2 * math.pi) - math.pi
        return np.where(self.angle, turned, state)


def claim_of(
    scene: Scene, simulation: Simulation, parameters: Mapping[str, FloatArray], hold: float | None = None
) -> Claim:
    """What a run of this scene is held to; of priorities, the constraints of the first that are always active, and
    others with a tolerance of their own.

    parameters: the controller's, by name. hold: seconds between two ticks of a sampling controller.
    """
    angle = _angles(scene)
    low, high, sources = _ranges(scene, simulation, angle)
    mech = scene.mechanism
    sizes = _sizes_of_psi(scene, parameters)
    relative = np.full(scene.rows, np.nan)
    tolerance = np.empty(scene.rows)
    given, row = simulation.tolerance, 0
    first = set(scene.levels[0]) - {i for _, rows in scene.switches for i in rows}
    for c in scene.constraints:
        own = slice(row, row + c.size)
        row += c.size
        if isinstance(given, Mapping) and c.name in given:
            tolerance[own] = given[c.name]
            continue
        if own.start not in first:  # as far as the first level allows, or while it is active: nothing is claimed
            tolerance[own] = math.inf
            continue
        usual = TOLERANCE if hold is None else SAMPLED + hold * _fastest(scene, c, parameters)
        relative[own] = usual if given is None or isinstance(given, Mapping) else given
        tolerance[own] = relative[own] * sizes[own]
    nq, nu = mech.q.size1(), mech.u.size1()
    return Claim(
        low=low,
        high=high,
        angle=angle & np.isfinite(low) & np.isfinite(high),
        tolerance=tolerance,
        relative=relative,
        names=(*_indexed("q", nq), *_indexed("u", nu)),
        units=(*units_of_entries(simulation.units.get("q"), nq), *units_of_entries(simulation.units.get("u"), nu)),
        rows=tuple(
            f"constraint {c.name!r}" if c.size == 1 else f"constraint {c.name!r} (row {k + 1})"
            for c in scene.constraints
            for k in range(c.size)
        ),
        row_units=units_of_entries(simulation.units.get(scene.system.constraint), scene.rows),
        tau_units=units_of_entries(simulation.units.get("tau"), scene.controls),
        sources=sources,
    )


def _indexed(name: str, size: int) -> tuple[str, ...]:
    return (name,) if size == 1 else tuple(f"{name}[{k}]" for k in range(size))


def _ranges(
    scene: Scene, simulation: Simulation, angle: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, dict[str, str]]:
    """Ends of each entry of q and u, and by "q" and "u" who says so."""
    box = draw_samples(scene).box
    lows, highs, sources = [], [], {}
    for name in ("q", "u"):
        size = getattr(scene.mechanism, name).size1()
        if name in simulation.domain:
            lo, hi = (np.broadcast_to(np.asarray(b, float), (size,)) for b in simulation.domain[name])
            sources[name] = "the simulation's domain"
        else:
            lo, hi = _widened(*box[name], angle[:size] if name == "q" else np.zeros(size, bool))
            stated = callable(scene.domain) or name in (scene.domain or {})
            ranges = "the scene's domain" if stated else f"what checks draw, as the scene states no domain of {name},"
            sources[name] = f"{ranges} and a margin of {MARGIN:g} of its width"
        lows.append(lo)
        highs.append(hi)
    return np.concatenate(lows), np.concatenate(highs), sources


def _widened(lo: FloatArray, hi: FloatArray, angle: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
    """Ranges with their margins."""
    width = hi - lo
    margin = MARGIN * width
    rest = np.maximum(2 * math.pi - width, 0.0)
    margin = np.where(angle, np.minimum(margin, rest / 4), margin)
    margin = np.where(angle & (width >= WHOLE_TURN * 2 * math.pi), math.inf, margin)
    return lo - margin, hi + margin


def _angles(scene: Scene) -> NDArray[np.bool_]:
    """Which entries of q are angles: all the scene is made of depends on them, and is 2 pi-periodic in them."""
    mech = scene.mechanism
    free = [x for x in (scene.y, scene.weight) if isinstance(x, ca.SX)]
    chi = [c.chi for c in mech.passive]
    parts = [mech.Q, mech.P, mech.G, mech.q_dot, *chi, *(expression_of(c) for c in scene.constraints), *free]
    whole = ca.vertcat(*(ca.vec(ca.densify(ca.SX(x))) for x in parts))
    symbols = known_symbols(scene)
    function = ca.Function("whole", [s for _, s in symbols], [whole])
    drawn = draw_states(scene, 5, seed=1)
    values = {f.name: np.tile(np.asarray(f.default, float), (5, 1)) for f in scene.parameters}
    values |= {"tau": np.ones((5, scene.controls))} | drawn
    at = np.array(function.map(5).call([ca.DM(values[n].T) for n, _ in symbols])[0])
    size = np.abs(at) + np.max(np.abs(at), axis=1, keepdims=True)
    found = np.zeros(mech.q.size1() + mech.u.size1(), bool)
    for k in range(mech.q.size1()):
        if ca.depends_on(whole, mech.q[k]):
            turned = values["q"].copy()
            turned[:, k] += 2 * math.pi
            then = np.array(function.map(5).call([ca.DM((values | {"q": turned})[n].T) for n, _ in symbols])[0])
            found[k] = np.all(np.abs(then - at) <= 1e-9 * size)
    return found


def _sizes_of_psi(scene: Scene, parameters: Mapping[str, FloatArray]) -> FloatArray:
    """The root mean square of each row of psi (phi) over the domain, its size there; 1 where it is zero throughout."""
    count = STATES_OF_A_CLAIM
    symbols = known_symbols(scene)
    psi = ca.densify(ca.vertcat(*(expression_of(c) for c in scene.constraints)))
    function = ca.Function("psi", [s for _, s in symbols], [psi])
    values = {n: np.tile(v, (count, 1)) for n, v in parameters.items()}
    values |= {"tau": np.zeros((count, scene.controls))} | draw_states(scene, count)
    drawn = np.array(function.map(count).call([ca.DM(values[n].T) for n, _ in symbols])[0])
    sizes = np.sqrt(np.nanmean(np.where(np.isfinite(drawn), drawn, np.nan) ** 2, axis=1))
    return np.where(np.isfinite(sizes) & (sizes > 0), sizes, 1.0)


def _fastest(scene: Scene, constraint: Constraint, parameters: Mapping[str, FloatArray]) -> float:
    """The largest magnitude of an eigenvalue of what Theta prescribes, 1/s."""
    inputs = {f.name: np.zeros(f.size) for f in scene.input_fields()} | {"tau": np.zeros(scene.controls)}
    return float(np.max(np.abs(np.linalg.eigvals(value_at(scene, decay_of(constraint), inputs | dict(parameters))))))
