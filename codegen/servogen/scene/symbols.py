"""Runtime parameters and references: named SX symbols with defaults, units and texts."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from servogen.errors import SceneError
from servogen.scene.names import check_field_name

Value = float | Sequence[float]


@dataclass(frozen=True)
class Parameter:
    """Default (a number, or a list for a column), unit and meaning of one runtime parameter."""

    default: Value
    unit: str = ""
    text: str = ""

    def __post_init__(self) -> None:
        _check_words(self.unit, self.text, "sg.Parameter")


@dataclass(frozen=True)
class Ref:
    """Default of a set-point, and the number of its time derivatives that are inputs as well (0, 1, 2, ...)."""

    default: Value
    order: int = 0
    unit: str = ""
    text: str = ""

    def __post_init__(self) -> None:
        if isinstance(self.order, bool) or not isinstance(self.order, int) or self.order < 0:
            raise SceneError(f"sg.Ref(order={self.order!r}): give 0, 1, 2, ..., the number of rates that are inputs")
        _check_words(self.unit, self.text, "sg.Ref")


@dataclass(frozen=True, eq=False)
class Field:
    """One named input of a scene: its symbol (a column of `size`) and its default."""

    name: str
    symbol: Any
    default: tuple[float, ...]
    unit: str = ""
    text: str = ""

    @property
    def size(self) -> int:
        return len(self.default)


def _table(kind: str, fields: Iterable[Field]) -> str:
    """As a notebook shows them (Markdown)."""
    rows = [f"| `{f.name}` | {_numbers(f)} | {f.unit} | {f.text.replace('|', '&#124;')} |" for f in fields]
    return "\n".join([f"| {kind} | default | unit | meaning |", "|---|---|---|---|", *rows])


def _summary(kind: str, fields: Iterable[Field]) -> str:
    said = (f"{f.name}={_numbers(f)}" + (f" {f.unit}" if f.unit else "") for f in fields)
    return f"{kind}({', '.join(said)})"


def _numbers(field: Field) -> str:
    numbers = ", ".join(f"{x:g}" for x in field.default)
    return numbers if field.size == 1 else f"[{numbers}]"


def derivative_name(name: str, k: int) -> str:
    """Of the input that is a k-th derivative: r, r_dot, r_ddot, r_d3, r_d4 and so on."""
    return name + ("", "_dot", "_ddot")[k] if k < 3 else f"{name}_d{k}"


def derived(symbol: str, k: int) -> str:
    """The name of a k-th time derivative: psi, psi', psi'', psi''', psi^(4) and so on."""
    return f"{symbol}^({k})" if k > 3 else symbol + "'" * k


def _check_words(unit: object, text: object, what: str) -> None:
    for word, value in (("unit", unit), ("text", text)):
        if not isinstance(value, str):
            raise SceneError(f"{what}({word}={value!r}): give text")


def _default(value: object, what: str) -> tuple[float, ...]:
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise SceneError(f"{what}: the default {value!r} is neither a number nor a list of numbers") from None
    if array.ndim > 1 and 1 not in array.shape:
        raise SceneError(f"{what}: the default has shape {array.shape}; give a number or a list (a column)")
    flat = tuple(float(x) for x in array.ravel())
    if not flat:
        raise SceneError(f"{what}: the default is empty; give a number or a list of numbers")
    if not all(math.isfinite(x) for x in flat):
        raise SceneError(f"{what}: the default {value!r} is not finite; give finite numbers")
    return flat


class Parameters:
    """Runtime parameters with defaults: `Parameters(m=1.0, L=Parameter(1.2, "m", "length"), k=[1, 2, 3])`.

    Each is an SX symbol as an attribute (a column where the default is a list), a field of `<prefix>_params` in C and
    a keyword of a twin's `prepare`.
    """

    def __init__(self, **defaults: Value | Parameter) -> None:
        self._fields: dict[str, Field] = {}
        for name, given in defaults.items():
            check_field_name(name, "parameter")
            parameter = given if isinstance(given, Parameter) else Parameter(given)
            default = _default(parameter.default, f"parameter {name!r}")
            self._fields[name] = Field(name, ca.SX.sym(name, len(default)), default, parameter.unit, parameter.text)

    def __getattr__(self, name: str) -> Any:
        fields: dict[str, Field] = self.__dict__.get("_fields", {})
        if name in fields:
            return fields[name].symbol
        raise AttributeError(f"no parameter {name!r}; there are {', '.join(fields) or 'none'}")

    def __repr__(self) -> str:
        return _summary("Parameters", self)

    def _repr_markdown_(self) -> str:
        return _table("parameter", self)

    def __iter__(self) -> Iterator[Field]:
        return iter(self._fields.values())


@dataclass(frozen=True, eq=False)
class Reference:
    """A set-point r with the derivatives that are inputs: `chain` is (r, r', r'', ...)."""

    chain: tuple[Field, ...]

    @property
    def order(self) -> int:
        return len(self.chain) - 1


class References:
    """Set-points at run time: `References(E_0=0.0, r=Ref([0.3, 0.4], order=2))`.

    `ref.r` and as many rates as its order, `ref.r_dot`, `ref.r_ddot`, `ref.r_d3`, `ref.r_d4` and so on, are SX symbols
    and inputs of those names. A plain reference (order 0) has rate zero.
    """

    def __init__(self, **defaults: Value | Ref) -> None:
        self._references: dict[str, Reference] = {}
        self._fields: dict[str, Field] = {}
        for name, given in defaults.items():
            ref = given if isinstance(given, Ref) else Ref(given)
            default = _default(ref.default, f"reference {name!r}")
            chain = []
            for k in range(ref.order + 1):
                full = derivative_name(name, k)
                check_field_name(full, "reference")
                if full in self._fields:
                    raise SceneError(f"reference {full!r} collides with another reference's derivative; rename one")
                values = (0.0,) * len(default) if k else default
                unit = f"{ref.unit}/s" + (f"^{k}" if k > 1 else "") if k else ref.unit
                text = derived(name, k) if k else ref.text
                field = Field(full, ca.SX.sym(full, len(default)), values, unit if ref.unit else "", text)
                self._fields[full] = field
                chain.append(field)
            self._references[name] = Reference(tuple(chain))

    def __getattr__(self, name: str) -> Any:
        fields: dict[str, Field] = self.__dict__.get("_fields", {})
        if name in fields:
            return fields[name].symbol
        raise AttributeError(f"no reference {name!r}; there are {', '.join(fields) or 'none'}")

    def __repr__(self) -> str:
        return _summary("References", self)

    def _repr_markdown_(self) -> str:
        return _table("reference", self)

    def __iter__(self) -> Iterator[Field]:
        return iter(self._fields.values())


def chains(references: References) -> tuple[Reference, ...]:
    """The references with their derivatives, in the order given (a function: any attribute name is the user's)."""
    return tuple(references._references.values())
