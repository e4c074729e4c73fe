"""What info adds to control is counted, and stays within its bar."""

from servogen.bench import info_cost, instructions
from servogen.loading import load_scene
from support.missing import skip_or_fail


def test_info_of_two_rows_is_cheap(tmp_path):
    if not instructions.available():
        skip_or_fail(instructions.MISSING)
    found = info_cost.cost(load_scene("double_pendulum_energy_and_path"), "float64", tmp_path, ("-O2",))
    assert 0 < found.added < info_cost.BAR
    assert found.nanoseconds[1] > 0
