"""The inputs of a bench: the same parameters and states for every contender, from a seed."""

from dataclasses import dataclass

import numpy as np

from servogen.results import FloatArray
from servogen.scalars import Scalar
from servogen.scene.domain import boundary_states, draw_states
from servogen.scene.scene import Scene, State


@dataclass(frozen=True, eq=False)
class Inputs:
    """Parameters and N states as tables: a row is a state, its columns the scene's inputs in the struct's order.

    parameters: (P,), states: (N, W), both float64. slices, parameter_slices: name -> columns.
    """

    parameters: FloatArray
    states: FloatArray
    slices: dict[str, slice]
    parameter_slices: dict[str, slice]

    @property
    def count(self) -> int:
        return len(self.states)

    def rounded(self, scalar: Scalar) -> "Inputs":
        """As a contender of that number type gets them."""
        with np.errstate(over="ignore"):
            parameters, states = (x.astype(scalar).astype(float) for x in (self.parameters, self.states))
        return Inputs(parameters, states, self.slices, self.parameter_slices)

    def columns(self) -> dict[str, FloatArray]:
        """name -> array (N, size) for inputs and (1, size) for parameters: what the interpreters read."""
        given = {name: self.states[:, columns] for name, columns in self.slices.items()}
        return given | {name: self.parameters[np.newaxis, s] for name, s in self.parameter_slices.items()}

    def keywords(self) -> list[dict[str, FloatArray]]:
        """One dict of inputs a state, as twins read them."""
        return [{name: row[columns] for name, columns in self.slices.items()} for row in self.states]


def drawn(scene: Scene, count: int, seed: int) -> Inputs:
    """`count` states from the scene's domain, with the parameters' defaults."""
    return _table(scene, draw_states(scene, count, seed))


def at_the_boundary(scene: Scene) -> tuple[tuple[str, ...], Inputs]:
    """The boundary states whose inputs are finite: (names, inputs)."""
    named = [(n, s) for n, s in boundary_states(scene) if all(np.all(np.isfinite(v)) for v in s.values())]
    stacked = {f.name: np.vstack([state[f.name] for _, state in named]) for f in scene.input_fields()}
    return tuple(name for name, _ in named), _table(scene, stacked)


def _table(scene: Scene, states: State) -> Inputs:
    fields, parameters = scene.input_fields(), tuple(scene.parameters)
    values = np.hstack([states[f.name] for f in fields])
    defaults = np.concatenate([np.zeros(0), *(np.array(f.default) for f in parameters)])
    return Inputs(
        defaults,
        values,
        _slices([(f.name, f.size) for f in fields]),
        _slices([(f.name, f.size) for f in parameters]),
    )


def _slices(sizes: list[tuple[str, int]]) -> dict[str, slice]:
    result, start = {}, 0
    for name, size in sizes:
        result[name] = slice(start, start + size)
        start += size
    return result
