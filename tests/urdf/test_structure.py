"""What the recursions save, and how a robot is read: locked joints, order, quarter turns, operation counts."""

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
import servogen as sg
from servogen.bench.peers.robots import adam_scene
from servogen.compiler import compile_scene, derived_scene, target_for
from servogen.loading import scene_module
from servogen.optimise.passes import optimise
from servogen.plan.stage import cut, stage
from support.robots import A1, IIWA, IIWA_TOOL


def test_operations_of_the_iiwa() -> None:
    """S and z, the test of the pivots apart, with constant gains and a reference without rates."""
    robot = sg.urdf.load(IIWA, quiet=True, damping=None)
    ref = sg.References(r=[0.5, 0.0, 0.6])
    psi = robot.position(IIWA_TOOL) - ref.r
    scene = sg.Scene("x", robot.mechanism, [sg.Holonomic("r", psi, Theta1=-20.0, Theta2=-100.0)], references=ref)
    tick = stage(optimise(derived_scene(scene)[1])).tick
    assert cut(tick, "S_z", ("S", "z")).operations()["total"] <= 1090


def test_operations_of_the_built_in_scene() -> None:
    """The test of the pivots and the reference's rates included: S and z without a weight, and the built-in controller.

    The inverse mass as weight, the arm's weight carried, damping and stiffness cost 3 % more than S and z alone.
    """
    module = scene_module("iiwa_position")
    plain = sg.build(module.scene_of(sg.urdf.load(IIWA, quiet=True, damping=None))).manifest
    assert plain["entry_points"]["S_z"]["operations"]["total"] <= 1100
    manifest = Path(__file__).parents[2] / "generated" / "iiwa_position" / "f64" / "manifest.json"
    assert json.loads(manifest.read_text())["entry_points"]["control"]["operations"]["total"] <= 1120


def test_adams_model_of_the_iiwa_loses_most_of_its_operations(need_module: Callable[[str, str], ModuleType]) -> None:
    """What a user pastes: 10,188 operations as CasADi writes them, and noise of quarter turns in the constants."""
    need_module("adam", "adam-robotics[casadi]")
    scene = adam_scene(scene_module("iiwa_position"))
    kernel = next(
        e.kernel for e in compile_scene(scene, target_for("p", "float64", None)).entry_points if e.name == "S_z"
    )
    assert kernel.program.operations()["total"] <= 2300


def test_a_rotor_costs_no_sine() -> None:
    robot = sg.urdf.load(IIWA, quiet=True, damping=None)
    assert not ca.depends_on(ca.vertcat(ca.vec(robot.mechanism.Q), robot.mechanism.P), robot.q[6])


def test_locked_joints_are_joints_at_zero() -> None:
    whole, part = sg.urdf.load(A1, quiet=True), sg.urdf.load(A1, joints=["FL_lower_joint", "FL_hip_joint"], quiet=True)
    places = [whole.joints.index(name) for name in part.joints]
    assert part.joints == ("FL_lower_joint", "FL_hip_joint")
    q, u = np.zeros(12), np.zeros(12)
    q[places], u[places] = (0.3, -0.7), (1.1, 0.4)
    outputs = [(r.mechanism.Q, r.mechanism.P, r.position("FL_toe"), r.center_of_mass()) for r in (whole, part)]
    a = [np.array(x) for x in ca.Function("whole", [whole.q, whole.u], outputs[0])(q, u)]
    b = [np.array(x) for x in ca.Function("part", [part.q, part.u], outputs[1])(q[places], u[places])]
    for x, y in zip((a[0][np.ix_(places, places)], a[1][places], a[2], a[3]), b, strict=True):
        np.testing.assert_allclose(y, x, atol=1e-13)


def test_quarter_turns_are_exact_and_told(capsys: Any) -> None:
    robot = sg.urdf.load(IIWA)
    assert any("1.57079632679 is taken as exactly 1 quarter turn" in note for note in robot.notes)
    assert capsys.readouterr().err.count("quarter turn") == len(robot.notes)
    home = np.array(ca.Function("R", [robot.q], [robot.rotation(IIWA_TOOL)])(np.zeros(7)))
    assert set(np.abs(home).ravel()) <= {0.0, 1.0}


def test_floating_base_conventions() -> None:
    robot = sg.urdf.load(A1, base="floating", quiet=True)
    mech = robot.mechanism
    assert (mech.q.size1(), mech.u.size1(), mech.tau.size1()) == (19, 18, 12)
    assert [s.name() for s in mech.q.nonzeros()][3:7] == ["base_qw", "base_qx", "base_qy", "base_qz"]
    assert mech.G[:6, :].nnz() == 0
    home = np.zeros(19)
    home[3] = 1.0
    weight = np.array(ca.Function("P", [robot.q, robot.u], [mech.P])(home, np.zeros(18))).ravel()
    mass = float(ca.Function("Q", [robot.q], [mech.Q])(home)[0, 0])
    np.testing.assert_allclose(weight[:3], [0, 0, -9.81 * mass], atol=1e-12)


def test_same_file_same_expressions(tmp_path: Path) -> None:
    texts = [str(sg.urdf.load(path, quiet=True).mechanism.P) for path in (IIWA, IIWA)]
    assert texts[0] == texts[1]
