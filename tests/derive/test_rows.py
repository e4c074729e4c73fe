"""Outputs that stand behind other rows: a crane whose two controls pull one rope, from generated C in closed loop."""

import dataclasses

import numpy as np
import pytest
import servogen as sg
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.trajectory import Trajectory
from support.high_degree import crane_of_degrees, crane_path

pytestmark = pytest.mark.xdist_group("crane")  # one loop is built for all of them

REFERENCES = {"x": crane_path, "z": lambda t: 4 + crane_path(t)}
DOMAIN = {"q": ([-2.0, 30.0, -0.6], [2.0, 60.0, 0.6]), "u": (-20.0, 20.0)}


@pytest.fixture(scope="module")
def loop() -> ClosedLoop:
    start = {"q": [0.0, 40.0, 0.0], "u": [0.0, 0.0, 0.0]}
    simulation = sg.Simulation(start=start, duration=6.0, step=2e-3, references=REFERENCES, domain=DOMAIN)
    return ClosedLoop(crane_of_degrees(2, 4), simulation)


@pytest.fixture(scope="module")
def on_the_path(loop: ClosedLoop) -> Trajectory:
    return loop.run()


def test_force_and_torque_along_the_path(on_the_path: Trajectory) -> None:
    """The exact solution of Altmann and Heiland (2017)."""
    run = on_the_path
    at = np.searchsorted(run.t, [1.5 - 1e-9, 3.0 - 1e-9])
    np.testing.assert_allclose(run.tau[at], [[25.264559, -95.571060], [-0.252211, -98.080141]], atol=6e-7)
    most = int(np.argmax(run.tau[:, 0]))
    assert run.tau[most, 0] == pytest.approx(36.0179, abs=6e-5)
    assert run.t[most] == pytest.approx(2.05, abs=5e-3)


def test_the_load_stays_on_the_path(on_the_path: Trajectory) -> None:
    assert on_the_path.verdict.word == "held"
    assert np.abs(on_the_path.constraint).max() < 1e-6


def test_a_start_off_the_path_decays_as_prescribed(loop: ClosedLoop) -> None:
    """0.1 m aside and 0.1 m too deep: (1 + 2 t) exp(-2 t) of the height, with (2 t)^k / k! to k = 3 of the place."""
    run = loop.run(start={"q": [0.1, 41.0, 0.0], "u": [0.0, 0.0, 0.0]})
    x = 2 * run.t
    height, place = (np.array([1, 1]), np.array([1, 1, 1 / 2, 1 / 6]))
    for k, series in enumerate((height, place)):
        # x'' and x''' are zero at the start, for the rope hangs down: so they are whatever the height does
        expected = 0.1 * np.exp(-x) * sum(c * x**n for n, c in enumerate(series))
        np.testing.assert_allclose(run.constraint[:, k], expected, atol=1e-7)
    assert run.verdict.word == "held"


def test_textbook_and_code_agree(loop: ClosedLoop) -> None:
    scene = loop.scene
    given = {"q": [0.2, 43.0, 0.1], "u": [0.3, -0.5, 0.2], "x": 0.3, "z": 4.1, "x_d4": 0.2, "z_d3": -0.3}
    code, textbook = sg.build(scene).load(flags=["-O0"]), sg.reference(scene)
    for quantity in ("S", "z", "psi"):
        np.testing.assert_allclose(getattr(code, quantity)(**given), getattr(textbook, quantity)(**given), rtol=1e-9)
    np.testing.assert_allclose(code.control(**given).value, textbook.control(**given).value, rtol=1e-9)


def test_what_cannot_stand_behind() -> None:
    with pytest.raises(sg.SceneError, match=r"constraint 'place'.* its row of S is identically zero"):
        sg.build(crane_of_degrees(2, 3))
    with pytest.raises(sg.SceneError, match=r"constraint 'place': Theta has 5 entries.* 4th derivative already, even"):
        sg.build(crane_of_degrees(2, 5))
    scene = crane_of_degrees(2, 4)
    for changes, word in (
        ({"constraints": [scene.constraints[0], dataclasses.replace(scene.constraints[1], priority=1)]}, "priorities"),
        ({"limits": sg.Limits(-1e3, 1e3, policy="keep_direction")}, "limits of policy 'keep_direction'"),
    ):
        with pytest.raises(sg.SceneError, match=f"constraint 'place'.* leave out {word}"):
            sg.build(dataclasses.replace(scene, **changes))
