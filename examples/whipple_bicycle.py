"""A bicycle that leans as it is told: wheels that roll, two motors, one on the steer and one on the rear wheel.

The benchmark bicycle of Meijaard et al. (2007), at angles of any size. The robot is a tree whose first six joints carry
the rear wheel freely; passive constraints hold both wheels on the ground (holonomic) and let them roll (nonholonomic).
Steering alone makes the bicycle lean, and the steer, which no constraint prescribes, settles where the turn needs it.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import servogen as sg

RADII = {"rear": 0.3, "front": 0.35}  # m

robot = sg.urdf.load(Path(__file__).with_suffix(".urdf"), gravity=(0, 0, 9.81), quiet=True)
motors = ca.SX.sym("motor", 2)  # torques on the steer and on the rear wheel, N m


def touching(wheel: str, radius: float) -> tuple[Any, Any]:
    """From the wheel's centre to its lowest point (z points downwards), and how far that is below the ground."""
    axle = robot.rotation(f"{wheel}_frame")[:, 1]  # the wheel turns about it
    steepest = ca.vertcat(0, 0, 1) - axle[2] * axle
    down = radius * steepest / ca.sqrt(1 - axle[2] ** 2)
    return down, robot.position(f"{wheel}_wheel")[2] + down[2]


def rolling(wheel: str, radius: float) -> list[Any]:
    """The lowest point is on the ground, and does not slip."""
    down, height = touching(wheel, radius)
    velocity = robot.velocity(f"{wheel}_wheel")
    slip = velocity[:3] + ca.cross(velocity[3:], down)
    return [
        sg.PassiveHolonomic(f"{wheel}_contact", height, stabilise=20.0),
        sg.PassiveNonholonomic(f"{wheel}_rolling", slip[:2], stabilise=20.0),
    ]


place = dict(zip(robot.joints, robot.q.nonzeros(), strict=True))
rate = dict(zip(robot.joints, robot.u.nonzeros(), strict=True))
G = np.zeros((len(robot.joints), 2))
G[robot.joints.index("steer"), 0] = G[robot.joints.index("rear_spin"), 1] = 1.0

mechanism = replace(
    robot.mechanism, tau=motors, G=G, passive=[c for wheel, r in RADII.items() for c in rolling(wheel, r)]
)
ref = sg.References(
    lean=sg.Ref(0.1, order=2, unit="rad", text="to the right"),
    speed=sg.Ref(4.0, order=1, unit="m/s", text="of the rear wheel"),
)


def states(generator: np.random.Generator) -> dict[str, Any]:
    """Near upright motion, brought onto the constraints by whoever asks."""
    at = {n: generator.uniform(-0.2, 0.2) for n in ("lean", "steer")}
    speed = generator.uniform(2.0, 6.0)
    u = {"x": speed, "rear_spin": -speed / RADII["rear"], "front_spin": -speed / RADII["front"]}
    u |= {n: generator.uniform(-0.3, 0.3) for n in ("lean", "steer")}
    return {"q": [at.get(n, 0.0) for n in robot.joints], "u": [u.get(n, 0.0) for n in robot.joints], "speed": speed,
            "lean": generator.uniform(-0.2, 0.2)}  # fmt: skip


scene = sg.Scene(
    "whipple_bicycle",
    mechanism,
    [
        sg.Holonomic("lean", place["lean"] - ref.lean, Theta1=-4.0, Theta2=-4.0),
        sg.Nonholonomic("speed", -RADII["rear"] * rate["rear_spin"] - ref.speed, Theta=-1.0),
    ],
    references=ref,
    domain=states,
)


def circle(wheel: str, radius: float) -> Any:
    """The rim in the world, z upwards, as a drawing wants it."""
    turn, centre = robot.rotation(f"{wheel}_wheel"), robot.position(f"{wheel}_wheel")
    angles = np.linspace(0, 2 * np.pi, 13)
    rim = np.array([radius * np.sin(angles), 0 * angles, radius * np.cos(angles)])
    return ca.mtimes(np.diag([1.0, -1.0, -1.0]), ca.mtimes(turn, rim) + centre)


def shown(frame: str, at: list[float]) -> Any:
    """A point of a frame, z upwards."""
    return ca.mtimes(np.diag([1.0, -1.0, -1.0]), robot.position(frame) + ca.mtimes(robot.rotation(frame), at))


frame_lines = ca.horzcat(
    shown("rear_frame", [0, 0, 0]), shown("rear_frame", [0.3, 0, -0.6]), shown("front_frame", [-0.3, 0, -0.9]),
    shown("front_frame", [-0.08, 0, -0.35]),
)  # fmt: skip
START = {"x": 4.0, "rear_spin": -4.0 / RADII["rear"], "front_spin": -4.0 / RADII["front"]}
simulation = sg.Simulation(
    start={"q": [0.0] * len(robot.joints), "u": [START.get(n, 0.0) for n in robot.joints]},
    duration=8.0,
    step=2e-3,
    domain={"q": (-np.inf, np.inf), "u": (-np.inf, np.inf)},
    outputs={"steer": place["steer"], "heading": place["yaw"]},
    drawing=[circle(wheel, r) for wheel, r in RADII.items()] + [frame_lines],
)
