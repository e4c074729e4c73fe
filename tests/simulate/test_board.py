"""The closed loop inside an emulated board: the host's rows, bit for bit."""

import pytest
from servogen.loading import load_simulation
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.trajectory import rows_that_differ


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


def test_the_tick_of_firmware_and_an_event(need_target):
    """With hold, from a start that ends at once: the reason comes across, too."""
    need_target("cortex-m4")
    scene, simulation = load_simulation("spacecraft")
    loops = [ClosedLoop(scene, simulation, "float32", target=target) for target in ("host", "cortex-m4")]
    runs = [loop.run(duration=0.02, hold=True) for loop in loops]
    assert rows_that_differ(*runs) == 0
    other = ClosedLoop(scene, simulation, "float32").run(duration=0.02, hold=True, start={"u": [0.1, 0.1, 0.11]})
    assert rows_that_differ(runs[0], other) > 0
