"""Robots from MJCF files against MuJoCo itself, which knows nothing of how they were read."""

import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg

# Everything awkward at once: refs, two joints off a body's origin, slides, slanted axes and frames, sites, principal
# axes, a body whose mass is that of its shapes, springs, a body without joints, degrees.
ARM = """<mujoco><compiler angle="degree"/><option gravity="0.3 -0.2 -9.7"/>
  <asset><mesh name="skin" file="not_there.stl"/><material name="red" rgba="1 0 0 1"/></asset>
  <worldbody><geom type="plane" size="1 1 1" material="red"/><site name="ground" pos="0.1 0.2 0.3"/>
  <body name="a" pos="0.1 0 0.4" euler="10 20 -30">{free}
    <inertial pos="0.1 0.2 -0.1" mass="2" fullinertia="0.1 0.12 0.09 0.01 -0.02 0.005"/>
    <geom type="mesh" mesh="skin"/>
    <joint name="j1" axis="1 2 -0.5" ref="25" damping="0.3" armature="0.02" stiffness="3" springref="10"/>
    <body name="b" pos="0 0.3 0.1" quat="0.7071 0 0.7071 0">
      <joint name="j2" type="slide" axis="0 -1 0" ref="0.2" damping="1.5" stiffness="40" springref="0.1"/>
      <joint name="j3" axis="0 0 1" pos="0.05 0.1 0" range="-40 60"/><joint axis="0 1 0" pos="0 0.1 0.2"/>
      <geom type="capsule" size="0.03" fromto="0 0 0 0.2 0.1 0.3" density="900" material="red"/>
      <body name="plate" pos="0.2 0 0.1" euler="0 0 90">
        <inertial pos="0 0 0.1" mass="0.7" diaginertia="0.01 0.02 0.025"/>
        <site name="tool" pos="0.1 0.2 0.3" euler="15 0 0"/>
        <body name="c" pos="0.1 0 0"><joint name="j5" axis="0 0 1" actuatorfrcrange="-3 7" frictionloss="0.4"/>
          <inertial pos="0.2 0 0" mass="0.5" diaginertia="0.01 0.012 0.02"/></body></body></body>
  </body>{more}</worldbody>
  <actuator><motor joint="j3"/></actuator>{equality}</mujoco>"""


@pytest.fixture(scope="module")
def mujoco(need_module: Callable[[str, str], ModuleType]) -> ModuleType:
    return need_module("mujoco", "mujoco")


@pytest.fixture
def write(mujoco: ModuleType, tmp_path: Path) -> Callable[..., Path]:
    def write(text: str = ARM, **parts: str) -> Path:
        path = tmp_path / "robot.xml"
        path.write_text(text.format(**{"free": "", "more": "", "equality": ""} | parts) if text is ARM else text)
        return path

    return write


def their_model(mujoco: ModuleType, path: Path) -> tuple[Any, Any]:
    text = re.sub(r'<geom type="mesh"[^>]*>|<mesh [^>]*>', "", path.read_text())  # which MuJoCo alone does not read
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return model, mujoco.MjData(model)


@pytest.mark.parametrize("floating", [False, True])
def test_mass_bias_and_jacobians_are_mujocos(floating: bool, write: Callable[..., Path], mujoco: ModuleType) -> None:
    path = write(free="<freejoint/>" if floating else "")
    if floating:
        path.write_text(re.sub(r'<joint name="j1".*?/>', "", path.read_text()))
    robot = sg.mjcf.load(path, quiet=True)
    assert robot.joints == (() if floating else ("j1",)) + ("j2", "j3", "joint_3", "j5")
    model, data = their_model(mujoco, path)
    mech, frames = robot.mechanism, ("tool", "c", "b", "a")
    jacobians = [robot.jacobian(frame) for frame in frames]
    poses = [ca.horzcat(robot.position(frame), robot.rotation(frame)) for frame in frames]
    ours = ca.Function("ours", [robot.q, robot.u], [mech.Q, mech.P, *jacobians, *poses])
    generator = np.random.default_rng(3)
    for _ in range(5):
        q, u = generator.uniform(-1.5, 1.5, model.nq), generator.uniform(-2, 2, model.nv)
        T, bias = np.eye(model.nv), np.zeros(model.nv)
        data.qpos[:], data.qvel[:] = q, u
        if floating:  # theirs: linear velocity in the world, and its rate too
            q[3:7] /= np.linalg.norm(q[3:7])
            data.qpos[:] = q
            mujoco.mju_quat2Mat(turn := np.zeros(9), q[3:7])
            T[:3, :3] = turn.reshape(3, 3)
            data.qvel[:] = T @ u
            bias[:3] = T[:3, :3] @ np.cross(u[3:6], u[:3])
        mujoco.mj_forward(model, data)
        M = np.zeros((model.nv, model.nv))
        for k in range(model.nv):
            mujoco.mj_mulM(model, data, M[k], np.eye(model.nv)[k])
        theirs = [T.T @ M @ T, T.T @ (data.qfrc_passive - data.qfrc_bias - M @ bias)]
        theirs += [jacobian(mujoco, model, data, frame) @ T for frame in frames]
        for frame in frames:
            at = data.site(frame) if frame == "tool" else data.body(frame)
            theirs.append(np.column_stack([at.xpos, at.xmat.reshape(3, 3)]))
        for value, expected in zip(ours(q, u), theirs, strict=True):
            np.testing.assert_allclose(np.array(value).reshape(expected.shape), expected, rtol=0, atol=1e-9)


def jacobian(mujoco: ModuleType, model: Any, data: Any, frame: str) -> Any:
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    of = mujoco.mj_jacSite if frame == "tool" else mujoco.mj_jacBody
    of(model, data, linear, angular, (model.site if frame == "tool" else model.body)(frame).id)
    return np.vstack([linear, angular])


CONNECTS = {
    "bodies": '<connect name="rope" body1="c" body2="a" anchor="0.1 -0.2 0.3"/>',
    "world": '<connect name="rope" body1="c" anchor="0.1 -0.2 0.3"/>',
    "sites": '<connect name="rope" site1="tool" site2="ground"/>',
}
COUPLING = '<joint name="gear" joint1="j3" joint2="j1" polycoef="0.1 0.5 0.2 0 0"/><joint joint1="j2"/>'


@pytest.mark.parametrize("ends", CONNECTS)
def test_loops_are_mujocos(ends: str, write: Callable[..., Path], mujoco: ModuleType) -> None:
    """chi and J row by row, at states that need not satisfy them."""
    path = write(equality=f"<equality>{CONNECTS[ends]}{COUPLING}</equality>")
    robot = sg.mjcf.load(path, quiet=True)
    mech = robot.mechanism
    assert [c.name for c in mech.passive] == ["rope", "gear", "equality_3"]
    chi = ca.vertcat(*(c.chi for c in mech.passive))
    ours = ca.Function("ours", [robot.q], [chi, ca.densify(ca.jacobian(chi, robot.q))])
    model, data = their_model(mujoco, path)
    for q in np.random.default_rng(1).uniform(-1, 1, (3, 5)):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        value, slope = (np.array(x) for x in ours(q))
        np.testing.assert_allclose(slope, data.efc_J.reshape(-1, 5)[:5], rtol=0, atol=1e-9)
        np.testing.assert_allclose(value.ravel(), data.efc_pos[:5], rtol=0, atol=1e-9)


def test_forces_in_a_loop_are_those_of_mujocos_matrices(write: Callable[..., Path], mujoco: ModuleType) -> None:
    """The loop's forces at rest against a dense solve with MuJoCo's M, forces and J."""
    path = write(equality=f"<equality>{CONNECTS['bodies']}</equality>")
    robot = sg.mjcf.load(path, quiet=True)
    turn = sg.Nonholonomic("turn", robot.u[4], Theta=-1.0)
    twin = sg.reference(sg.Scene("hung", robot.mechanism, [turn], domain={"q": (-1, 1)}))
    model, data = their_model(mujoco, path)
    generator = np.random.default_rng(1)
    for _ in range(3):
        q, tau = generator.uniform(-1, 1, 5), generator.uniform(-5, 5, 5)
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        J, M = data.efc_J.reshape(-1, 5)[:3], np.zeros((5, 5))
        for k in range(5):
            mujoco.mj_mulM(model, data, M[k], np.eye(5)[k])
        force = data.qfrc_passive - data.qfrc_bias + tau
        dense = np.linalg.solve(np.block([[M, -J.T], [J, np.zeros((3, 3))]]), np.concatenate([force, np.zeros(3)]))
        lam = twin.lam(q=q, u=np.zeros(5), tau=tau)
        np.testing.assert_allclose(lam, dense[5:], rtol=0, atol=1e-9 * np.max(np.abs(dense)))


def test_a_weld_holds_what_mujocos_holds(write: Callable[..., Path], mujoco: ModuleType) -> None:
    """Where the file draws it, both leave the same motions free."""
    weld = '<weld body1="c" body2="a" anchor="0.1 0.2 0.3" relpose="0.1 0 0.2 0.8 0.6 0 0"/>'
    path = write(equality=f"<equality>{weld}</equality>")
    robot = sg.mjcf.load(path, quiet=True)
    (constraint,) = robot.mechanism.passive
    assert constraint.name == "equality_1"
    model, data = their_model(mujoco, path)
    function = ca.Function("chi", [robot.q], [constraint.chi, ca.densify(ca.jacobian(constraint.chi, robot.q))])
    for q in np.random.default_rng(2).uniform(-1, 1, (3, 5)):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(np.array(function(q)[0])[:3, 0], data.efc_pos[:3], rtol=0, atol=1e-9)
        np.testing.assert_allclose(np.array(function(q)[1])[:3], data.efc_J.reshape(-1, 5)[:3], rtol=0, atol=1e-9)
    drawn = write(equality='<equality><weld body1="c" body2="a"/></equality>')
    robot = sg.mjcf.load(drawn, quiet=True)
    chi = robot.mechanism.passive[0].chi
    model, data = their_model(mujoco, drawn)
    mujoco.mj_forward(model, data)
    function = ca.Function("chi", [robot.q], [chi, ca.densify(ca.jacobian(chi, robot.q))])
    value, J = (np.array(x) for x in function(data.qpos))
    assert np.max(np.abs(value)) < 1e-12
    ours, theirs = (np.linalg.pinv(x, 1e-9) @ x for x in (J, data.efc_J.reshape(-1, 5)[:6]))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)


def test_options_and_limits(write: Callable[..., Path], capsys: pytest.CaptureFixture[str]) -> None:
    path = write()
    robot = sg.mjcf.load(path)
    assert capsys.readouterr().err == "".join(f"robot.xml: {note}\n" for note in robot.notes)
    assert robot.notes == ("friction of joint j5 is left out; friction='tanh' takes it in, smoothed",)
    assert not robot.mechanism.passive
    np.testing.assert_allclose(robot.limits.position[2], np.radians([-40, 60]))
    assert robot.limits.effort.tolist() == [np.inf] * 4 + [3.0]
    par = sg.Parameters(J=0.5)
    other = sg.mjcf.load(path, joints=["j3", "j1"], gravity=(0, 0, 0), damping=None, springs=None, quiet=True,
                         armature={"j1": par.J}, payload=sg.urdf.Payload("tool", 2.0))  # fmt: skip
    mech = other.mechanism
    assert [s.name() for s in mech.q.nonzeros()] == ["j3", "j1"]
    at = ca.Function("at", [other.q, other.u, par.J], [mech.P, mech.Q])
    P, Q = at([0.4, 0.3], [0, 0], 0.5)
    assert np.max(np.abs(np.array(P))) == 0  # neither weight nor springs are left
    assert float(Q[1, 1] - at([0.4, 0.3], [0, 0], 0)[1][1, 1]) == pytest.approx(0.5)


BALL = '<mujoco><worldbody><body name="b"><joint name="k" type="ball"/><geom size="1"/></body></worldbody></mujoco>'
FREE = '<body name="{0}"><freejoint/><geom size="0.1"/></body>'


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        (BALL, {}, "'k' is of type 'ball', which is not supported"),
        ("<mujoco><worldbody>" + FREE.format("x") + FREE.format("y") + "</worldbody></mujoco>", {},
         "several free bodies .x, y.; leave one"),
        (ARM.format(free="", more=FREE.format("x"), equality=""), {}, "'j1' moves beside the free body 'x'"),
        (ARM.format(free="", more="", equality=""), {"base": "floating"}, "no free joint; give the base"),
        (ARM.format(free="", more="", equality=""), {"base": "hanging"}, "choose 'fixed' or 'floating' or None"),
        (ARM.format(free="", more="", equality=""), {"joints": ["j1", "nose"]}, "no joint 'nose'; it can move j1"),
        (ARM.format(free="", more="", equality='<equality><joint joint1="j1"/></equality>'), {"joints": ["j2"]},
         "'j1' is locked by joints="),
        ("<mujoco><worldbody><nonsense/></worldbody></mujoco>", {}, "MuJoCo does not read it: .*nonsense"),
        ("not XML", {}, "MuJoCo does not read it"),
        ('<?xml version="1.0"?><robot name="r"><link name="l"/></robot>', {}, "URDF file; load it with sg.urdf.load"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(text: str, options: Any, words: str, write: Callable[..., Path]) -> None:
    with pytest.raises(sg.SceneError, match=words):
        sg.mjcf.load(write(text), quiet=True, **options)


def test_what_is_no_file(mujoco: ModuleType, tmp_path: Path) -> None:
    for path, words in ((BALL, "text of XML"), (tmp_path, "no MJCF file"), (3, "is of type int")):
        with pytest.raises(sg.SceneError, match=words):
            sg.mjcf.load(path)  # type: ignore[arg-type]


def test_what_acts_in_mujoco_alone_is_noted(write: Callable[..., Path]) -> None:
    equality = '<equality><connect body1="c" anchor="0 0 0" active="false"/></equality><tendon><spatial stiffness="3">'
    equality += '<site site="tool"/><site site="ground"/></spatial></tendon>'
    robot = sg.mjcf.load(write(equality=equality), quiet=True)
    assert robot.notes[:2] == ("equality 1 is not active and left out",
                               "1 tendon(s) are left out, with their springs and dampers")  # fmt: skip


def test_without_mujoco_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(RuntimeError, match=r"pip install 'servogen\[mujoco\]'"):
        sg.mjcf.load("arm.xml")
