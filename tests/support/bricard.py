"""Bricard's mechanism: five rods of 1 m and 1 kg and the ground, hinged in a ring along edges of a cube.

An over-constrained one of the benchmark library of IFToMM's committee for multibody dynamics: each hinge is
perpendicular to both of its rods, and the ring moves although counting its constraints says that it does not.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import servogen as sg

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1], [0, 1, 1], [0, 0, 1]])
RODS = np.diff(CORNERS, axis=0)
RING = [CORNERS[0] - CORNERS[5], *RODS, CORNERS[0] - CORNERS[5]]
AXES = [np.cross(RING[k], RING[k + 1]) for k in range(6)]
GRAVITY = 9.81


def numbers(values: Any) -> str:
    return " ".join(f"{float(v)!r}" for v in values)


def robot(folder: Path) -> sg.urdf.Robot:
    """The ring cut at its sixth hinge, where the frame "end" is."""
    parts = ['<robot name="bricard"><link name="rod_0"/>']
    for k, rod in enumerate(RODS, start=1):
        xx, yy, zz = (1 - np.abs(rod)) / 12
        begins = RODS[k - 2] if k > 1 else np.zeros(3)
        parts.append(
            f'<link name="rod_{k}"><inertial><origin xyz="{numbers(rod / 2)}"/><mass value="1"/>'
            f'<inertia ixx="{xx}" iyy="{yy}" izz="{zz}"/></inertial></link>'
            f'<joint name="hinge_{k}" type="continuous"><parent link="rod_{k - 1}"/><child link="rod_{k}"/>'
            f'<origin xyz="{numbers(begins)}"/><axis xyz="{numbers(AXES[k - 1])}"/></joint>'
        )
    parts.append(
        '<link name="end"/><joint name="tip" type="fixed"><parent link="rod_5"/><child link="end"/>'
        f'<origin xyz="{numbers(RODS[4])}"/></joint></robot>'
    )
    path = folder / "bricard.urdf"
    path.write_text("".join(parts))
    return sg.urdf.load(path, gravity=(0, -GRAVITY, 0), quiet=True)


def scene(ring: sg.urdf.Robot) -> sg.Scene:
    """The first hinge is to turn at a given speed by a motor of its own."""
    across = RODS[4], np.cross(AXES[5], RODS[4])
    turned = [ca.dot(AXES[5], ca.mtimes(ring.rotation("end"), v)) for v in across]
    hinge = sg.PassiveHolonomic("hinge_6", ca.vertcat(ring.position("end") - CORNERS[5], *turned), stabilise=10.0)
    mech = replace(ring.mechanism, tau=ca.SX.sym("motor"), G=[1, 0, 0, 0, 0], passive=[hinge])

    def near(generator: np.random.Generator) -> dict[str, Any]:
        """The motion in which hinges 1, 3 and 5 turn together, and 2 and 4 together."""
        a, rate = generator.uniform(-0.4, 0.4), generator.uniform(-1, 1)
        return {"q": [a, -a, a, -a, a], "u": [rate, -rate, rate, -rate, rate], "tau": generator.uniform(-1, 1)}

    return sg.Scene("bricard", mech, [sg.Nonholonomic("speed", mech.u[0] - 0.5, Theta=-1.0)], domain=near)
