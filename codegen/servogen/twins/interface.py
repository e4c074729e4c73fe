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
from servogen.scene.system import SYSTEMS, Function


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
        if not any(system.function(name) for system in SYSTEMS.values()):
            raise AttributeError(f"{type(self).__name__} has no attribute {name!r}")
        offered = self.scene.system.function(name)
        if offered is None:
            raise AttributeError(f"scene {self.scene.name!r} has no {name}; its kind is {self.scene.kind}")
        return self._answering(offered) if offered.controls else self._evaluating(offered)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *(f.name for f in self.scene.system.functions)]

    def _evaluating(self, offered: Function) -> Callable[..., FloatArray]:
        def quantity(**inputs: Any) -> FloatArray:
            return self._evaluate(offered.name, self.read_inputs(inputs, offered.name))

        quantity.__name__, quantity.__doc__ = offered.name, offered.text
        return quantity

    def _answering(self, offered: Function) -> Callable[..., Control]:
        def answer(*given: float, last: Any = None, **inputs: Any) -> Control:
            named = dict(zip(offered.arguments, given, strict=False))
            named |= {n: inputs.pop(n) for n in offered.arguments[len(given) :] if n in inputs}
            if len(named) < len(offered.arguments) or len(given) > len(offered.arguments):
                wanted = ", ".join(offered.arguments) or "no number"
                raise TypeError(f"{offered.name} takes {wanted} before the inputs, which go by keyword")
            numbers = [float(named[n]) for n in offered.arguments]
            return self._control(offered.name, self.read_inputs(inputs, offered.name), self._last(last), *numbers)

        answer.__name__, answer.__doc__ = offered.name, offered.text
        return answer

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
        offered = self.scene.system.function(function)
        return self._states["constraints" if offered is not None and offered.of_constraints else "scene"]

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
    def _control(self, entry: str, inputs: dict[str, FloatArray], last: FloatArray, *numbers: float) -> Control: ...

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
