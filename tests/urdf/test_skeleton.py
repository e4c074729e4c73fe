"""A robot's lines: every joint once, its points the links' origins."""

import casadi as ca
import numpy as np
import servogen as sg
from servogen.scenes.iiwa_position import END_EFFECTOR, ROBOT_FILE
from servogen.urdf.skeleton import chains


def test_the_points_are_the_frames() -> None:
    for base in ("fixed", "floating"):
        robot = sg.urdf.load(ROBOT_FILE, base=base, quiet=True)
        (line,) = robot.mechanism.skeleton
        assert line.size2() == len(robot.frames)
        both = ca.Function("f", [robot.q], [line, robot.position(END_EFFECTOR)])
        points, end = (np.array(x) for x in both(np.random.default_rng(3).normal(size=robot.q.size1())))
        assert np.allclose(points[:, -1:], end, rtol=0, atol=1e-12)


def test_branches_begin_where_they_leave() -> None:
    above = {"hip": "base", "foot": "hip", "arm": "base", "hand": "arm", "finger": "hand", "thumb": "hand"}
    assert list(chains(above)) == [
        ("base", "hip", "foot"), ("base", "arm", "hand", "finger"), ("hand", "thumb"),
    ]  # fmt: skip
