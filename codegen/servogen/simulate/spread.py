"""What differs from run to run: parameters of the plant, where it starts, and the noise, all from one seed."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from servogen.errors import SceneError
from servogen.remarks import say
from servogen.results import FloatArray
from servogen.scene.scene import Scene
from servogen.simulate.machine import sized_magnitudes
from servogen.simulate.manifold import closed_starts


@dataclass(frozen=True, eq=False)
class Draws:
    """What N runs draw: names of the scalars that vary, their values (N, d), and arrays (N, size) by name.

    arrays: "plant" (all parameters one after the other), "q" and "u".
    """

    seeds: Any
    names: tuple[str, ...]
    values: FloatArray
    arrays: dict[str, FloatArray]


def check_spread(scene: Scene, spread: Mapping[str, Any]) -> dict[str, FloatArray]:
    """Half-widths by name, sized as what they belong to; SceneError for what the scene does not have."""
    sizes = {f.name: f.size for f in scene.parameters}
    sizes |= {"q": scene.mechanism.q.size1(), "u": scene.mechanism.u.size1()}
    found = {}
    for name, given in spread.items():
        what = f"spread[{name!r}]"
        if name not in sizes:
            raise SceneError(f"{what}: the scene has no such parameter; there are {', '.join(sizes)}")
        try:
            half = sized_magnitudes(given, sizes[name], what)
        except SceneError:
            raise
        except (TypeError, ValueError):
            raise SceneError(f"{what} = {given!r}; give a number, or {sizes[name]}") from None
        if not np.all(np.isfinite(half) & (half >= 0)):
            raise SceneError(f"{what} = {given!r}; give half-widths, finite and not negative")
        if name not in ("q", "u") and np.any(half >= 1):
            say([f"{what} = {_listed(half)}: draws change the sign of {name}; a share below 1 keeps it"])
        found[name] = half
    return found


def _listed(values: FloatArray) -> str:
    return ", ".join(f"{x:g}" for x in values)


def draw(
    scene: Scene,
    spread: Mapping[str, Any],
    seeds: Any,
    plant: Mapping[str, FloatArray],
    start: Mapping[str, FloatArray],
) -> Draws:
    """Uniform about the nominal values: parameters within a share of theirs, q and u within a width in their own unit.

    scene: with the plant's mechanism, onto whose passive constraints each start is brought; SceneError where none is
    near. A run's draw follows from its seed and the spread alone, so that each can be had again.
    """
    halves = check_spread(scene, spread)
    order = [n for n in (*plant, "q", "u") if n in halves]
    width = sum(len(halves[n]) for n in order)
    unit = np.array([np.random.default_rng(int(s)).uniform(-1.0, 1.0, width) for s in seeds]).reshape(len(seeds), width)
    names: list[str] = []
    varied: dict[str, FloatArray] = {}
    offset = 0
    for name in order:
        half = halves[name]
        own = unit[:, offset : offset + len(half)]
        offset += len(half)
        nominal = start[name] if name in ("q", "u") else plant[name]
        varied[name] = nominal + own * half * (1.0 if name in ("q", "u") else nominal)
        names += [name] if len(half) == 1 else [f"{name}[{k}]" for k in range(len(half))]
    full = {n: np.tile(v, (len(seeds), 1)) for n, v in (*plant.items(), ("q", start["q"]), ("u", start["u"]))} | varied
    if scene.mechanism.passive and len(seeds):
        closed, good = closed_starts(scene, {n: np.tile(v, (len(seeds), 1)) for n, v in start.items()} | full)
        if not np.all(good):
            k = int(np.argmin(good))
            drawn = "; ".join(f"{n} = {_listed(varied[n][k])}" for n in order)
            raise SceneError(
                f"spread: the run of seed {seeds[k]} starts from {drawn or 'what is given'}, where no q and u near by "
                "satisfy the passive constraints; narrow the spread, or start from another state"
            )
        full |= closed
    arrays = {
        "plant": np.hstack([np.zeros((len(seeds), 0)), *(full[n] for n in plant)]),
        "q": full["q"],
        "u": full["u"],
    }
    values = np.hstack([np.zeros((len(seeds), 0)), *(varied[n] for n in order)])
    moving = np.concatenate([np.zeros(0), *(halves[n] for n in order)]) > 0
    return Draws(seeds, tuple(n for n, m in zip(names, moving, strict=True) if m), values[:, moving], arrays)
