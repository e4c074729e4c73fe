"""What the user may say about the limits of the controls, and how it is read."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, cast

import casadi as ca
import numpy as np

from servogen.errors import SceneError
from servogen.scene.convert import column, to_sx

INPUTS = {"lower": "tau_min", "upper": "tau_max"}
"""The inputs that stand for a side which is given as "input"."""


@dataclass(frozen=True)
class Limits:
    """lower <= tau <= upper, never a bit beyond.

    lower, upper: a number for all controls, or one entry per control: numbers, SX of parameters, references and the
        state (a torque-speed curve); -inf and inf: none. "input": the inputs tau_min and tau_max, in the units of tau.
    policy: what happens where the answer without limits is not admissible. "least_squares": of all admissible tau
        those that minimise |S tau - z|, of these the one nearest to y in the weight. "keep_direction": the error
        dynamics slow down, S tau = z_0 + s z_1 with z_1 the Theta terms of z and the largest s from 0 to 1 that is
        admissible; where none is, least squares at s = 0.
    Raises SceneError for another policy; sg.Scene does for limits that do not fit it.
    """

    lower: Any
    upper: Any
    policy: Literal["least_squares", "keep_direction"] = "least_squares"

    def __post_init__(self) -> None:
        if self.policy not in ("least_squares", "keep_direction"):
            raise SceneError(f"Limits(policy={self.policy!r}): choose 'least_squares' or 'keep_direction'")


@dataclass(frozen=True, eq=False)
class Side:
    """The limits on one side. expression: SX of one row per control, 0 where there is none; open: these controls."""

    expression: Any
    open: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Sides:
    """Limits as they were read: each side an expression, or "input"."""

    lower: Side | str
    upper: Side | str
    policy: str

    def each(self) -> Iterator[tuple[str, Side | str]]:
        """Both by name."""
        yield "lower", self.lower
        yield "upper", self.upper


def read_limits(limits: object, controls: int) -> Sides:
    """Limits as Sides. SceneError naming the side and the control where they make no sense."""
    if not isinstance(limits, Limits):
        raise SceneError(f"limits is a {type(limits).__name__}; give sg.Limits(lower, upper)")
    sides = Sides(_side(limits.lower, "lower", controls), _side(limits.upper, "upper", controls), limits.policy)
    if isinstance(sides.lower, Side) and isinstance(sides.upper, Side):
        for j in set(range(controls)) - {*sides.lower.open, *sides.upper.open}:
            low, high = sides.lower.expression[j], sides.upper.expression[j]
            if low.is_constant() and high.is_constant() and float(low) > float(high):
                raise SceneError(
                    f"limits: lower {float(low):g} of tau[{j}] is above upper {float(high):g}; no number lies between"
                )
    return sides


def _side(value: Any, side: str, controls: int) -> Side | str:
    what, none = f"limits: {side}", -np.inf if side == "lower" else np.inf
    if isinstance(value, str):
        if value != "input":
            raise SceneError(f"{what} is {value!r}; give numbers, SX, or 'input' for the input {INPUTS[side]}")
        return value
    if value is None:
        raise SceneError(f"{what} is None; give numbers, SX, 'input', or {none} for no limit")
    entries = _entries(value, what)
    if len(entries) == 1:
        entries = entries * controls
    if len(entries) != controls:
        raise SceneError(f"{what} has {len(entries)} entries; give one number, or one for each of {controls} controls")
    missing = tuple(j for j, x in enumerate(entries) if x.is_constant() and float(x) == none)
    for j, x in enumerate(entries):
        if x.is_constant() and j not in missing and not np.isfinite(float(x)):
            raise SceneError(f"{what} of tau[{j}] is {float(x)}; give a finite number, SX, or {none} for no limit")
    return Side(ca.vertcat(*(ca.SX(0) if j in missing else x for j, x in enumerate(entries))), missing)


def _entries(value: Any, what: str) -> list[Any]:
    """Scalar SX of what was given, infinities among them."""
    if isinstance(value, list | tuple) and any(isinstance(x, ca.SX) for x in value):
        return [entry for x in value for entry in _entries(x, what)]
    if isinstance(value, ca.SX):
        dense = ca.densify(value)
        if 1 not in dense.shape:
            raise SceneError(f"{what} has shape {dense.size1()}x{dense.size2()}; give a column, one row per control")
        return cast(list[Any], ca.vec(dense).nonzeros())
    try:
        numbers = np.asarray(value.full() if isinstance(value, ca.DM) else value, dtype=float)
    except (TypeError, ValueError, RuntimeError):
        return cast(list[Any], column(to_sx(value, what), what).nonzeros())  # which tells what is wrong with it
    if numbers.ndim > 1 and 1 not in numbers.shape:
        raise SceneError(f"{what} has shape {'x'.join(map(str, numbers.shape))}; give a list, one number per control")
    return [ca.SX(float(x)) for x in numbers.ravel()]
