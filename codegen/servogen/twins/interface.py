"""What every twin of a scene offers (python.md: The Python side), and the reading of its keywords."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from servogen.errors import SceneError
from servogen.results import STATUS_MEANING, Batch, Control, FloatArray, Info, Status
from servogen.scalars import Scalar
from servogen.scene.constraints import expression_of
from servogen.scene.limits import INPUTS
from servogen.scene.scene import Scene, expressions
from servogen.scene.symbols import Field
from servogen.scene.system import PASSIVE, SYSTEMS, Function
from servogen.twins.batch import States, check_threads, read_states


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
        one = name.removesuffix("_batch")
        if not any(one == f.name for system in SYSTEMS.values() for f in (*system.functions, *PASSIVE)):
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        offered = self.scene.system.function(one)
        if offered is None:
            passive = any(one == f.name for f in PASSIVE)
            why = "its mechanism has no passive constraints" if passive else f"its kind is {self.scene.kind}"
            raise AttributeError(f"scene {self.scene.name!r} has no {name}; {why}")
        if one != name:
            return self._batch_of(offered)
        return self._answering(offered) if offered.controls else self._evaluating(offered)

    def __dir__(self) -> list[str]:
        names = [f.name for f in self.scene.system.functions]
        return [*super().__dir__(), *names, *(f"{n}_batch" for n in names)]

    def _evaluating(self, offered: Function) -> Callable[..., FloatArray]:
        def quantity(**inputs: Any) -> FloatArray:
            return self._evaluate(offered.name, self._read(inputs, offered.name))

        quantity.__name__, quantity.__doc__ = offered.name, offered.text
        return quantity

    def _answering(self, offered: Function) -> Callable[..., Control]:
        def answer(*given: float, last: Any = None, **inputs: Any) -> Control:
            numbers = _numbers(offered, given, inputs)
            return self._control(offered.name, self._read(inputs, offered.name), self._last(last), *numbers)

        answer.__name__, answer.__doc__ = offered.name, offered.text
        return answer

    def _batch_of(self, offered: Function) -> Callable[..., Any]:
        def answers(*given: float, last: Any = None, threads: int | None = None, **arrays: Any) -> Batch:
            numbers = _numbers(offered, given, arrays)
            return self._answers(offered.name, arrays, last, threads, *numbers)

        def quantities(*, threads: int | None = None, **arrays: Any) -> FloatArray:
            check_threads(threads)
            return self._evaluate_batch(offered, self._read_batch(arrays, offered.name), threads)

        function: Callable[..., Any] = answers if offered.controls else quantities
        function.__name__ = f"{offered.name}_batch"
        function.__doc__ = f"At N states, the first axis of what is returned: {offered.text}"
        return function

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

    def _answers(self, entry: str, arrays: dict[str, Any], last: Any, threads: int | None, *numbers: float) -> Batch:
        check_threads(threads)
        states = self._read_batch(arrays, entry)
        shape = (states.count, self._controls)
        value = np.zeros(shape, self.dtype)
        if last is not None:
            given = np.asarray(last, dtype=float)
            if given.shape not in (shape, shape[1:]):
                raise ValueError(f"last has shape {given.shape}; it must have {shape[1:]} or {shape}")
            value[:] = given
        return self._control_batch(entry, states, value, threads, *numbers)

    def _read_batch(self, arrays: dict[str, Any], function: str) -> States:
        """The states of a batch. TypeError where a state that the function needs is missing, or a name is unknown."""
        self._refuse_missing(arrays, function)
        return read_states(arrays, self._fields, self._sizes, self._prepared, self.dtype, f"{function}_batch")

    @cached_property
    def _fields(self) -> dict[str, Field]:
        """Every input of the scene by name; kept, for a controller is called at each tick."""
        return {f.name: f for f in self.scene.input_fields()}

    @cached_property
    def _sizes(self) -> dict[str, int]:
        """Every name that a state may be given by, those that this scene does not use among them."""
        l = self.scene.controls
        return {"q": 0, "u": 0, "t": 1, "tau": l, "y": l} | {n: f.size for n, f in self._fields.items()}

    def read_inputs(self, given: dict[str, Any], function: str = "control") -> dict[str, FloatArray]:
        """Every input of the scene as an array (size,). TypeError where a state that the function needs is missing."""
        scene, fields, sizes = self.scene, self._fields, self._sizes
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
        """Those of q and u without which a function has no meaning, and limits that are inputs."""
        offered = self.scene.system.function(function)
        states = self._states["constraints" if offered is not None and offered.of_constraints else "scene"]
        limits = tuple(n for n in INPUTS.values() if function == "control" and n in self._fields)
        return states + limits

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
    def _control(self, entry: str, inputs: Any, last: FloatArray, *numbers: float) -> Control: ...

    @abstractmethod
    def _evaluate(self, name: str, inputs: Any) -> FloatArray: ...

    @abstractmethod
    def _control_batch(
        self, entry: str, states: States, value: FloatArray, threads: int | None, *numbers: float
    ) -> Batch: ...

    @abstractmethod
    def _evaluate_batch(self, offered: Function, states: States, threads: int | None) -> FloatArray: ...


def _numbers(offered: Function, given: tuple[float, ...], inputs: dict[str, Any]) -> list[float]:
    """The numbers that a function takes before the inputs, by place or by keyword; taken out of the latter."""
    named = dict(zip(offered.arguments, given, strict=False))
    named |= {n: inputs.pop(n) for n in offered.arguments[len(given) :] if n in inputs}
    if len(named) < len(offered.arguments) or len(given) > len(offered.arguments):
        wanted = ", ".join(offered.arguments) or "no number"
        raise TypeError(f"{offered.name} takes {wanted} before the inputs, which go by keyword")
    return [float(named[n]) for n in offered.arguments]


def finite(values: Any) -> bool:
    """No NaN and no infinity in any array of a mapping's values."""
    return all(math.isfinite(x) for v in values for x in np.ravel(v))


def _sized(value: Any, size: int, name: str) -> FloatArray:
    try:
        if value is None or np.iscomplexobj(value):
            raise TypeError
        array = np.atleast_1d(np.asarray(value, dtype=float)).ravel()
    except (TypeError, ValueError, RuntimeError):
        raise ValueError(f"{name} = {value!r}; give {'a number' if size == 1 else f'{size} numbers'}") from None
    if array.size != size:
        raise ValueError(f"{name} has {array.size} entries; it must have {size}")
    return array
