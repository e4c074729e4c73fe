"""The closed loop inside an emulated board: the host's rows, bit for bit."""

from dataclasses import replace

import numpy as np
import pytest
import servogen as sg
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.trajectory import rows_that_differ
from servogen.simulate.wanted import load_simulation


@pytest.mark.parametrize(
    ("name", "board", "scalar", "duration"),
    [
        ("double_pendulum_energy", "cortex-m4", "float32", 0.2),
        ("double_pendulum_energy", "cortex-m4", "float64", 0.02),
        ("spacecraft", "cortex-m7", "float64", 0.1),
    ],
)
def test_rows_are_the_hosts(name, board, scalar, duration, need_target):
    need_target(board)
    here, there = (
        ClosedLoop(*load_simulation(name), scalar, target=target).run(duration=duration) for target in ("host", board)
    )
    assert len(here.t) > 50
    assert str(there.stop) == str(here.stop)
    assert rows_that_differ(here, there) == 0


@pytest.mark.parametrize(
    ("name", "scalar", "duration"),
    [("spacecraft", "float32", 0.02), ("double_pendulum_energy", "float64", 0.005)],
)
def test_a_machine_with_all_its_flaws(need_target, name, scalar, duration):
    """Noise, steps, a delay, limits, rates and lags, another plant, rows less often than ticks: the same bits."""
    need_target("cortex-m4")
    scene, simulation = load_simulation(name)
    heavier = {f.name: 1.2 * np.array(f.default) for f in list(scene.parameters)[:1]}
    tick = simulation.step
    simulation = replace(
        simulation,
        plant=heavier,
        actuators=sg.Actuators(limit=0.9 * SOME_TAU[name], rate=SOME_TAU[name] / tick, lag=2 * tick),
        noise={"q": 1e-3, "u": 1e-2},
        quantise={"u": 1e-3},
        delay=1.25 * tick,
        hold=tick,
        step=2 * tick,
        seed=11,
    )
    loops = [ClosedLoop(scene, simulation, scalar, target=target) for target in ("host", "cortex-m4")]
    runs = [loop.run(duration=duration) for loop in loops]
    assert len(runs[0].t) > 8
    assert rows_that_differ(*runs) == 0
    assert runs[0].limited.max() > 0
    assert rows_that_differ(runs[0], loops[0].run(duration=duration, seed=12)) > 0


SOME_TAU = {"spacecraft": 0.3, "double_pendulum_energy": 1.0}
