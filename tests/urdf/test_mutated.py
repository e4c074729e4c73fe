"""A URDF file may be broken in any way: it loads, or a SceneError says why not."""

from pathlib import Path

from support.mutations import campaign
from support.robots import ODD


def test_no_bare_error_from_mutated_files(tmp_path: Path) -> None:
    found = campaign([ODD], 120, 1, tmp_path)
    assert found["loaded"] >= 10
    assert found["refused"] >= 50
