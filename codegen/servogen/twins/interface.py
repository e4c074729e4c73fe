"""What every twin of a scene offers (python.md: The Python side), and the reading of its keywords."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from servogen.errors import SceneError
from servogen.results import STATUS_MEANING, Batch, Control, FloatArray, Info, Path, Status
from servogen.scalars import Scalar
from servogen.scene.constraints import expression_of
from servogen.scene.scene import Scene, expressions
from servogen.scene.symbols import Field
from servogen.twins.batch import States, read_states

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
}
"""What a twin's functions return, by name; which of them a scene has, its system says."""


class Twin(ABC):
    """A scene's controller. Inputs go by keyword: q, u, t, tau, y and the references, each a number or a list.

    A keyword the scene knows but does not use is accepted, an unknown one is a TypeError. So is a state (q, u) left out
    that the scene uses (psi, phi, A and project: that its constraints use); other inputs left out take their default
    (references) or zero (t, tau, y). Functions that are not a scene's own (S for a controls-involved scene, say) are
    AttributeErrors. Matrices have shape (rows, columns), vectors (rows,); NaN where the code leaves outputs untouched.

    Each function has another for N states at once, `control_batch`, `S_batch`, ...: inputs have shape (N, size), or
    (size,) where all states share them, and parameters likewise; results have N in front.
    """

    def __init__(self, scene: Scene, scalar: Scalar) -> None:
        self.scene = scene
        self.scalar = scalar
        self.dtype = np.dtype(scalar)
        self._controls = scene.controls  # here, for CasADi takes longer to tell than a control takes
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
        everything = {n: values.get(n, np.array(f.default)) for n, f in fields.items()}
        status = self._prepare(everything)
        if status >= 0:
            self._prepared = everything
        return status

    def __repr__(self) -> str:
        inputs = ", ".join(f"{f.name} ({f.size})" for f in self.scene.input_fields())
        parameters = ", ".join(f.name for f in self.scene.parameters) or "none"
        kind = type(self).__name__
        return f"<{kind} of {self.scene.name!r}, {self.scalar}: inputs {inputs}; parameters {parameters}>"

    def __getattr__(self, name: str) -> Any:
        """The functions that this kind of scene has beside pinv and control, with their docstrings."""
        quantity = name.removesuffix("_batch")
        if quantity in _QUANTITIES:
            if quantity in self.scene.system.quantities:
                return self._function_of(name) if name == quantity else self._batch_of(quantity)
            raise AttributeError(f"scene {self.scene.name!r} has no {name}; its kind is {self.scene.kind}")
        moving = {"project": self._project_, "step": self._step_}
        moving |= {"project_batch": self._project_batch_, "step_batch": self._step_batch_}
        if name in moving and self.scene.system.tau_is_state:
            return moving[name]
        raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")

    def __dir__(self) -> list[str]:
        names = [*self.scene.system.quantities, *(["project", "step"] if self.scene.system.tau_is_state else [])]
        return [*super().__dir__(), *names, *(f"{n}_batch" for n in names)]

    def _function_of(self, name: str) -> Callable[..., FloatArray]:
        def quantity(**inputs: Any) -> FloatArray:
            return self._evaluate(name, self._read(inputs, name))

        quantity.__name__, quantity.__doc__ = name, _QUANTITIES[name]
        return quantity

    def _batch_of(self, name: str) -> Callable[..., FloatArray]:
        def quantities(*, threads: int | None = None, **arrays: Any) -> FloatArray:
            return self._evaluate_batch(name, self.read_batch(arrays, name), threads)

        quantities.__name__ = f"{name}_batch"
        quantities.__doc__ = f"At N states, the first axis of what is returned: {_QUANTITIES[name]}"
        return quantities

    def _project_(self, *, last: Any = None, **inputs: Any) -> Control:
        """The tau nearest to the given one with phi = 0."""
        return self._control("project", self._read(inputs, "project"), self._last(last))

    def _step_(self, dt: float, *, last: Any = None, **inputs: Any) -> Control:
        """tau advanced by dt (seconds) along tau', then projected onto phi = 0."""
        return self._control("step", self._read(inputs, "step"), self._last(last), float(dt))

    def _project_batch_(self, *, last: Any = None, threads: int | None = None, **arrays: Any) -> Batch:
        """`project` at N states."""
        return self._answers("project", arrays, last, threads)

    def _step_batch_(self, dt: float, *, last: Any = None, threads: int | None = None, **arrays: Any) -> Batch:
        """`step` by one dt at N states."""
        return self._answers("step", arrays, last, threads, float(dt))

    def pinv(self, matrix: Any) -> FloatArray:
        """The Moore-Penrose inverse (l, m) of a matrix (m, l) of the scene's shape; NaN where it was refused."""
        shape = self.scene.system_shape
        array = np.asarray(matrix, dtype=float)
        if array.shape != shape:
            raise ValueError(f"pinv: the matrix has shape {array.shape}; this scene's are {shape}")
        return self._pinv(array)[0]

    def control(self, *, last: Any = None, **inputs: Any) -> Control:
        """tau (tau' for controls-involved scenes); `last`, or zeros, where the status is negative."""
        return self._control("control", self._read(inputs, "control"), self._last(last))

    def control_batch(self, *, last: Any = None, threads: int | None = None, **arrays: Any) -> Batch:
        """`control` at N states: the same bits as one by one, whatever the number of threads (None: one a core).

        Inputs: (N, size), or (N,) of one number; (size,) where all states share it. Parameters may be given likewise,
        and hold for this call alone: each state is then prepared, those left out as they were prepared last. Arrays of
        the twin's type whose rows lie together are read where they are. last: (l,) or (N, l).
        """
        return self._answers("control", arrays, last, threads)

    def _answers(
        self, entry: str, arrays: dict[str, Any], last: Any, threads: int | None, dt: float | None = None
    ) -> Batch:
        states = self.read_batch(arrays, entry)
        shape = (states.count, self._controls)
        value = np.zeros(shape, self.dtype)
        if last is not None:
            given = np.asarray(last, dtype=float)
            if given.shape not in (shape, shape[1:]):
                raise ValueError(f"last has shape {given.shape}; it must have {shape[1:]} or {shape}")
            value[:] = given
        return self._control_batch(entry, states, value, threads, dt)

    def read_batch(self, arrays: dict[str, Any], function: str) -> States:
        """The states of a batch. TypeError where a state that the function needs is missing, or a name is unknown."""
        self._refuse_missing(arrays, function)
        known = ("q", "u", "t", "tau", "y")
        return read_states(arrays, self._fields, known, self._prepared, self.dtype, f"{function}_batch")

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
        self._refuse_missing(values, function)
        return {n: values.get(n, np.array(f.default)) for n, f in fields.items()}

    def _read(self, given: dict[str, Any], function: str) -> Any:
        """Inputs as this twin's functions take them."""
        return self.read_inputs(given, function)

    def _refuse_missing(self, given: dict[str, Any], function: str) -> None:
        missing = [f"{n} ({self._fields[n].text})" for n in self._needed(function) if n not in given]
        if missing:
            told, verb = " and ".join(missing), "are" if missing[1:] else "is"
            raise TypeError(
                f"{function}: {told} of scene {self.scene.name!r} {verb} left out; give every state by keyword"
            )

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
        if last is None:
            return np.zeros(self._controls, self.dtype)
        return _sized(last, self._controls, "last").astype(self.dtype)

    @abstractmethod
    def _prepare(self, parameters: dict[str, FloatArray]) -> Status: ...

    @abstractmethod
    def _pinv(self, matrix: FloatArray) -> tuple[FloatArray, Info]: ...

    @abstractmethod
    def _control(self, entry: str, inputs: Any, last: FloatArray, dt: float = 0.0) -> Control: ...

    @abstractmethod
    def _evaluate(self, name: str, inputs: Any) -> FloatArray: ...

    @abstractmethod
    def _control_batch(
        self, entry: str, states: States, value: FloatArray, threads: int | None, dt: float | None
    ) -> Batch: ...

    @abstractmethod
    def _evaluate_batch(self, name: str, states: States, threads: int | None) -> FloatArray: ...


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
