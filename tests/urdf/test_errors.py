"""Every error about a robot names the thing and the remedy."""

from pathlib import Path
from typing import Any

import pytest
import servogen as sg
from support.robots import IIWA

MASS = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'


def link(name: str, inertial: str = MASS) -> str:
    return f'<link name="{name}">{inertial}</link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", more: str = "") -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    limit = '<limit effort="1" velocity="1" lower="-1" upper="1"/>' if kind in ("revolute", "prismatic") else ""
    return f'<joint name="{name}" type="{kind}">{ends}{limit}{more}</joint>'


def load(tmp_path: Path, body: str, **options: Any) -> sg.urdf.Robot:
    path = tmp_path / "bot.urdf"
    path.write_text(f'<robot name="bot">{body}</robot>')
    return sg.urdf.load(path, **options)


A, B, C = link("a"), link("b"), link("c")
J = joint("j", "a", "b")
WRONG = [
    (A + B + joint("j", "a", "b", "floating"), {}, ("'j'", "'floating'", "joints=")),
    (A + B + joint("j", "a", "b", "planar"), {}, ("'j'", "'planar'", "not supported")),
    (A + link("b", "") + J, {}, ("'b'", "no <inertial>", "give the link mass")),
    (A + B + C + J + joint("k", "a", "c", more='<mimic joint="j"/>'), {}, ("'k'", "mimics 'j'", "remove <mimic>")),
    (A + B + C + J + joint("k", "c", "b"), {}, ("'b'", "two joints", "loop", "cut")),
    (A + B + C + joint("j", "b", "c") + joint("k", "c", "b"), {}, ("loop", "cut")),
    (A + B, {}, ("several links without a parent", "a, b", "fixed joints")),
    (A + J, {}, ("'j'", "no such link")),
    (A + A + J, {}, ("two links named 'a'", "rename")),
    (A + B + joint("j", "a", "b", more='<axis xyz="0 0 0"/>'), {}, ("'j'", "axis 0 0 0")),
    (A + link("b", MASS.replace('mass value="1"', 'mass value="-1"')) + J, {}, ("'b'", "-1.0", "not negative")),
    (A + link("b", MASS.replace('ixx="1"', 'ixx="nan"')) + J, {}, ("'b'", "finite")),
    (A + B + joint("j", "a", "b", "hinge"), {}, ("no valid URDF", "hinge")),
    (A + "<link", {}, ("no valid URDF",)),
    (A + B + J, {"joints": ["x"]}, ("no joint 'x'", "it can move j")),
    (A + B + J, {"joints": ["j", "j"]}, ("'j' is named twice",)),
    (A + B + J, {"joints": "j"}, ("list of joint names",)),
    (A + B + J, {"joints": []}, ("no joint is left",)),
    (A + B + J, {"base": "free"}, ("'free'", "'fixed' or 'floating'")),
    (A + B + J, {"gravity": (0, -9.81)}, ("gravity", "three")),
]


@pytest.mark.parametrize(("body", "options", "words"), WRONG)
def test_wrong_robots(tmp_path: Path, body: str, options: dict[str, Any], words: tuple[str, ...]) -> None:
    with pytest.raises(sg.SceneError) as raised:
        load(tmp_path, body, **options)
    for word in words:
        assert word in str(raised.value)


def test_locking_is_the_remedy(tmp_path: Path) -> None:
    body = A + B + C + J + joint("k", "b", "c", "floating")
    assert load(tmp_path, body, joints=["j"]).joints == ("j",)


def test_bad_path() -> None:
    with pytest.raises(sg.SceneError, match=r"no URDF file at 'nowhere\.urdf'"):
        sg.urdf.load("nowhere.urdf")


@pytest.mark.parametrize("method", ["position", "rotation", "jacobian", "velocity", "bias_acceleration"])
def test_unknown_frame(method: str) -> None:
    robot = sg.urdf.load(IIWA, quiet=True)
    with pytest.raises(sg.SceneError, match="no frame 'hand'; the links that name frames are lbr_iiwa_link_0"):
        getattr(robot, method)("hand")
