"""Loops of robots: frames held together by robot.close, against the four-bar linkage written by hand."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.loading import load_scene
from servogen.scene.closing import Closer
from servogen.scene.domain import draw_states

LENGTHS, MASSES = {"crank": 0.2, "coupler": 0.5, "rocker": 0.4}, {"crank": 0.3, "coupler": 0.6, "rocker": 0.5}


def link(name: str) -> str:
    m, L = MASSES[name], LENGTHS[name]
    spin = m * L * L / 12
    return (
        f'<link name="{name}"><inertial><origin xyz="{L / 2!r} 0 0"/><mass value="{m}"/>'
        f'<inertia ixx="1e-4" iyy="{spin!r}" izz="{spin!r}"/></inertial></link>'
        f'<link name="{name}_tip"/><joint name="{name}_end" type="fixed"><parent link="{name}"/>'
        f'<child link="{name}_tip"/><origin xyz="{L} 0 0"/></joint>'
    )


def hinge(name: str, parent: str, child: str, x: float) -> str:
    return (
        f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{x} 0 0"/><axis xyz="0 0 1"/></joint>'
    )


FOUR_BAR = (
    '<robot name="linkage"><link name="ground"/>' + "".join(map(link, LENGTHS))
    + hinge("motor", "ground", "crank", 0.0) + hinge("elbow", "crank", "coupler", LENGTHS["crank"])
    + hinge("pivot", "ground", "rocker", 0.5) + "</robot>"
)  # fmt: skip


@pytest.fixture(scope="module")
def robot(tmp_path_factory: Any) -> sg.urdf.Robot:
    path = tmp_path_factory.mktemp("loops") / "linkage.urdf"
    path.write_text(FOUR_BAR)
    robot = sg.urdf.load(path, quiet=True, gravity=(0, -9.81, 0), joints=["motor", "elbow", "pivot"])
    robot.close("coupler_tip", "rocker_tip")
    return robot


def test_a_closed_robot_is_the_linkage_by_hand(robot: sg.urdf.Robot) -> None:
    """The crank's motor alone; coordinates here are relative angles."""
    mech = robot.mechanism
    (loop,) = mech.passive
    assert loop.name == "coupler_tip_to_rocker_tip"
    assert loop.chi.size1() == 2  # nothing moves out of the plane
    motor = ca.SX.sym("torque")
    driven = replace(mech, tau=motor, G=[[1], [0], [0]])
    assert driven.skeleton
    ref = sg.References(speed=sg.Ref(3.0, order=1))
    scene = sg.Scene("closed", driven, [sg.Nonholonomic("speed", robot.u[0] - ref.speed, Theta=-5.0)], references=ref,
                     domain={"q": ((-3, -3, 0.5), (3, 3, 2.8)), "u": (-4, 4)})  # fmt: skip
    ours, by_hand = sg.reference(scene), sg.reference(load_scene("four_bar"))
    drawn = draw_states(load_scene("four_bar"), 3)
    for k in range(3):
        q, u = drawn["q"][k], drawn["u"][k]
        state = {"speed": 1.0, "speed_dot": 2.0}
        relative = {"q": [q[0], q[1] - q[0], q[2]], "u": [u[0], u[1] - u[0], u[2]]}
        a, b = ours.control(**relative, **state), by_hand.control(q=q, u=u, **state)
        np.testing.assert_allclose(a.value, b.value, rtol=1e-10, atol=1e-12)
        lam = ours.lam(**relative, tau=a.value), by_hand.lam(q=q, u=u, tau=b.value)
        np.testing.assert_allclose(lam[0], lam[1], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("frames", "what", "words"),
    [
        (("rocker", "rocker_tip"), "position", "no joint moves one from the other"),
        (("rocker_tip", "rocker_tip"), "position", "no joint moves one from the other"),
        (("coupler_tip", "hand"), "position", "no frame 'hand'"),
        (("coupler_tip", "rocker_tip"), "weld", "'position' or 'pose'"),
    ],
)
def test_wrong_loops(robot: sg.urdf.Robot, frames: tuple[str, str], what: Any, words: str) -> None:
    with pytest.raises(sg.SceneError, match=words):
        robot.close(*frames, what)


def test_a_weld_takes_all_that_moves(tmp_path: Path) -> None:
    path = tmp_path / "linkage.urdf"
    path.write_text(FOUR_BAR)
    welded = sg.urdf.load(path, quiet=True)
    chi = welded.close("coupler_tip", "rocker_tip", "pose").chi
    assert chi.size1() == 3  # two of position, one turn


def test_names_of_closures(tmp_path: Path) -> None:
    path = tmp_path / "linkage.urdf"
    path.write_text(FOUR_BAR.replace("coupler_tip", "1_tip"))
    robot = sg.urdf.load(path, quiet=True)
    before = robot.mechanism
    assert robot.close("1_tip", "rocker_tip").name == "_1_tip_to_rocker_tip"
    with pytest.raises(sg.SceneError, match="'_1_tip_to_rocker_tip'; give a name"):
        robot.close("1_tip", "rocker_tip", "pose")
    robot.close("1_tip", "rocker_tip", "pose", name="weld")
    assert [c.name for c in robot.mechanism.passive] == ["_1_tip_to_rocker_tip", "weld"]
    assert not before.passive


def test_half_a_turn_off_is_not_closed(tmp_path: Path) -> None:
    """There the sines of the angles between the frames vanish, too; that solution is not meant."""
    path = tmp_path / "door.urdf"
    path.write_text(
        '<robot name="door"><link name="ground"/>' + link("crank") + link("rocker")
        + hinge("motor", "ground", "crank", 0.0) + hinge("pivot", "ground", "rocker", 0.0) + "</robot>"
    )  # fmt: skip
    door = sg.urdf.load(path, quiet=True)
    door.close("crank", "rocker", "pose")
    speed = sg.Nonholonomic("speed", door.u[0], Theta=-1.0)
    scene = sg.Scene("door", door.mechanism, [speed], domain={"q": (-3.0, 3.0)})
    turned = draw_states(scene, 40)["q"]
    np.testing.assert_allclose(np.cos(turned[:, 0] - turned[:, 1]), 1.0, atol=1e-12)
    states = {"q": np.array([[0.3, 2.9], [0.3, 0.9]]), "u": np.zeros((2, 2))}
    assert Closer(scene).close(states)[1].tolist() == [False, True]
