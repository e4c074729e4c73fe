"""Integration methods and margins of the closed loop."""

from dataclasses import replace

import numpy as np
import pytest
import servogen as sg
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.methods import measure, tight_end
from servogen.simulate.wanted import load_simulation


@pytest.fixture(scope="module")
def free_y() -> ClosedLoop:
    return ClosedLoop(*load_simulation("double_pendulum_energy_free_y"))


def test_the_higher_method_has_order_eight(free_y: ClosedLoop) -> None:
    end = free_y.run(duration=2.0, step=2.5e-3, method="dop8").q[-1]
    errors = [np.max(np.abs(free_y.run(duration=2.0, step=h, method="dop8").q[-1] - end)) for h in (0.04, 0.02)]
    assert 6.5 < np.log2(errors[0] / errors[1]) < 10.0
    fourth = np.max(np.abs(free_y.run(duration=2.0, step=0.02, method="rk4").q[-1] - end))
    assert errors[1] < 1e-2 * fourth


def test_the_textbook_reference_under_dop853_ends_where_the_code_does(free_y: ClosedLoop) -> None:
    found = free_y.run(duration=1.0, step=2.5e-3)
    end = tight_end(free_y.scene, free_y.simulation, 1.0, found)
    assert np.max(np.abs(np.concatenate([found.q[-1], found.u[-1]]) - end)) < 1e-9


def test_precision_falls_with_the_step(free_y: ClosedLoop) -> None:
    points = measure(free_y.scene, free_y.simulation, 0.5, (0.02, 0.01), ("float64",))
    assert {p.method for p in points} == {"rk4", "dop8"}
    for method in ("rk4", "dop8"):
        errors = [p.error for p in points if p.method == method]
        assert errors[1] < errors[0] / 8
    assert all(p.seconds > 0 for p in points)


def test_margins_end_a_run_with_their_reason() -> None:
    scene, simulation = load_simulation("double_pendulum_energy")
    found = ClosedLoop(scene, replace(simulation, tau_max=8.0)).run()
    assert found.stop.event == "|tau| > 8"
    assert np.max(np.abs(found.tau[-1])) > 8.0
    assert np.max(np.abs(found.tau[:-1])) <= 8.0
    found = ClosedLoop(scene, replace(simulation, sigma_min=0.5, stop={})).run()
    assert found.stop.event == "sigma_min <= 0.5"
    assert found.sigma_min[-1] <= 0.5 < found.sigma_min[:-1].min()


def test_errors() -> None:
    for wrong, words in (
        ({"method": "euler"}, "choose rk4 or dop8"),
        ({"tau_max": -1.0}, "positive"),
        ({"sigma_min": np.nan}, "positive"),
    ):
        with pytest.raises(sg.SceneError, match=words):
            sg.Simulation(**wrong)  # type: ignore[arg-type]
