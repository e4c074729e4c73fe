"""Polylines as a scene's file writes them, and what is said of those that are none."""

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.scene.polylines import polylines

q = ca.SX.sym("q", 3)


def test_points_are_lists_columns_or_a_matrix() -> None:
    lines = polylines([[[0, q[0]], q[:2], np.array([1.0, 2.0])], ca.horzcat(q[:2], q[1:]), [q[:2]]], "drawing")
    assert [line.shape for line in lines] == [(2, 3), (2, 2), (2, 1)]
    value = ca.Function("f", [q], [lines[0]])([5.0, 6.0, 7.0])
    assert np.array_equal(np.array(value), [[0, 5, 1], [5, 6, 2]])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (q, "drawing is a SX; give a list of polylines"),
        ([[q[0], q[1]]], r"drawing\[0\]\[0\] has shape 1x1; a point has 2 or 3 entries"),
        ([[q[:2]], [q]], "points of 2 and of 3 entries"),
        ([[]], r"drawing\[0\] is empty"),
        ([ca.SX.eye(4)], r"drawing\[0\] has shape 4x4"),
        ([[[0, None]]], r"drawing\[0\]\[0\] is None"),
        ([[ca.MX.sym("a", 2)]], "CasADi MX"),
    ],
)
def test_what_is_no_polyline_is_named(given: object, words: str) -> None:
    with pytest.raises(sg.SceneError, match=words):
        polylines(given, "drawing")
