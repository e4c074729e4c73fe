"""Robots that tests share."""

from pathlib import Path
from typing import Any

import numpy as np
import servogen as sg

ROBOTS = Path(__file__).parents[1] / "urdf" / "robots"
A1 = ROBOTS / "a1.urdf"
IIWA = Path(sg.__file__).parent / "scenes" / "robots" / "kuka_iiwa.urdf"
IIWA_TOOL, A1_FEET = "lbr_iiwa_link_7", ("FR_toe", "FL_toe", "RR_toe", "RL_toe")

# A tree with everything that is awkward: slanted axes and frames, prismatic joints within the chain and at its end,
# parallel offset axes, a branch, links without inertia, a rotor on the branch.
ODD = """<robot name="odd">
  <link name="world"><inertial><mass value="3"/>
    <inertia ixx="0.2" iyy="0.3" izz="0.25" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="a"><inertial><origin xyz="0.1 0.2 -0.1" rpy="0.3 -0.2 0.7"/><mass value="2"/>
    <inertia ixx="0.1" iyy="0.12" izz="0.09" ixy="0.01" ixz="-0.02" iyz="0.005"/></inertial></link>
  <link name="b"><inertial><origin xyz="0 0.1 0.3"/><mass value="1.5"/>
    <inertia ixx="0.05" iyy="0.06" izz="0.03" ixy="0" ixz="0.004" iyz="0"/></inertial></link>
  <link name="dummy"/>
  <link name="c"><inertial><origin xyz="0.2 0 0"/><mass value="0.7"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.025" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="d"><inertial><origin xyz="0 0 0.1"/><mass value="0.4"/>
    <inertia ixx="0.004" iyy="0.004" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="wheel"><inertial><origin xyz="0 0.05 0"/><mass value="0.3"/>
    <inertia ixx="0.002" iyy="0.003" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tool"/>
  <joint name="j1" type="continuous"><parent link="world"/><child link="a"/>
    <origin xyz="0.1 0 0.4" rpy="0.2 0.3 -0.4"/><axis xyz="1 2 -0.5"/></joint>
  <joint name="j2" type="prismatic"><parent link="a"/><child link="b"/>
    <origin xyz="0 0.3 0.1" rpy="1.57079632679 0 0.5"/><axis xyz="0 -1 0"/></joint>
  <joint name="j3" type="revolute"><parent link="b"/><child link="dummy"/>
    <origin xyz="0.2 0 0.1" rpy="0 -1.57079632679 0"/><axis xyz="0 0 -1"/></joint>
  <joint name="j4" type="revolute"><parent link="dummy"/><child link="c"/>
    <origin xyz="0.3 0.1 0"/><axis xyz="0 0 2"/></joint>
  <joint name="j5" type="prismatic"><parent link="c"/><child link="d"/>
    <origin xyz="0 0 0.2" rpy="0.4 0 0"/><axis xyz="0.6 0 0.8"/></joint>
  <joint name="spin" type="continuous"><parent link="a"/><child link="wheel"/>
    <origin xyz="-0.2 0.1 0" rpy="0.1 0 0"/><axis xyz="0 1 0"/></joint>
  <joint name="mount" type="fixed"><parent link="d"/><child link="tool"/>
    <origin xyz="0.1 0.2 0.3" rpy="0.5 1 2"/></joint>
</robot>
"""


def draw_state(robot: sg.urdf.Robot, generator: np.random.Generator) -> tuple[Any, Any, Any]:
    """q and u of a robot, and the pose of its base as a 4 x 4 matrix."""
    from support.particles import pose

    n, floating = len(robot.joints), robot.q.size1() > len(robot.joints)
    joints, u = generator.uniform(-2.5, 2.5, n), generator.uniform(-1.5, 1.5, robot.u.size1())
    if not floating:
        return joints, u, np.eye(4)
    place, o = generator.uniform(-1, 1, 3), generator.normal(size=4)
    w, x, y, z = o = o / np.linalg.norm(o)
    v = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.concatenate([place, o, joints]), u, pose(np.eye(3) + 2 * w * v + 2 * v @ v, place)
