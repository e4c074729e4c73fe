"""What a joint and a link carry beside their inertia: damping, friction, armature, mimics, limits, payloads."""

import re
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from support.robots import ODD
from urdf.test_known_rates import GAINS, compare, draw

DYNAMICS = {"j1": 'damping="0.3" friction="0.2"', "j4": 'damping="1.5"', "spin": 'friction="0.1"'}
MIMICS = {"j4": 'joint="j3" multiplier="-0.5" offset="0.3"', "spin": 'joint="j4" multiplier="2"', "j5": 'joint="j1"'}
LIMITS = {"j3": 'lower="-1" upper="2" velocity="3" effort="4"', "j4": 'lower="-1" upper="1" velocity="0.5" effort="9"'}


def odd(tmp_path: Path, tag: str, given: dict[str, str], base: str = ODD) -> Path:
    for name, attributes in given.items():
        base = re.sub(f'(<joint name="{name}".*?)(</joint>)', rf"\1<{tag} {attributes}/>\2", base, flags=re.DOTALL)
    path = tmp_path / "odd.urdf"
    path.write_text(base)
    return path


def model(robot: sg.urdf.Robot, *more: Any) -> Any:
    function = ca.Function("model", [robot.q, robot.u], [robot.mechanism.Q, robot.mechanism.P, *more])
    return lambda q, u: [np.array(x) for x in function(q, u)]


def test_damping_and_friction_enter_P(tmp_path: Path) -> None:
    path = odd(tmp_path, "dynamics", DYNAMICS)
    plain = sg.urdf.load(path, damping=None, quiet=True)
    damped, rubbing = sg.urdf.load(path, quiet=True), sg.urdf.load(path, friction="tanh", quiet=True)
    assert plain.notes[-1].startswith("friction of joints j1, spin is left out")
    assert "friction tanh(rate / 0.01)" in rubbing.notes[-1]
    q, u = np.linspace(-1, 1, 6), np.linspace(0.5, -0.003, 6)
    rates = dict(zip(plain.joints, u, strict=True))
    damping = np.array([{"j1": 0.3, "j4": 1.5}.get(n, 0) * rates[n] for n in plain.joints])
    friction = np.array([{"j1": 0.2, "spin": 0.1}.get(n, 0) * np.tanh(100 * rates[n]) for n in plain.joints])
    (_Q, P), (_, P_damped), (_, P_rubbing) = (model(robot)(q, u) for robot in (plain, damped, rubbing))
    np.testing.assert_allclose(P_damped.ravel(), P.ravel() - damping, rtol=0, atol=1e-13)
    np.testing.assert_allclose(P_rubbing.ravel(), P.ravel() - damping - friction, rtol=0, atol=1e-13)


def test_armature_adds_to_the_diagonal(tmp_path: Path) -> None:
    path = odd(tmp_path, "dynamics", {})
    par = sg.Parameters(J=0.25)
    robots = [sg.urdf.load(path, quiet=True, armature=a) for a in ({}, {"spin": 0.5, "j2": 2.0})]
    (Q, P), (heavier, same) = (model(robot)(np.linspace(-1, 1, 6), np.linspace(1, 2, 6)) for robot in robots)
    added = np.diag([{"spin": 0.5, "j2": 2.0}.get(name, 0.0) for name in robots[0].joints])
    np.testing.assert_allclose(heavier, Q + added, rtol=0, atol=1e-13)
    np.testing.assert_allclose(same, P, rtol=0, atol=1e-13)
    robot = sg.urdf.load(path, quiet=True, armature={"j1": par.J})
    scene = sg.Scene("geared", robot.mechanism, [sg.Holonomic("tool", robot.position("tool"), **GAINS)], parameters=par)
    compare(scene, draw(scene, robot))


def test_a_mimic_is_its_leader_by_substitution(tmp_path: Path) -> None:
    free = sg.urdf.load(odd(tmp_path, "mimic", {}), quiet=True, damping=None)
    coupled = sg.urdf.load(odd(tmp_path, "mimic", MIMICS), quiet=True, armature={"j4": 0.4})
    assert free.joints == ("j1", "j2", "j3", "j4", "j5", "spin")
    assert coupled.joints == ("j1", "j2", "j3")
    K = np.zeros((6, 3))
    for row, column, factor in ((0, 0, 1), (1, 1, 1), (2, 2, 1), (3, 2, -0.5), (4, 0, 1), (5, 2, -1)):
        K[row, column] = factor
    q, u, offset = np.array([0.3, -0.8, 1.1]), np.array([1.0, -0.4, 0.7]), np.array([0, 0, 0, 0.3, 0, 0.6])
    outputs = [(r.position("tool"), r.jacobian("tool"), r.bias_acceleration("tool")) for r in (free, coupled)]
    Q, P, place, J, bias = model(free, *outputs[0])(K @ q + offset, K @ u)
    Q_c, P_c, place_c, J_c, bias_c = model(coupled, *outputs[1])(q, u)
    spin = np.diag([0, 0, 0, 0.4, 0, 0])
    for ours, expected in ((Q_c, K.T @ (Q + spin) @ K), (P_c, K.T @ P), (place_c, place), (J_c, J @ K), (bias_c, bias)):
        np.testing.assert_allclose(ours, expected, rtol=0, atol=1e-12)
    assert np.array_equal(Q_c, Q_c.T)
    scene = sg.Scene("coupled", coupled.mechanism, [sg.Holonomic("tool", coupled.position("tool"), **GAINS)])
    compare(scene, draw(scene, coupled))


def test_a_mimic_of_a_locked_joint_stands_at_its_offset(tmp_path: Path) -> None:
    free = sg.urdf.load(odd(tmp_path, "mimic", {}), quiet=True)
    locked = sg.urdf.load(odd(tmp_path, "mimic", MIMICS), quiet=True, joints=["j2", "j1"])
    q = np.array([0.3, -0.8, 0.0, 0.3, 0.3, 0.6])
    there = ca.Function("f", [free.q], [free.position("tool")])(q)
    here = ca.Function("f", [locked.q], [locked.position("tool")])(q[[1, 0]])
    np.testing.assert_allclose(np.array(here), np.array(there), rtol=0, atol=1e-13)


def test_limits_are_those_of_the_file(tmp_path: Path) -> None:
    limits = sg.urdf.load(odd(tmp_path, "limit", LIMITS), quiet=True, joints=["j4", "j3"]).limits
    assert np.array_equal(limits.position, [[-1, 1], [-1, 2]])
    assert np.array_equal(limits.velocity, [0.5, 3])
    assert np.array_equal(limits.effort, [9, 4])
    both = odd(tmp_path, "mimic", MIMICS, odd(tmp_path, "limit", LIMITS).read_text())
    limits = sg.urdf.load(both, quiet=True, joints=["j3", "j1"]).limits
    np.testing.assert_allclose(limits.position, [[-1, 2], [-np.inf, np.inf]])  # -1 <= -0.5 q + 0.3 gives q <= 2.6
    assert np.array_equal(limits.velocity, [1, np.inf])
    assert np.array_equal(limits.effort, [4, np.inf])


LOAD = """<link name="load"><inertial><origin xyz="0.1 -0.2 0.05"/><mass value="0.8"/>
  <inertia ixx="0.01" iyy="0.02" izz="0.015" ixy="0.001" ixz="-0.002" iyz="0.003"/></inertial></link>
  <joint name="grip" type="fixed"><parent link="tool"/><child link="load"/></joint></robot>"""


def test_a_payload_is_a_link_welded_to_its_frame(tmp_path: Path) -> None:
    path = odd(tmp_path, "dynamics", {})
    par = sg.Parameters(m=0.8, c=[0.1, -0.2, 0.05], inertia=[0.01, 0.02, 0.015, 0.001, -0.002, 0.003])
    xx, yy, zz, xy, xz, yz = (par.inertia[k] for k in range(6))
    rows = ca.vertcat(ca.horzcat(xx, xy, xz), ca.horzcat(xy, yy, yz), ca.horzcat(xz, yz, zz))
    for base in ("fixed", "floating"):
        carrying = sg.urdf.load(path, base=base, quiet=True, payload=sg.urdf.Payload("tool", par.m, par.c, rows))
        welded = sg.urdf.load(odd(tmp_path, "dynamics", {}, ODD.replace("</robot>", LOAD)), base=base, quiet=True)
        path = odd(tmp_path, "dynamics", {})
        states = np.random.default_rng(0)
        q, u = states.normal(size=carrying.q.size1()), states.normal(size=carrying.u.size1())
        symbols = [f.symbol for f in par]
        outputs = [carrying.mechanism.Q, carrying.mechanism.P, carrying.center_of_mass()]
        function = ca.Function("f", [carrying.q, carrying.u, *symbols], outputs)
        ours = [np.array(x) for x in function(q, u, *(ca.DM(f.default) for f in par))]
        for a, b in zip(ours, model(welded, welded.center_of_mass())(q, u), strict=True):
            np.testing.assert_allclose(a, b, rtol=0, atol=1e-11)
        if base == "fixed":
            psi = carrying.position("tool")
            scene = sg.Scene("carrying", carrying.mechanism, [sg.Holonomic("tool", psi, **GAINS)], parameters=par)
            compare(scene, draw(scene, carrying))


def test_one_free_body(tmp_path: Path) -> None:
    path = tmp_path / "body.urdf"
    path.write_text(ODD.split("<joint")[0].replace("</robot>", "").split('<link name="a"')[0] + "</robot>")
    robot = sg.urdf.load(path, base="floating", quiet=True)
    assert robot.joints == ()
    assert robot.tau.size1() == 6
    q, u = np.array([0, 0, 0, 1.0, 0, 0, 0]), np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    Q, P = model(robot)(q, u)
    J = np.diag([0.2, 0.3, 0.25])
    np.testing.assert_allclose(Q, np.diag([3, 3, 3, 0.2, 0.3, 0.25]), rtol=0, atol=1e-14)
    force = -3 * np.cross(u[3:], u[:3]) + [0, 0, -3 * 9.81]
    np.testing.assert_allclose(P.ravel(), [*force, *-np.cross(u[3:], J @ u[3:])], rtol=0, atol=1e-13)
    scene = sg.Scene("flight", robot.mechanism, [sg.Nonholonomic("still", robot.u, Theta=-1.0)])
    tau = sg.reference(scene).control(q=q, u=u).value
    np.testing.assert_allclose(np.linalg.solve(Q, P.ravel() + tau), -u, rtol=0, atol=1e-12)


def test_a_floating_joint_of_an_empty_root_is_the_base(tmp_path: Path) -> None:
    joint = (
        '<link name="map"/><joint name="fb" type="floating"><parent link="map"/><child link="world"/></joint></robot>'
    )
    one = sg.urdf.load(odd(tmp_path, "dynamics", {}), base="floating", quiet=True)
    other = sg.urdf.load(odd(tmp_path, "dynamics", {}, ODD.replace("</robot>", joint)), base="floating", quiet=True)
    assert str(one.mechanism.Q) == str(other.mechanism.Q)
    assert "map" not in other.frames


def test_angles_as_written(tmp_path: Path) -> None:
    path = tmp_path / "odd.urdf"
    path.write_text(ODD.replace("1.57079632679", "1.5708"))
    snapped, written = (sg.urdf.load(path, quiet=True, quarter_turns=q) for q in (True, False))
    assert any("1.5708" in note for note in snapped.notes)
    assert not written.notes
    places = [np.array(ca.Function("f", [r.q], [r.position("tool")])(np.zeros(6))) for r in (snapped, written)]
    assert 1e-7 < np.max(np.abs(places[0] - places[1])) < 1e-4
    path.write_text(
        ODD.replace('rpy="0.4 0 0"', 'rpy="0 0 1e22"')
    )  # no quarter turn, though doubles there are far apart
    robot = sg.urdf.load(path, quiet=True)
    turn = np.array(ca.Function("f", [robot.q], [robot.rotation("d").T @ robot.rotation("c")])(np.zeros(6)))
    np.testing.assert_allclose(
        turn[0, 0], 0.5232147853951389, rtol=0, atol=1e-12
    )  # cos(1e22): Kahan's test of libraries


@pytest.mark.parametrize("moments", [(1.0, 1.0, -1.0), (0.001, 0.001, 0.1)])
def test_a_payload_that_no_body_can_be(moments: tuple[float, float, float]) -> None:
    with pytest.raises(
        sg.SceneError, match=r"payload at 'tool': its inertia has the principal moments .* which no body"
    ):
        sg.urdf.Payload("tool", mass=1.0, inertia=np.diag(moments))
