"""From what a user may write (numbers, lists, numpy, DM, SX) to SX of a checked shape."""

from typing import Any

import casadi as ca
import numpy as np

from servogen.errors import SceneError
from servogen.scene.calls import without_calls

MX_REMEDY = "make the symbols with ca.SX.sym, or call f.expand() of a ca.Function f with SX symbols"


def to_sx(value: Any, what: str) -> Any:
    """SX of `value`, finite where it is numeric; SceneError naming `what` otherwise."""
    if isinstance(value, ca.MX):
        raise SceneError(f"{what} is CasADi MX; use SX: {MX_REMEDY}")
    if value is None:
        raise SceneError(f"{what} is None; give a number, an array or CasADi SX")
    if _holds_sx(value):
        raise SceneError(f"{what} is a {type(value).__name__} of SX; join it with ca.vertcat(...) and ca.horzcat(...)")
    if isinstance(value, ca.Function):
        raise SceneError(f"{what} is a CasADi Function; call it with the scene's symbols, and give what it returns")
    if isinstance(value, str):
        raise SceneError(f"{what}: cannot read str as a CasADi SX expression")
    try:
        sx = value if isinstance(value, ca.SX) else ca.SX(ca.DM(np.asarray(value, dtype=float)))
    except (TypeError, ValueError, NotImplementedError, RuntimeError):
        try:
            sx = ca.SX(value)
        except (TypeError, ValueError, NotImplementedError, RuntimeError):
            raise SceneError(f"{what}: cannot read {type(value).__name__} as a CasADi SX expression") from None
    elements: list[Any] = sx.nonzeros()
    for element in elements:
        if element.is_constant() and not np.isfinite(float(element)):
            raise SceneError(f"{what} has an entry {float(element)}; give finite numbers")
    return without_calls(sx, what)


def _holds_sx(value: Any) -> bool:
    """Whether a list or an array has SX among its entries: numpy would read a symbol as NaN."""
    if isinstance(value, np.ndarray):
        value = list(value.ravel()) if value.dtype == object else []
    return isinstance(value, list | tuple) and any(isinstance(x, ca.SX) or _holds_sx(x) for x in value)


def column(value: Any, what: str, size: int | None = None) -> Any:
    """A column of `size` (any, if None); a row is turned."""
    sx = to_sx(value, what)
    if sx.size2() != 1 and sx.size1() == 1:
        sx = sx.T
    if sx.size2() != 1 or (size is not None and sx.size1() != size):
        wanted = f"a column of {size}" if size is not None else "a column"
        raise SceneError(f"{what} has shape {shape_text(sx)}; it must be {wanted}")
    return sx


def rates(value: Any, what: str, size: int) -> Any:
    """One number, or a column of `size`; none of the numbers below zero."""
    sx = to_sx(value, what)
    sx = sx if sx.numel() == 1 else column(sx, what, size)
    for element in sx.nonzeros():
        if element.is_constant() and float(element) < 0:
            raise SceneError(f"{what} has an entry {float(element)}; give numbers of 0 and above")
    return sx


def matrix(value: Any, what: str, rows: int, columns: int, why: str) -> Any:
    """A matrix of exactly rows x columns."""
    sx = to_sx(value, what)
    if sx.shape != (rows, columns):
        raise SceneError(f"{what} has shape {shape_text(sx)}; it must be {rows}x{columns} ({why})")
    return sx


def is_identity(sx: Any) -> bool:
    """Whether SX is square with ones and zeros as they are written."""
    n = sx.size1()
    entries = [(i, j) for i in range(n) for j in range(n)]
    return n == sx.size2() and all(sx[i, j].is_one() if i == j else sx[i, j].is_zero() for i, j in entries)


def symbols(value: Any, what: str) -> Any:
    """A column of distinct SX symbols."""
    if isinstance(value, ca.MX):
        raise SceneError(f"{what} must be SX symbols, not MX; use SX: {MX_REMEDY}")
    if _holds_sx(value):
        raise SceneError(f"{what} is a {type(value).__name__} of SX; join it with ca.vertcat(...)")
    if not isinstance(value, ca.SX):
        raise SceneError(f"{what} must be SX symbols, as from ca.SX.sym({what!r}, n); got {type(value).__name__}")
    sx = column(value, what)
    if sx.size1() == 0:
        raise SceneError(f"{what} is empty; give at least one symbol")
    if not sx.is_valid_input():
        raise SceneError(f"{what} must consist of SX symbols only, not of expressions")
    if len({e.__hash__() for e in sx.nonzeros()}) != sx.size1():
        raise SceneError(f"{what} holds a symbol twice; every entry must be a symbol of its own")
    return sx


def shape_text(sx: Any) -> str:
    return f"{sx.size1()}x{sx.size2()}"
