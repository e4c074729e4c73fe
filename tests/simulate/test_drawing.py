"""The motion of a drawing: its points are those of the rows, moving references and parameters included."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.drawing import LEAST_FRAMES, motion_of
from servogen.simulate.simulation import check_simulation


def test_points_along_a_run(rail_loop: ClosedLoop) -> None:
    scene = rail_loop.scene
    x, r = scene.mechanism.q, scene.references.r
    drawing = [[[0, 0], [x, scene.parameters.m]], [[r, 1]]]
    moving = replace(rail_loop.simulation, drawing=drawing, references={"r": lambda t: ca.sin(t)}, stop={})
    run = ClosedLoop(scene, moving).run(duration=0.5, parameters={"m": 4.0})
    motion = motion_of(scene, moving, run)
    assert len(motion.t) == LEAST_FRAMES
    assert (motion.t[0], motion.t[-1]) == (0.0, 0.5)
    link, mark = motion.lines
    assert np.array_equal(link[:, 0], np.zeros((LEAST_FRAMES, 2)))
    assert np.array_equal(link[:, 1, 0], run.q[np.searchsorted(run.t, motion.t), 0])
    assert np.all(link[:, 1, 1] == 4.0)
    assert np.allclose(mark[:, 0], np.stack([np.sin(motion.t), 1 + 0 * motion.t], axis=1), rtol=0, atol=1e-12)


def test_nothing_is_drawn_of_what_nobody_drew(rail_loop: ClosedLoop) -> None:
    assert motion_of(rail_loop.scene, rail_loop.simulation, rail_loop.run(duration=0.01)) is None


def test_a_drawing_is_of_the_scene(rail_loop: ClosedLoop) -> None:
    other = replace(rail_loop.simulation, drawing=[[[ca.SX.sym("z"), 0]]])
    with pytest.raises(sg.SceneError, match=r"drawing\[0\] holds the symbol 'z'"):
        check_simulation(rail_loop.scene, other)
