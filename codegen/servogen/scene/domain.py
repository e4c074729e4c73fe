"""States to check a scene at: drawn from its domain, and the boundary ones."""

import math
from typing import Any

import numpy as np

from servogen.errors import SceneError
from servogen.results import FloatArray
from servogen.scene.closing import Closer
from servogen.scene.scene import Scene, State
from servogen.scene.symbols import Field

_ROUNDS = 50
"""Times that as many states as asked for are drawn, until as many satisfy the passive constraints."""

# Where the user states no range: an angle's period, and magnitudes of one.
_DEFAULT_RANGE = {"q": (-math.pi, math.pi), "t": (0.0, 10.0), "tau_min": (-1.0, 0.0), "tau_max": (0.0, 1.0)}


def draw_states(scene: Scene, count: int, seed: int = 0) -> State:
    """`count` states from the scene's domain: name -> array (count, size), for every input the scene may have."""
    generator = np.random.default_rng(seed)
    if not scene.mechanism.passive or count == 0:
        return _draw(scene, count, generator)
    return _draw_closed(scene, count, generator)


def _draw(scene: Scene, count: int, generator: np.random.Generator) -> State:
    if callable(scene.domain):
        return _draw_by_user(scene, scene.domain, count, generator)
    states: State = {}
    for f in scene.input_fields():
        lo, hi = _range(scene, f)
        unit = generator.random((count, f.size))
        states[f.name] = lo + (hi - lo) * unit
    return states


def _draw_closed(scene: Scene, count: int, generator: np.random.Generator) -> State:
    """States brought onto the passive constraints; those that leave the user's range of q then are drawn again."""
    given = {} if callable(scene.domain) else dict(scene.domain or {})
    low, high = next(_range(scene, f) for f in scene.input_fields() if f.name == "q")
    kept: list[State] = []
    closer = Closer(scene)
    for _ in range(_ROUNDS):
        states, good = closer.close(_draw(scene, count, generator))
        if "q" in given:
            good &= np.all((low <= states["q"]) & (states["q"] <= high), axis=1)
        kept.append({name: values[good] for name, values in states.items()})
        if sum(len(part["q"]) for part in kept) >= count:
            return {name: np.concatenate([part[name] for part in kept])[:count] for name in states}
    names = ", ".join(repr(c.name) for c in scene.mechanism.passive)
    raise SceneError(
        f"domain: hardly a state drawn from it can be closed (passive constraints {names}); give ranges of q around "
        "states that satisfy chi, or a callable that returns such states; where there are none, take out those rows of "
        "chi that contradict others"
    )


def domain_box(scene: Scene, drawn: State) -> dict[str, tuple[FloatArray, FloatArray]]:
    """name -> (lowest, highest) entries of each input: by the domain's ranges, or by `drawn` where it is a callable."""
    if callable(scene.domain):
        return {name: (values.min(axis=0), values.max(axis=0)) for name, values in drawn.items()}
    return {f.name: _range(scene, f) for f in scene.input_fields()}


def _range(scene: Scene, f: Field) -> tuple[FloatArray, FloatArray]:
    ranges: dict[str, tuple[Any, Any]] = {} if callable(scene.domain) else dict(scene.domain or {})
    usual = (-0.5, 1.5) if f.name in dict(scene.switches) else _around_default(f.name, f.default)  # also out and in
    lo, hi = ranges.get(f.name, usual)
    return np.broadcast_to(np.asarray(lo, float), f.size), np.broadcast_to(np.asarray(hi, float), f.size)


def _around_default(name: str, default: tuple[float, ...]) -> tuple[Any, Any]:
    if name in _DEFAULT_RANGE:
        return _DEFAULT_RANGE[name]
    centre = np.array(default)
    return centre - 1.0, centre + 1.0


def _draw_by_user(scene: Scene, draw: Any, count: int, generator: np.random.Generator) -> State:
    fields = scene.input_fields()
    rows: dict[str, list[FloatArray]] = {f.name: [] for f in fields}
    for _ in range(count):
        try:
            state = dict(draw(generator))
        except Exception as error:
            raise SceneError(
                f"domain: drawing a state failed with {type(error).__name__}: {error}; "
                "the callable takes a numpy Generator and returns one state, {'q': [...], ...}"
            ) from error
        for f in fields:
            try:
                value = np.atleast_1d(np.asarray(state.pop(f.name, f.default), dtype=float)).ravel()
            except (TypeError, ValueError):
                raise SceneError(f"domain: the drawn {f.name!r} is no list of {f.size} numbers") from None
            if value.shape != (f.size,):
                raise SceneError(f"domain: the drawn {f.name!r} has {value.size} entries; it must have {f.size}")
            if not np.all(np.isfinite(value)):
                raise SceneError(f"domain: the drawn {f.name!r} = {value.tolist()} is not finite; draw finite numbers")
            rows[f.name].append(value)
        if state:
            raise SceneError(f"domain: {next(iter(state))!r} was drawn but is no input of scene {scene.name!r}")
    return {f.name: np.array(rows[f.name]).reshape(count, f.size) for f in fields}


def boundary_states(scene: Scene) -> tuple[tuple[str, State], ...]:
    """Named states, each with arrays (1, size): rest, all zero, tiny, huge, quarter turns, NaN and infinities."""
    base = {name: values[0] for name, values in draw_states(scene, 1, seed=1).items()}
    fields = scene.input_fields()
    named: list[tuple[str, dict[str, FloatArray]]] = []

    def add(name: str, **changes: FloatArray) -> None:
        named.append((name, base | changes))

    add("rest", u=np.zeros_like(base["u"]))
    for exponent in (-8, -20, -160):
        add(f"nearly at rest, u times 1e{exponent}", u=base["u"] * 10.0**exponent)
    named.append(("all inputs zero", {f.name: np.zeros(f.size) for f in fields}))
    named.append(("all inputs minus zero", {f.name: np.full(f.size, -0.0) for f in fields}))
    for turns in (0.5, 1.0, -0.5):
        add(f"q at {turns} pi", q=np.full_like(base["q"], turns * math.pi))
    for exponent in (-30, 6, 15):
        named.append((f"all inputs times 1e{exponent}", {n: v * 10.0**exponent for n, v in base.items()}))
    for magnitude in (1e30, 1e300):
        add(f"u of {magnitude:g}", u=np.full_like(base["u"], magnitude))
    for f in fields:
        for value in (math.nan, math.inf, -math.inf):
            for k in range(f.size):
                bad = base[f.name].copy()
                bad[k] = value
                named.append((f"{f.name}[{k}] = {value}", base | {f.name: bad}))
    return tuple((name, {k: v.reshape(1, -1) for k, v in state.items()}) for name, state in named)
