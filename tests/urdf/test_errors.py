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
    (link("a", "") + link("b", "") + J, {}, ("no link has an <inertial>", "kinematics alone", "a data sheet")),
    (
        A + B + C + J + joint("k", "a", "c", more='<mimic joint="j"/>'),
        {"joints": ["j", "k"]},
        ("'k'", "mimics 'j'", "name 'j'"),
    ),
    (A + B + joint("j", "a", "b", more='<mimic joint="x"/>'), {}, ("'j'", "mimics 'x'", "no such joint")),
    (A + B + joint("j", "a", "b", more='<mimic joint="j"/>'), {}, ("'j'", "mimics it in turn")),
    (A + B + joint("j", "a", "b", more="<mimic/>"), {}, ("'j'", "names no joint")),
    (A + B + joint("j", "a", "b", "fixed"), {"joints": ["j"]}, ("'j' is fixed", "leave it out")),
    (A + B + joint("j", "a", "b", "fixed"), {}, ("no joint that moves", "base='floating'")),
    (link("a", "") + B + joint("j", "a", "b", "floating"), {}, ("'j'", "'floating'", "base='floating'")),
    (A + B + joint("j", "a", "b", more='<axis xzy="0 0 1"/>'), {}, ("'j'", "no xyz", "it has xzy")),
    (A + B + joint("j", "a", "b", more='<axis xyz="0 1"/>'), {}, ("'j'", "2 numbers", "give 3")),
    (A + B + joint("j", "a", "b", more='<axis xyz="0,0,1"/>'), {}, ("'j'", "0,0,1", "is no number")),
    (A + B + joint("j", "a", "b", more='<dynamics damping="-1"/>'), {}, ("'j'", "damping -1.0", "not negative")),
    (A + B + joint("j", "a", "b", more='<origin xyz="${x} 0 0"/>'), {}, ("unexpanded xacro", "${x} 0 0", "xacro FILE")),
    (A + B + J + "<xacro:leg side='left'/>", {}, ("unexpanded xacro", "<xacro:leg>", "line 1")),
    (A + link("b", MASS.replace('<mass value="1"/>', "<mass>1</mass>")) + J, {}, ("'b'", "<mass> has no value")),
    (A + link("b", MASS.replace(' ixx="1"', "")) + J, {}, ("'b'", "no ixx")),
    (A + link("b", MASS.replace('value="1"', 'value="1e200"')) + J, {}, ("'b'", "1e+200", "below 1e+30")),
    (A + link("b", MASS.replace('iyy="1"', 'iyy="-1"')) + J, {}, ("'b'", "'j'", "negative inertia")),
    (A + link("b", MASS.replace('ixx="1"', 'ixx="0"')) + J, {}, ("'j'", "'b'", "inertia about its axis", "armature")),
    (
        A + link("b", MASS.replace('mass value="1"', 'mass value="0"')) + joint("j", "a", "b", "prismatic"),
        {},
        ("'j'", "'b'", "without mass"),
    ),
    (
        link("a", MASS.replace('iyy="1"', 'iyy="-1"')),
        {"base": "floating"},
        ("'a'", "floating base", "negative inertia"),
    ),
    (link("a", ""), {"base": "floating"}, ("floating base has no inertia",)),
    (A + "<link/>", {}, ("a <link> has no name",)),
    (A + B + '<joint name="j" type="fixed"><child link="b"/></joint>', {}, ("'j' names no parent",)),
    (A + B + '<joint name="j"><parent link="a"/><child link="b"/></joint>', {}, ("'j' has no type",)),
    (A + B + J, {"damping": "all"}, ("damping='all'", "'urdf' or None")),
    (A + B + J, {"friction": "coulomb"}, ("friction='coulomb'", "'tanh' or None")),
    (A + B + J, {"armature": {"k": 1.0}}, ("moves no joint 'k'", "it moves j")),
    (A + B + J, {"armature": {"j": -1.0}}, ("armature of joint 'j'", "not negative")),
    (A + B + J, {"payload": 3.0}, ("sg.urdf.Payload",)),
    (A + B + J, {"payload": sg.urdf.Payload("hand", 1.0)}, ("no frame 'hand'", "a, b")),
    (A + B + J, {"gravity": -9.81}, ("gravity is -9.81", "three numbers")),
    (A + B + J, {"gravity": None}, ("gravity is None", "three numbers")),
    (A + B + J, {"gravity": "down"}, ("gravity='down'", "three numbers")),
    (A + B + J, {"gravity": (0, 0, float("nan"))}, ("nan", "three numbers")),
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


FILES = {
    "<sdf version='1.6'/>": "it is SDF",
    "<mujoco/>": "it is MJCF, MuJoCo's format; load it with sg.mjcf.load",
    "<!DOCTYPE html><html><body>": "it is a web page; download the raw file",
    "<COLLADA/>": "it is a mesh",
    "<plan/>": "begins with <plan>",
    "": "it is empty",
    "version https://git-lfs.github.com/spec/v1\n": "git lfs pull",
    "solid tool": "no valid URDF: line 1",
    "<?xml version='1.0' encoding='martian'?><robot/>": "no valid URDF",
}


@pytest.mark.parametrize(("text", "words"), FILES.items())
def test_files_of_another_kind(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "bot.urdf"
    path.write_text(text)
    with pytest.raises(sg.SceneError, match="bot") as raised:
        sg.urdf.load(path)
    assert words in str(raised.value)


@pytest.mark.parametrize(
    ("path", "words"),
    [
        (f"<robot>{A}</robot>", "text of XML"),
        ("package://arm/arm.urdf", "is a URI"),
        ("x" * 5000, "cannot read"),
        ("a\0b", "no URDF file at"),
        (".", "is a folder"),
        (3, "of type int"),
    ],
)
def test_what_is_no_path(path: Any, words: str) -> None:
    with pytest.raises(sg.SceneError, match=words):
        sg.urdf.load(path)


def test_bad_path() -> None:
    with pytest.raises(sg.SceneError, match=r"no URDF file at 'nowhere\.urdf'"):
        sg.urdf.load("nowhere.urdf")


@pytest.mark.parametrize("method", ["position", "rotation", "jacobian", "velocity", "bias_acceleration"])
def test_unknown_frame(method: str) -> None:
    robot = sg.urdf.load(IIWA, quiet=True)
    with pytest.raises(sg.SceneError, match="no frame 'hand'; the links that name frames are lbr_iiwa_link_0"):
        getattr(robot, method)("hand")
