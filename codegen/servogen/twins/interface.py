"""What every twin of a scene offers (python.md: The Python side), and the reading of its keywords."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from servogen.errors import SceneError
from servogen.results import STATUS_MEANING, Control, FloatArray, Info, Path, Status
from servogen.scalars import Scalar
from servogen.scene.constraints import expression_of
from servogen.scene.scene import Scene, expressions
from servogen.scene.symbols import Field

_OF_CONSTRAINTS_ALONE = ("psi", "phi", "A", "project")
"""Functions that need no model."""

_QUANTITIES = {
    "psi": "The constraints' values, shape (m,).",
    "S": "psi_u Q^-1 G, shape (m, l), Eq. (8).",
    "z": "-psi_u Q^-1 P - X + Theta psi, shape (m,), Eq. (9).",
    "R": "The generalised forces of an ideal passive constraint, shape (n,), Eqs. (16)-(17).",
    "T": "[I A^T] Q over the constraint rows, shape (n, n), Eqs. (15), (26).",
    "F": "[I A^T] P over the right side of the constraint rows, shape (n,), Eqs. (15), (26).",
    "phi": "The constraints' values, shape (m,).",
    "A": "phi_tau, shape (m, l), Eq. (39).",
    "B": "Right side of A tau' = B, shape (m,), Eq. (40).",
    "lam": "The multipliers of the passive constraints under tau, shape (p,): forces J^T lam, least norm.",
    "closure": "chi of the passive constraints, then chi' of the holonomic ones, shape (p + p_h,).",
}
"""What a twin's functions return, by name; which of them a scene has, its system says."""


class Twin(ABC):
    """A scene's controller. Inputs go by keyword: q, u, t, tau, y and the references, each a number or a list.

    A keyword the scene knows but does not use is accepted, an unknown one is a TypeError. So is a state (q, u) left out
    that the scene uses (psi, phi, A and project: that its constraints use); other inputs left out take their default
    (references) or zero (t, tau, y). Functions that are not a scene's own (S for a controls-involved scene, say) are
    AttributeErrors. Matrices have shape (rows, columns), vectors (rows,); NaN where the code leaves outputs untouched.
    """

    def __init__(self, scene: Scene, scalar: Scalar) -> None:
        self.scene = scene
        self.scalar = scalar
        self.dtype = np.dtype(scalar)
        status = self.prepare()
        if status < 0:
            raise SceneError(
                f"scene {scene.name!r}: prepare refuses the parameters' defaults ({status.name}: "
                f"{STATUS_MEANING[status]}); give defaults that make sense in {scalar}"
            )

    def prepare(self, **parameters: Any) -> Status:
        """Set the runtime parameters; those left out take their defaults. Negative: the model is as it was."""
        fields = {f.name: f for f in self.scene.parameters}
        values: dict[str, FloatArray] = {}
        for name, given in parameters.items():
            if name not in fields:
                raise TypeError(f"prepare: no parameter {name!r}; there are {', '.join(fields) or 'none'}")
            values[name] = _sized(given, fields[name].size, name)
        return self._prepare({n: values.get(n, np.array(f.default)) for n, f in fields.items()})

    def __repr__(self) -> str:
        inputs = ", ".join(f"{f.name} ({f.size})" for f in self.scene.input_fields())
        parameters = ", ".join(f.name for f in self.scene.parameters) or "none"
        kind = type(self).__name__
        return f"<{kind} of {self.scene.name!r}, {self.scalar}: inputs {inputs}; parameters {parameters}>"

    def __getattr__(self, name: str) -> Any:
        """The functions that this kind of scene has beside pinv and control, with their docstrings."""
        if name in _QUANTITIES:
            if name in self._quantities:
                return self._function_of(name)
            raise AttributeError(f"scene {self.scene.name!r} has no {name}; its kind is {self.scene.kind}")
        if name in ("project", "step") and self.scene.system.tau_is_state:
            return self._project_ if name == "project" else self._step_
        raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")

    def __dir__(self) -> list[str]:
        moving = ["project", "step"] if self.scene.system.tau_is_state else []
        return [*super().__dir__(), *self._quantities, *moving]

    @property
    def _quantities(self) -> tuple[str, ...]:
        return (*self.scene.system.quantities, *self.scene.passive_shapes())

    def _function_of(self, name: str) -> Callable[..., FloatArray]:
        def quantity(**inputs: Any) -> FloatArray:
            return self._evaluate(name, self.read_inputs(inputs, name))

        quantity.__name__, quantity.__doc__ = name, _QUANTITIES[name]
        return quantity

    def _project_(self, *, last: Any = None, **inputs: Any) -> Control:
        """The tau nearest to the given one with phi = 0."""
        return self._control("project", self.read_inputs(inputs, "project"), self._last(last))

    def _step_(self, dt: float, *, last: Any = None, **inputs: Any) -> Control:
        """tau advanced by dt (seconds) along tau', then projected onto phi = 0."""
        return self._control("step", self.read_inputs(inputs, "step"), self._last(last), float(dt))

    def pinv(self, matrix: Any) -> FloatArray:
        """The Moore-Penrose inverse (l, m) of a matrix (m, l) of the scene's shape; NaN where it was refused."""
        shape = self.scene.system_shape
        array = np.asarray(matrix, dtype=float)
        if array.shape != shape:
            raise ValueError(f"pinv: the matrix has shape {array.shape}; this scene's are {shape}")
        return self._pinv(array)[0]

    def control(self, *, last: Any = None, **inputs: Any) -> Control:
        """tau (tau' for controls-involved scenes); `last`, or zeros, where the status is negative."""
        return self._control("control", self.read_inputs(inputs, "control"), self._last(last))

    @cached_property
    def _fields(self) -> dict[str, Field]:
        """Every input of the scene by name; kept, for a controller is called at each tick."""
        return {f.name: f for f in self.scene.input_fields()}

    def read_inputs(self, given: dict[str, Any], function: str = "control") -> dict[str, FloatArray]:
        """Every input of the scene as an array (size,). TypeError where a state that the function needs is missing."""
        scene = self.scene
        fields = self._fields
        sizes = {"q": 0, "u": 0, "t": 1, "tau": scene.controls, "y": scene.controls} | {
            n: f.size for n, f in fields.items()
        }
        values = {}
        for name, value in given.items():
            if name not in sizes:
                raise TypeError(f"{function}: no input {name!r}; scene {scene.name!r} knows {', '.join(sizes)}")
            values[name] = _sized(value, sizes[name], name)
        missing = [f"{n} ({fields[n].text})" for n in self._needed(function) if n not in values]
        if missing:
            told, verb = " and ".join(missing), "are" if missing[1:] else "is"
            raise TypeError(f"{function}: {told} of scene {scene.name!r} {verb} left out; give every state by keyword")
        return {n: values.get(n, np.array(f.default)) for n, f in fields.items()}

    def _needed(self, function: str) -> tuple[str, ...]:
        """Those of q and u without which a function has no meaning."""
        return self._states["constraints" if function in _OF_CONSTRAINTS_ALONE else "scene"]

    @cached_property
    def _states(self) -> dict[str, tuple[str, ...]]:
        """Those of q and u that the constraints use, and that the scene does; q' belongs to a constraint on q."""
        mech, parts = self.scene.mechanism, expressions(self.scene)
        constraints = [expression_of(c) for c in self.scene.constraints]
        if any(ca.depends_on(e, mech.q) for e in constraints):
            parts["q'"] = mech.q_dot

        def used(found: list[Any]) -> tuple[str, ...]:
            return tuple(n for n in ("q", "u") if any(ca.depends_on(e, getattr(mech, n)) for e in found))

        return {"constraints": used(constraints), "scene": used(list(parts.values()))}

    def _last(self, last: Any) -> FloatArray:
        value = np.zeros(self.scene.controls) if last is None else _sized(last, self.scene.controls, "last")
        return value.astype(self.dtype)

    @abstractmethod
    def _prepare(self, parameters: dict[str, FloatArray]) -> Status: ...

    @abstractmethod
    def _pinv(self, matrix: FloatArray) -> tuple[FloatArray, Info]: ...

    @abstractmethod
    def _control(self, entry: str, inputs: dict[str, FloatArray], last: FloatArray, dt: float = 0.0) -> Control: ...

    @abstractmethod
    def _evaluate(self, name: str, inputs: dict[str, FloatArray]) -> FloatArray: ...


def refusal(status: Status) -> Info:
    """Info of a negative status."""
    return Info(status, Path.NONE, 0, 0, 0.0, 0.0)


def finite(values: Any) -> bool:
    """No NaN and no infinity in any array of a mapping's values."""
    return all(math.isfinite(x) for v in values for x in np.ravel(v))


def _sized(value: Any, size: int, name: str) -> FloatArray:
    try:
        if value is None:
            raise TypeError
        array = np.atleast_1d(np.asarray(value, dtype=float)).ravel()
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(f"{name} = {value!r}; give {'a number' if size == 1 else f'{size} numbers'}") from None
    if array.size != size:
        raise ValueError(f"{name} has {array.size} entries; it must have {size}")
    return array
