"""Polylines of points in the plane or in space, as SX."""

from collections.abc import Sequence
from typing import Any

import casadi as ca

from servogen.errors import SceneError
from servogen.scene.convert import to_sx


def polylines(given: Any, what: str) -> tuple[Any, ...]:
    """Each polyline as SX of d x k, its k points as columns; d is 2 or 3, the same for all.

    given: polylines, each a list of points (SX or numbers, 2 or 3 entries) or a matrix with points as columns.
    SceneError naming `what` otherwise.
    """
    if not isinstance(given, list | tuple):
        raise SceneError(f"{what} is a {type(given).__name__}; give a list of polylines, each a list of points")
    lines = tuple(_polyline(line, f"{what}[{k}]") for k, line in enumerate(given))
    if len({line.size1() for line in lines}) > 1:
        raise SceneError(f"{what} has points of 2 and of 3 entries; draw all in the plane or all in space")
    return lines


def _polyline(given: Any, what: str) -> Any:
    if not isinstance(given, list | tuple):
        line = to_sx(given, what)
        if line.size1() not in (2, 3):
            raise SceneError(
                f"{what} has shape {line.size1()}x{line.size2()}; its columns are points of 2 or 3 entries"
            )
        return ca.densify(line)
    if not given:
        raise SceneError(f"{what} is empty; give at least one point")
    return ca.horzcat(*(_point(point, f"{what}[{k}]") for k, point in enumerate(given)))


def _point(given: Any, what: str) -> Any:
    entries: Sequence[Any] = given if isinstance(given, list | tuple) else [given]
    point = ca.vertcat(*(to_sx(entry, what) for entry in entries))
    if point.size2() != 1 or point.size1() not in (2, 3):
        shape = f"{point.size1()}x{point.size2()}"
        raise SceneError(f"{what} has shape {shape}; a point has 2 or 3 entries, and a polyline is a list of points")
    return ca.densify(point)
