"""The drawing of a mechanism: what moves is data, what stands is a picture, space is seen from above its floor."""

import json
import xml.etree.ElementTree as ET

import numpy as np
from servogen.report.drawing import draw_motion
from servogen.simulate.drawing import Motion

T = np.linspace(0.0, 2.0, 21)


def points(element: ET.Element) -> list[list[float]]:
    return [[float(x) for x in pair.split(",")] for pair in element.get("points", "").split()]


def polylines(svg: str, kind: str) -> list[ET.Element]:
    return [e for e in ET.fromstring(svg).iter("polyline") if e.get("class") == kind]


def test_in_the_plane() -> None:
    arm = np.stack([np.zeros((21, 2)), np.stack([np.cos(T), np.sin(T)], axis=1)], axis=1)
    rail = np.tile([[-1.0, -0.5], [1.0, -0.5]], (21, 1, 1))
    drawing = draw_motion(Motion(T, (arm, rail, arm[:, 1:])), 'an "arm"', "m")
    assert ET.fromstring(drawing.svg).get("aria-label") == 'an "arm"'
    motion = json.loads(drawing.motion)
    assert motion["sizes"] == [2, 2]  # the arm, and its end as a mark; the rail stands still
    assert len(polylines(drawing.svg, "link still")) == 1
    assert drawing.grid == "0.5 m"
    assert drawing.seconds == 2.0
    ghosts = polylines(drawing.svg, "link")
    first, last = points(ghosts[0]), points(ghosts[-1])
    assert motion["poses"][0][:4] == [x for point in first for x in point]
    assert motion["poses"][-1][:4] == [x for point in last for x in point]
    (x0, y0), (x1, y1) = first
    length = x1 - x0  # at t = 0 it points to the right
    assert y0 == y1
    assert np.allclose(np.subtract(last[1], last[0]), [length * np.cos(2), -length * np.sin(2)], atol=0.2)


def test_in_space_z_points_upwards_and_the_floor_has_the_shadow() -> None:
    top = np.stack([np.cos(T), np.sin(T), 1 + 0 * T], axis=1)
    mast = np.stack([top * [1, 1, 0], top], axis=1)
    drawing = draw_motion(Motion(T, (mast,)), "a mast")
    foot, head = points(polylines(drawing.svg, "link")[-1])
    assert foot[0] == head[0]
    assert foot[1] > head[1]
    assert points(polylines(drawing.svg, "shadow")[-1]) == [foot, foot]


def test_what_does_not_move_is_drawn_once() -> None:
    still = np.tile([[0.0, 0.0], [1.0, 1.0]], (21, 1, 1))
    drawing = draw_motion(Motion(T, (still,)), "a stone")
    assert json.loads(drawing.motion)["sizes"] == []
    assert polylines(drawing.svg, "link") == []
    assert len(polylines(drawing.svg, "link still")) == 1
