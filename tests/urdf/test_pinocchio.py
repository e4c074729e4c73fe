"""Against Pinocchio, where it is installed (extra `robots`), at 1e-10 of the largest entry."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from support.robots import A1, IIWA, IIWA_TOOL, draw_state

TOLERANCE = 1e-10


@pytest.fixture(scope="module")
def pin(need_module: Callable[[str, str], ModuleType]) -> ModuleType:
    return need_module("pinocchio", "pin")


@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize(("path", "frame"), [(IIWA, IIWA_TOOL), (A1, "FL_toe"), (A1, "RR_upper")])
def test_agrees_with_pinocchio(
    path: Path, frame: str, base: str, need_module: Callable[[str, str], ModuleType]
) -> None:
    pin = need_module("pinocchio", "pin")
    floating = base == "floating"
    model = pin.buildModelFromUrdf(str(path), *([pin.JointModelFreeFlyer()] if floating else []))
    data = model.createData()
    names = [model.names[k] for k in range(2 if floating else 1, model.njoints)]
    robot = sg.urdf.load(path, base=base, joints=names, quiet=True, damping=None)  # type: ignore[arg-type]
    mech = robot.mechanism
    kinematics = [f(frame) for f in (robot.position, robot.rotation, robot.jacobian, robot.bias_acceleration)]
    ours = ca.Function("ours", [robot.q, robot.u], [mech.Q, -mech.P, *kinematics, robot.center_of_mass()])
    generator = np.random.default_rng(0)
    for _ in range(10):
        q, u, _ = draw_state(robot, generator)
        theirs = _pinocchio(
            pin, model, data, np.concatenate([q[:3], q[4:7], q[3:4], q[7:]]) if floating else q, u, frame
        )
        if not floating and path == A1:
            theirs = theirs[:-1]  # Pinocchio leaves out what is fixed to the world, here the trunk
        for name, value, expected in zip(
            "M nle position rotation J J'u centre".split(), ours(q, u), theirs, strict=False
        ):
            error = np.max(np.abs(np.array(value).reshape(expected.shape) - expected))
            assert error <= TOLERANCE * max(1e-3, np.max(np.abs(expected))), (name, error)


def _pinocchio(pin: ModuleType, model: Any, data: Any, q: Any, u: Any, frame: str) -> list[Any]:
    upper = np.triu(pin.crba(model, data, q))
    bias = pin.nonLinearEffects(model, data, q, u).copy()
    pin.forwardKinematics(model, data, q, u, np.zeros(model.nv))
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    k, axes = model.getFrameId(frame), pin.LOCAL_WORLD_ALIGNED
    a = pin.getFrameClassicalAcceleration(model, data, k, axes)
    placement = data.oMf[k]
    J = pin.getFrameJacobian(model, data, k, axes)
    turn, place = placement.rotation.copy(), placement.translation.copy()
    centre = pin.centerOfMass(model, data, q).copy()
    return [upper + np.triu(upper, 1).T, bias, place, turn, J, np.concatenate([a.linear, a.angular]), centre]
