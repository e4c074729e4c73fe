"""Two versions of the generated C are compared where they are the same functions, to what the clock leaves open."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from servogen.bench.versions import clock_error, comparable
from servogen.verify.generated import committed_folder

NAMES = ["four_bar", "unicycle_path", "spacecraft"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda told: told["inputs"].pop("u"), "it has other inputs"),
        (lambda told: next(iter(told["parameters"].values())).update(size=2), "it has other parameters"),
        (
            lambda told: told["entry_points"]["control"]["operations"].update(total=1),
            "operations of control are others",
        ),
        (lambda told: told["entry_points"].pop("control"), "operations of control are others"),
    ],
)
def test_what_is_another_function_is_left_out(tmp_path: Path, change: Callable[[Any], Any], words: str) -> None:
    for name in NAMES[:2]:
        shutil.copytree(committed_folder() / name, tmp_path / name)
    file = tmp_path / "unicycle_path" / "f32" / "manifest.json"
    told = json.loads(file.read_text())
    change(told)
    file.write_text(json.dumps(told))
    same, others = comparable(committed_folder(), tmp_path, NAMES)
    assert same == ["four_bar"]
    assert others[0] == f"unicycle_path: {words}"
    assert others[1].startswith("spacecraft: there is no ")


def test_the_clock_averages_out() -> None:
    assert clock_error(4 * 3000) == pytest.approx(clock_error(3000) / 2)
    assert 1 < clock_error(3000) < 3
