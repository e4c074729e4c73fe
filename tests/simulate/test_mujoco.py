"""MuJoCo as the plant: the same motion as on our own, what differs between the models told, and errors that help."""

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.bench import mujoco_figures
from servogen.cli import main
from servogen.scenes import iiwa_position
from servogen.scenes.planar_arm_3r import arm, arm_run
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.mujoco_plant import MujocoLoop, disagreement, load_plant
from servogen.simulate.trajectory import Trajectory
from servogen.simulate.wanted import load_simulation
from servogen.tools import ToolMissing

ARM = """<mujoco>
  <option gravity="0 -9.81 0" timestep="1e-3" integrator="RK4"/>
  <worldbody>
    <body name="upper"><joint name="shoulder" axis="0 0 1" {joint}/>
      <inertial pos="0.25 0 0" mass="3" diaginertia="1 1 0.0625"/>
      <body name="lower" pos="0.5 0 0"><joint name="elbow" axis="0 0 1" {joint}/>
        <inertial pos="0.2 0 0" mass="2" diaginertia="1 1 0.0266666666666666667"/>
        <body name="hand" pos="0.4 0 0"><joint name="wrist" axis="0 0 1" {joint}/>
          <inertial pos="0.15 0 0" mass="1" diaginertia="1 1 0.0075"/>{tip}
  </body></body></body></worldbody>{more}
</mujoco>"""
FINGER = """<body name="finger" pos="0.3 0 0"><joint name="finger" axis="0 0 1"/>
  <inertial pos="0 0 0" mass="1e-3" diaginertia="1e-9 1e-9 1e-9"/></body>"""


@pytest.fixture(scope="module", autouse=True)
def _mujoco(need_module: Callable[[str, str], ModuleType]) -> None:
    need_module("mujoco", "mujoco")


def write(folder: Path, joint: str = "", tip: str = "", more: str = "") -> Path:
    file = folder / "arm.xml"
    file.write_text(ARM.format(joint=joint, tip=tip, more=more))
    return file


@pytest.fixture(scope="module")
def planar() -> tuple[sg.Scene, sg.Simulation]:
    """With a posture and damped singular values: one that can go past full reach."""
    scene = arm("planar_damped")
    y = scene.mechanism.posture(damping=6.0)
    scene = replace(scene, weight="inverse_mass", y=y, solver=sg.Solver(damping=0.2))
    return scene, arm_run(scene)


def test_the_iiwa_on_mujoco(tmp_path: Path) -> None:
    """At rest at the end, within the URDF's limits, off the prescribed decay by less than 1 mm, as on our own plant."""
    one = mujoco_figures.arm("iiwa_position", mujoco_figures.undamped(iiwa_position.ROBOT_FILE, tmp_path))
    own, loop = ClosedLoop(one.scene, one.simulation), MujocoLoop(one.scene, one.simulation, one.file)
    assert max(disagreement(one.scene, loop.plant).values()) < 1e-9
    told = " | ".join(loop.differences)
    assert "geometry is left out" in told
    assert "frame lbr_iiwa_link_7: the same to" in told
    for rate, off in ((1000, 1e-3), (200, 5e-3)):
        found, figures = mujoco_figures.run(one, rate, 8.0, own, loop)
        assert found.stop.reason == "finished"
        assert figures.statuses == (0,)
        assert figures.speed < 0.2
        assert figures.effort < 0.2
        assert figures.off_decay < off
        assert figures.rest < 1e-3
        assert figures.beside < 1e-6


def test_both_worlds_tell_the_same_of_a_flaw(planar: tuple[sg.Scene, sg.Simulation], tmp_path: Path) -> None:
    """Joint damping that the model has not, and torque that the actuators have not: same rows, same verdict."""
    scene, simulation = planar
    anywhere = (-np.inf, np.inf)
    simulation = replace(simulation, domain={"q": anywhere, "u": anywhere})
    limits = np.full(3, 100.0)
    worlds = mujoco_figures.Worlds(mujoco_figures.Arm(scene, simulation, write(tmp_path), limits, limits), "hand")
    words = []
    for flaw in (
        mujoco_figures.Flaw("none"),
        mujoco_figures.Flaw("damped", damping=1.5),
        mujoco_figures.Flaw("weak", machine={"actuators": sg.Actuators(limit=20.0)}),
    ):
        theirs, ours = worlds.runs(flaw, duration=1.5)
        np.testing.assert_allclose(theirs.q, ours.q, atol=1e-5)
        assert theirs.verdict.word == ours.verdict.word
        words.append(ours.verdict.word)
    assert words == ["held", "not held", "limited"]


def test_past_full_reach_and_back(planar: tuple[sg.Scene, sg.Simulation], tmp_path: Path) -> None:
    """The target leaves what the arm can reach (1.2 m) and comes back: torques stay an arm's, the end recovers."""
    scene, simulation = planar
    line = {"r": lambda t: ca.vertcat(0.9 + 0.2 * (1 - ca.cos(2 * ca.pi * t / 6)), 0.3)}
    simulation = replace(simulation, start={"q": [-0.5, 0.9, 0.9], "u": [0, 0, 0]}, references=line, stop={})
    found = MujocoLoop(scene, simulation, write(tmp_path)).run()
    size = np.linalg.norm(found.constraint, axis=1)
    assert found.stop.reason == "finished"
    assert sg.Status.REGULARISED in found.status
    assert 0.1 < size[3000] < 0.2  # sqrt(1.3^2 + 0.3^2) - 1.2 m is out of reach
    assert size[-1] < 2e-3
    assert np.max(np.abs(found.tau)) < 60  # gravity alone asks 28 N m of the stretched arm


def test_what_differs_is_told(planar: tuple[sg.Scene, sg.Simulation], tmp_path: Path) -> None:
    """Damping, armature, limits, shapes, actuators, joints of other names and joints that the scene has not."""
    scene, simulation = planar
    same = load_plant(scene, write(tmp_path))
    assert max(disagreement(scene, same).values()) < 1e-9
    assert same.remarks == (
        "joints are taken in their order, for none is named as in the scene: "
        "theta_0 = shoulder, theta_1 = elbow, theta_2 = wrist",
    )
    other = write(
        tmp_path,
        joint='damping="0.7" armature="0.01" range="-3 3" limited="true"',
        more='<actuator><position joint="elbow" kp="9"/></actuator>',
    )
    told = MujocoLoop(scene, simulation, other).differences
    assert "its 1 actuators are switched off: the controller's torques act on the joints" in told
    assert any(line.startswith("mass matrix: DIFFERS by 0.00") for line in told)
    assert any(line.startswith("bias forces: the same to") for line in told)
    assert "it adds joint damping, N m s/rad or N s/m: 0.7, 0.7, 0.7" in told
    assert "it adds armature, kg m^2 or kg: 0.01, 0.01, 0.01" in told
    assert "it stops 3 of 3 joints at their limits" in told


def test_joints_go_by_their_names_and_others_are_locked(tmp_path: Path) -> None:
    """The order of q is the scene's; a joint that it has not stands at zero, and what was bound to it goes."""
    q, u, tau = ca.vertcat(*map(ca.SX.sym, ("wrist", "shoulder", "elbow"))), ca.SX.sym("u", 3), ca.SX.sym("tau", 3)
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=ca.DM.eye(3), P=-u, G=ca.DM.eye(3))
    scene = sg.Scene("named", mech, [sg.Nonholonomic("still", u, Theta=-1.0)])
    bound = '<equality><joint joint1="finger"/></equality><keyframe><key qpos="0 0 0 1"/></keyframe>'
    plant = load_plant(scene, write(tmp_path, tip=FINGER, more=bound))
    assert plant.remarks == ("locked at zero, for the scene has them not: finger",)
    plant.start(1e-3, np.array([3.0, 1.0, 2.0]), np.zeros(3))
    assert list(plant.data.qpos) == [1.0, 2.0, 3.0]
    assert list(plant.state()[0]) == [3.0, 1.0, 2.0]


def slider(folder: Path) -> Path:
    file = folder / "slider.xml"
    file.write_text(
        '<mujoco><option integrator="RK4" timestep="3e-4"/><worldbody><body><joint name="x" type="slide" axis="1 0 0"/>'
        '<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/></body></worldbody></mujoco>'
    )
    return file


def same(a: Trajectory, b: Trajectory) -> bool:
    return a.stop == b.stop and all(
        np.allclose(getattr(a, n), getattr(b, n), atol=1e-9) for n in ("t", "q", "u", "tau", "constraint", "ideal")
    )


@pytest.mark.parametrize("duration", [0.5, 2.0])
def test_the_loop_is_our_own_with_another_plant(
    own_scenes: Any, rail_loop: Any, duration: float, tmp_path: Path
) -> None:
    """Parameters, references, stop expressions and the step that does not divide: the rail stops half way."""
    loop = MujocoLoop(*own_scenes["rail"](), slider(tmp_path))
    options = {"duration": duration, "references": {"r": 2.0}, "step": 2e-3}
    found = loop.run(**options)
    assert same(found, rail_loop.run(**options, hold=True))
    assert found.stop.event == ("half way" if duration == 2.0 else "")
    assert np.allclose(found.outputs["power, mechanical"], found.tau[:, 0] * found.u[:, 0])


def test_controls_involved_scenes_have_a_state_of_their_own(tmp_path: Path) -> None:
    """tau is projected at first, and stepped at each tick, as in our own loop."""
    x, v, force = ca.SX.sym("x"), ca.SX.sym("v"), ca.SX.sym("F")
    mech = sg.Mechanism(q=x, u=v, tau=force, Q=2.0, P=0, G=1)
    phi = sg.ControlsInvolved("spring", force + 3 * x + v, Theta=-5.0)
    scene, simulation = sg.Scene("spring", mech, [phi]), sg.Simulation(start={"q": 1.0, "u": 0.0, "tau": 0.0})
    for project in (True, False):
        options: dict[str, Any] = {"duration": 1.0, "step": 1e-3, "project": project}
        found = MujocoLoop(scene, simulation, slider(tmp_path)).run(**options)
        assert same(found, ClosedLoop(scene, simulation).run(**options, hold=True))


def test_the_machine_is_the_same_in_both_worlds(tmp_path: Path) -> None:
    """Noise, steps, delay, limits and lag of the simulation: the same draws, so the same motion on the same mass."""
    x, v, force = ca.SX.sym("x"), ca.SX.sym("v"), ca.SX.sym("F")
    mech = sg.Mechanism(q=x, u=v, tau=force, Q=2.0, P=0, G=1)
    scene = sg.Scene("pulled", mech, [sg.Holonomic("home", x, -4.0, -4.0)])
    machine = {"noise": {"q": 1e-3, "u": 1e-2}, "quantise": {"q": 1e-3}, "delay": 3e-3, "hold": 4e-3, "seed": 5}
    actuators = sg.Actuators(limit=4.0, rate=200.0, lag=5e-3)
    simulation = sg.Simulation(start={"q": 1.0, "u": 0.0}, duration=2.0, step=4e-3, actuators=actuators, **machine)
    ours, theirs = ClosedLoop(scene, simulation).run(), MujocoLoop(scene, simulation, slider(tmp_path)).run()
    assert np.max(np.abs(ours.q - theirs.q)) < 1e-6
    assert np.array_equal(ours.limited, theirs.limited)
    assert np.any(ours.limited)
    assert ours.verdict.word == theirs.verdict.word
    with pytest.raises(sg.SceneError, match="MuJoCo's model is the plant"):
        MujocoLoop(scene, replace(simulation, disturbance={"tau": 1.0}), slider(tmp_path))


def test_a_plant_that_explodes_is_a_failed_run(tmp_path: Path) -> None:
    """MuJoCo starts anew where its numbers are not finite; the run ends there instead."""
    x, v, force = ca.SX.sym("x"), ca.SX.sym("v"), ca.SX.sym("F")
    mech = sg.Mechanism(q=x, u=v, tau=force, Q=2.0, P=-1e6 * v**3, G=1)  # it thinks so, and pushes against it
    scene = sg.Scene("pushed", mech, [sg.Nonholonomic("still", v, Theta=-1.0)])
    found = MujocoLoop(scene, sg.Simulation(start={"q": 0.0, "u": 10.0}), slider(tmp_path)).run(duration=1.0, step=1e-2)
    assert (found.stop.reason, found.stop.status) == ("plant", sg.Status.NONFINITE)
    assert np.all(np.isfinite(found.u))


def test_errors_of_a_model(planar: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, simulation = planar
    for text, words in (
        ("<mujoco", "is no model for MuJoCo"),
        ("<mujoco><nonsense/></mujoco>", "is no model for MuJoCo"),
        ("<mujoco/>", "has 0 joints"),
        (ARM.format(joint="", tip=FINGER, more=""), "name the symbols of q as the joints"),
        (ARM.format(joint="", tip="", more="").replace("shoulder", "theta_0"), "has no joint theta_1, theta_2"),
        (ARM.format(joint='type="ball"', tip="", more=""), "is a ball or free joint"),
    ):
        file = tmp_path / "wrong.xml"
        file.write_text(text)
        with pytest.raises(sg.SceneError, match=words):
            MujocoLoop(scene, simulation, file)
    with pytest.raises(sg.SceneError, match="No such file"):
        MujocoLoop(scene, simulation, tmp_path / "nowhere.xml")
    with pytest.raises(sg.SceneError, match="has a C or D"):
        MujocoLoop(*load_simulation("quaternion_pointing"), write(tmp_path))
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ToolMissing, match=r"pip install 'servogen\[mujoco\]'"):
        MujocoLoop(scene, simulation, write(tmp_path))


SCENE = """
import casadi as ca
import servogen as sg
q, u, tau = (ca.SX.sym(n) for n in ("q", "u", "tau"))
mech = sg.Mechanism(q=q, u=u, tau=tau, Q=1, P=0, G=1)
scene = sg.Scene("falls", mech, [sg.Nonholonomic("n", u - 1, Theta=-1.0)])
simulation = sg.Simulation(start={"q": 0, "u": 0})
"""


def command(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["servogen", "simulate", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        main.main()
    return int(end.value.code or 0)


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    file, model = tmp_path / "falls.py", slider(tmp_path)
    file.write_text(SCENE)
    options = ("--mujoco", model, "--duration", "0.1", "--out", tmp_path / "run", "--no-plots")
    assert command(monkeypatch, file, *options) == 1  # twice the mass: psi' = -psi is not what happens
    told = capsys.readouterr().out
    assert "not held" in told
    assert "joints are taken in their order" in told
    assert told.index("mass matrix: DIFFERS by 1") < told.index("finished")
    assert command(monkeypatch, file, *options, "--json") == 1
    found = json.loads(capsys.readouterr().out)
    assert found["hold"]
    assert any("mass matrix" in line for line in found["mujoco"]["differences"])
    for wrong in (("--target", "cortex-m4"), ("--method", "rk4")):
        assert command(monkeypatch, file, *options, *wrong) == 2
