"""What arms do on MuJoCo's physics: python -m servogen.bench.mujoco_figures [--panda panda.urdf] [--choices] [--flaws].

The figures of docs/singularity.md, for iiwa_position, iiwa_pose and a Panda at 1 kHz, 500 Hz and 200 Hz, each beside
our own plant; past full reach and back; with --choices other y and W in their place; with --flaws iiwa_position on
machines with one flaw each, in both worlds. The Panda's URDF is that of the
package example-robot-data. Files are taken without their joints' damping, which the scenes' models have not.
"""

import argparse
import re
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from servogen.results import FloatArray
from servogen.scene.constraints import Holonomic
from servogen.scene.mechanism import Mechanism
from servogen.scene.scene import Scene
from servogen.scene.solver import Solver
from servogen.scene.symbols import Ref, References
from servogen.scenes import iiwa_position
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.machine import Actuators
from servogen.simulate.mujoco_plant import MujocoLoop, disagreement, load_plant
from servogen.simulate.simulation import Simulation
from servogen.simulate.trajectory import Trajectory
from servogen.simulate.wanted import load_simulation
from servogen.urdf.load import load
from servogen.urdf.robot import Robot

RATES = (1000, 500, 200)
PANDA_TOOL = "panda_hand_tcp"
PANDA_CENTRE = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)


@dataclass(frozen=True, eq=False)
class Arm:
    """A scene and its run on a robot's file; speed, effort: the joints' limits as the file has them, rad/s and N m."""

    scene: Scene
    simulation: Simulation
    file: Path
    speed: FloatArray
    effort: FloatArray


@dataclass(frozen=True)
class Figures:
    """Of a run: speeds and torques as parts of the joints' limits, deviations in m or as psi has them.

    rest: the fastest joint in the last second, rad/s. beside: how far psi is from that of our own plant at the same
    rate, as a part of psi at the start.
    """

    speed: float
    effort: float
    off_decay: float
    rest: float
    beside: float
    statuses: tuple[int, ...]
    finished: bool


def undamped(file: Path, folder: Path) -> Path:
    """A copy of a URDF whose joints have no damping and no friction."""
    text = re.sub(r"<dynamics[^>]*/>", "", file.read_text())
    copy = folder / f"{file.stem}_undamped.urdf"
    copy.write_text(text)
    return copy


def limits(file: Path, joints: Sequence[str]) -> tuple[FloatArray, FloatArray]:
    """Speed and effort of joints, from the URDF."""
    found = {j.get("name"): j.find("limit") for j in ET.parse(file).getroot().iter("joint")}
    rows = [row for name in joints if (row := found[name]) is not None]
    speed, effort = (np.array([float(row.get(what, "inf")) for row in rows]) for what in ("velocity", "effort"))
    return speed, effort


def arm(name: str, file: Path) -> Arm:
    """A built-in scene of the iiwa."""
    scene, simulation = load_simulation(name)
    robot = iiwa_position.robot
    return Arm(scene, simulation, file, *limits(file, robot.joints))


def panda(file: Path) -> Arm:
    """The built-in scene's constraint and posture on another robot: 0.3 m in three seconds, from 35 mm off."""
    robot = load(file, joints=[f"panda_joint{k}" for k in range(1, 8)], quiet=True)
    scene = position_scene(robot, "panda_position", PANDA_TOOL, PANDA_CENTRE)
    home = _place(robot, PANDA_TOOL, PANDA_CENTRE)
    start = home + np.array([-0.02, 0.02, -0.02])
    end = start + np.array([0.05, 0.25, 0.15])

    def course(t: Any) -> Any:
        return iiwa_position.minimum_jerk(t, list(start), list(end), 3.0)

    simulation = Simulation(
        start={"q": PANDA_CENTRE, "u": [0.0] * 7}, references={"r": course}, units={"psi": "m"}, duration=8.0
    )
    return Arm(scene, simulation, file, *limits(file, robot.joints))


def position_scene(robot: Robot, name: str, tool: str, centre: Sequence[float], solver: Solver | None = None) -> Scene:
    """A tool that follows a point, with the inverse mass as weight and a posture."""
    ref = References(r=Ref([0.5, 0.0, 0.5], order=2))
    at = np.array(centre)
    return Scene(
        name,
        robot.mechanism,
        [Holonomic("position", robot.position(tool) - ref.r, Theta1=-20.0, Theta2=-100.0)],
        references=ref,
        weight="inverse_mass",
        y=robot.posture(iiwa_position.DAMPING, iiwa_position.STIFFNESS, centre),
        domain={"q": (at - 0.8, at + 0.8), "u": (-1.0, 1.0), "r": ((0.2, -0.5, 0.2), (0.7, 0.5, 0.8))},
        solver=solver or Solver(),
    )


def past_reach(robot: Robot, file: Path, tool: str, centre: Sequence[float], damping: float | None = 0.2) -> Arm:
    """Out along a line to 10 mm past full reach in six seconds, two there, and back."""
    shoulder, reach = _reach(robot, tool, centre)
    scene = position_scene(robot, "past_reach", tool, centre, Solver(damping=damping))
    start = _place(robot, tool, centre)
    along = start - shoulder
    end = shoulder + along / np.linalg.norm(along) * (reach + 0.01)

    def course(t: Any) -> Any:
        out = iiwa_position.minimum_jerk(t, list(start), list(end), 6.0)
        back = iiwa_position.minimum_jerk(ca.fmax(t - 8.0, 0), [0.0] * 3, list(start - end), 6.0)
        return out + back

    simulation = Simulation(start={"q": list(centre), "u": [0.0] * 7}, references={"r": course}, duration=18.0)
    return Arm(scene, simulation, file, *limits(file, robot.joints))


def _place(robot: Robot, tool: str, q: Sequence[float]) -> FloatArray:
    return np.array(ca.Function("place", [robot.q], [robot.position(tool)])(np.array(q))).ravel()


def _reach(robot: Robot, tool: str, centre: Sequence[float]) -> tuple[FloatArray, float]:
    """A point at the shoulder, and how far from it the tool can get in the direction it has at the centre.

    By Newton's steps with damping towards points farther and farther away.
    """
    place = ca.Function("place", [robot.q], [robot.position(tool), robot.jacobian(tool)[:3, :]])
    shoulder = np.array([0.0, 0.0, _place(robot, tool, [0.0] * len(centre))[2] * 0.3])
    q = np.array(centre)
    direction = _place(robot, tool, centre) - shoulder
    direction /= np.linalg.norm(direction)
    farthest = 0.0
    for distance in np.linspace(0.3, 2.0, 400):
        for _ in range(5):
            at, J = (np.array(v) for v in place(q))
            missing = shoulder + distance * direction - at.ravel()
            q = q + J.T @ np.linalg.solve(J @ J.T + 1e-4 * np.eye(3), missing)
        at = _place(robot, tool, list(q))
        along = float((at - shoulder) @ direction)
        if np.linalg.norm(at - shoulder - along * direction) > 1e-3:
            break
        farthest = max(farthest, along)
    return shoulder, farthest


def run(arm: Arm, rate: int, seconds: float, own: ClosedLoop, loop: MujocoLoop) -> tuple[Trajectory, Figures]:
    """MuJoCo's run at a rate (Hz), and its figures beside our own plant's."""
    options: dict[str, Any] = {"step": 1 / rate, "duration": seconds}
    found, ours = loop.run(**options), own.run(**options, hold=True)
    common = min(len(found.t), len(ours.t))
    apart = np.linalg.norm(found.constraint[:common] - ours.constraint[:common], axis=1)
    late = found.t >= found.t[-1] - 1
    return found, Figures(
        speed=float(np.max(np.abs(found.u) / arm.speed)),
        effort=float(np.max(np.abs(found.tau) / arm.effort)),
        off_decay=float(np.max(np.linalg.norm(found.constraint - found.ideal, axis=1))),
        rest=float(np.max(np.abs(found.u[late]))),
        beside=float(np.max(apart) / np.linalg.norm(found.constraint[0])),
        statuses=tuple(sorted({int(s) for s in found.status})),
        finished=found.stop.reason == "finished",
    )


def table(arms: Sequence[Arm], rates: Sequence[int], seconds: float) -> Iterator[tuple[str, int, Figures]]:
    """Each arm at each rate."""
    for one in arms:
        own = ClosedLoop(one.scene, one.simulation)
        loop = MujocoLoop(one.scene, one.simulation, one.file)
        for rate in rates:
            yield one.scene.name, rate, run(one, rate, seconds, own, loop)[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--panda", type=Path, help="a Franka Panda's URDF")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--flaws", action="store_true", help="iiwa_position on machines with a flaw each, instead")
    parser.add_argument("--choices", action="store_true", help="y and W of iiwa_position exchanged, instead")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        iiwa = undamped(iiwa_position.ROBOT_FILE, Path(folder))
        if options.choices:
            show_choices(iiwa)
            return
        if options.flaws:
            show_flaws(arm("iiwa_position", iiwa), iiwa_position.END_EFFECTOR, FLAWS)
            return
        arms = [arm("iiwa_position", iiwa), arm("iiwa_pose", iiwa)]
        robot, file, tool = iiwa_position.robot, iiwa, iiwa_position.END_EFFECTOR
        centre = tuple(iiwa_position.CENTRE)
        if options.panda is not None:
            file = undamped(options.panda, Path(folder))
            arms.append(panda(file))
            robot = load(file, joints=[f"panda_joint{k}" for k in range(1, 8)], quiet=True)
            tool, centre = PANDA_TOOL, PANDA_CENTRE
        for one in arms:
            gaps = disagreement(one.scene, MujocoLoop(one.scene, one.simulation, one.file).plant)
            print(one.scene.name, ", ".join(f"{n} {gap:.1g}" for n, gap in gaps.items()))
        print("\nscene            Hz   speed/limit  torque/limit  off decay  at rest   beside own plant  statuses")
        for name, rate, f in table(arms, RATES, options.seconds):
            print(
                f"{name:15} {rate:5}   {f.speed:10.3f}   {f.effort:10.3f}   {f.off_decay:8.2e}  {f.rest:8.1e}"
                f"   {f.beside:14.1e}  {f.statuses}{'' if f.finished else ' STOPPED'}"
            )
        for damping in (0.2, None):
            print(f"\npast full reach, damping {damping}:")
            show_reach(past_reach(robot, file, tool, centre, damping))


def show_choices(file: Path) -> None:
    """The motion of iiwa_position with other choices of y and W; no margin ends it."""
    robot, plain = iiwa_position.robot, iiwa_position.scene_of(iiwa_position.robot)
    simulation = replace(iiwa_position.simulation, stop={}, tau_max=None)
    damped, held = robot.posture(6.0), robot.posture(6.0, 9.0, iiwa_position.CENTRE)
    choices = {
        "0, I": plain,
        "-5 u, I": replace(plain, y=-5.0 * robot.u),
        "posture(6), I": replace(plain, y=damped),
        "0, Q^-1": replace(plain, weight="inverse_mass"),
        "posture(6), Q^-1": replace(plain, y=damped, weight="inverse_mass"),
        "posture(6, 9, centre), Q^-1": replace(plain, y=held, weight="inverse_mass"),
    }
    for name, scene in choices.items():
        loop = MujocoLoop(scene, simulation, file)
        for rate in (1000, 200):
            found = loop.run(step=1 / rate)
            fast = np.max(np.abs(found.u), axis=1)
            late = found.t[np.argmax(fast > iiwa_position.JOINT_SPEED)]
            off = np.max(np.linalg.norm(found.constraint - found.ideal, axis=1))
            print(
                f"y, W = {name:28} {rate:5} Hz  {found.stop}  {np.max(fast):.4g} rad/s"
                f"{f', too fast at {late:.3f} s' if np.max(fast) > iiwa_position.JOINT_SPEED else ''}, at last "
                f"{fast[-1]:.1e}  {np.max(np.abs(found.tau)):.4g} N m  off decay {off:.2e} m  "
                f"statuses {sorted(set(found.status.tolist()))}",
                flush=True,
            )


@dataclass(frozen=True)
class Flaw:
    """What a machine has and the controller's model has not, in words, and alike in both worlds.

    damping (N m s/rad), armature (kg m^2): of every joint. payload: kg, a point at the tool. machine: options of
    ClosedLoop.run for sensors, delay and actuators.
    """

    words: str
    damping: float = 0.0
    armature: float = 0.0
    payload: float = 0.0
    machine: Mapping[str, Any] = field(default_factory=dict)


FLAWS = (
    Flaw("none"),
    Flaw("joint damping 0.5 N m s/rad", damping=0.5),
    Flaw("armature 0.01 kg m^2", armature=0.01),
    Flaw("armature 0.3 kg m^2", armature=0.3),
    Flaw("payload 0.1 kg", payload=0.1),
    Flaw("payload 2 kg", payload=2.0),
    Flaw("noise of q 1e-5, of u 1e-4", machine={"noise": {"q": 1e-5, "u": 1e-4}}),
    Flaw("noise of q 1e-3, of u 1e-2", machine={"noise": {"q": 1e-3, "u": 1e-2}}),
    Flaw("delay 2 ms", machine={"delay": 2e-3}),
    Flaw("delay 20 ms", machine={"delay": 20e-3}),
    Flaw("30 N m at most", machine={"actuators": Actuators(limit=30.0)}),
)
"""Of an arm whose joints need up to 41 N m."""


def loaded(file: Path, tool: str, payload: float, folder: Path) -> Path:
    """A copy of a URDF with a point mass, in kg, at the origin of a link."""
    link = f'<link name="payload"><inertial><mass value="{payload!r}"/>{_NO_INERTIA}</inertial></link>'
    joint = f'<joint name="payload" type="fixed"><parent link="{tool}"/><child link="payload"/></joint>'
    copy = folder / f"{file.stem}_loaded.urdf"
    copy.write_text(file.read_text().replace("</robot>", f"{link}{joint}</robot>"))
    return copy


_NO_INERTIA = '<inertia ixx="1e-9" ixy="0" ixz="0" iyy="1e-9" iyz="0" izz="1e-9"/>'


class Worlds:
    """An arm in MuJoCo's world and in our own, with the same flaws in both."""

    def __init__(self, arm: Arm, tool: str) -> None:
        self._arm, self._tool = arm, tool
        self._theirs = MujocoLoop(arm.scene, arm.simulation, arm.file)
        self._ours = ClosedLoop(arm.scene, arm.simulation)

    def runs(self, flaw: Flaw, **options: Any) -> tuple[Trajectory, Trajectory]:
        """MuJoCo's run with a flaw and our own, with one tick a millisecond unless the options say otherwise."""
        options = {"step": 1e-3, **options, **flaw.machine}
        arm, theirs = self._arm, self._theirs
        with tempfile.TemporaryDirectory() as folder:
            file = loaded(arm.file, self._tool, flaw.payload, Path(folder)) if flaw.payload else arm.file
            theirs.plant = load_plant(arm.scene, file)
            mech = load(file, quiet=True).mechanism if flaw.payload else arm.scene.mechanism
        theirs.plant.model.dof_damping[theirs.plant.dofs] = flaw.damping
        theirs.plant.model.dof_armature[theirs.plant.dofs] = flaw.armature
        ours = self._ours
        if flaw.payload or flaw.damping or flaw.armature:
            Q = mech.Q + flaw.armature * ca.SX.eye(mech.u.size1())
            own = Mechanism(q=mech.q, u=mech.u, tau=mech.tau, Q=Q, P=mech.P - flaw.damping * mech.u, G=mech.G)
            ours = ClosedLoop(arm.scene, replace(arm.simulation, plant=own))
        return theirs.run(**options), ours.run(**options, hold=True)


def show_flaws(arm: Arm, tool: str, flaws: Sequence[Flaw]) -> None:
    """Both worlds' verdicts, largest deviations from the prescribed decay, and torques as parts of the limits."""
    worlds = Worlds(arm, tool)
    for flaw in flaws:
        told = []
        for run in worlds.runs(flaw):
            off = float(np.max(np.linalg.norm(run.constraint - run.ideal, axis=1)))
            told.append(f"{run.verdict.word:24} {off:8.2e} m  {np.max(np.abs(run.tau) / arm.effort):.3f}")
        print(f"{flaw.words:28} MuJoCo: {told[0]}   own: {told[1]}", flush=True)


def show_reach(far: Arm) -> None:
    """Past full reach and back: the largest torque as a part of its limit, the error there, and afterwards."""
    loop = MujocoLoop(far.scene, far.simulation, far.file)
    for rate in RATES:
        found = loop.run(step=1 / rate)
        size = np.linalg.norm(found.constraint, axis=1)
        there = (found.t > 6.5) & (found.t < 8.0)
        print(
            f"{rate:5} Hz  {found.stop}  torque/limit {np.max(np.abs(found.tau) / far.effort):.3f} "
            f"({np.max(np.abs(found.tau)):.0f} N m)  speed/limit {np.max(np.abs(found.u) / far.speed):.3f}  "
            f"out there {np.max(size[there]) if np.any(there) else np.nan:.4f} m  at last {size[-1]:.1e} m, "
            f"{np.max(np.abs(found.u[-1])):.1e} rad/s"
        )


if __name__ == "__main__":
    main()
