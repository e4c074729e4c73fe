"""What joins bodies beside their joints: MuJoCo's equalities as passive constraints of a robot."""

import re
from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca

from servogen.errors import SceneError
from servogen.mjcf.bodies import Reader, decimals
from servogen.scene.passive import PassiveHolonomic
from servogen.urdf.exact import IDENTITY
from servogen.urdf.robot import Robot


@dataclass(frozen=True)
class Closing:
    """Two frames that are held together."""

    name: str
    frame_a: str
    frame_b: str
    what: Literal["position", "pose"]


@dataclass(frozen=True)
class Coupling:
    """q_joint - place = sum of factors_k (q_leader - leader_place)^k, the leader's None where there is none."""

    name: str
    joint: str
    leader: str | None
    place: float
    leader_place: float
    factors: tuple[float, ...]


def read_equalities(reader: Reader) -> list[Closing | Coupling]:
    """Of the model, after its bodies; the frames they hold together become frames of the description.

    The i-th is named as in the file, else equality_i.
    """
    model, kinds = reader.model, reader.mujoco.mjtEq
    found: list[Closing | Coupling] = []
    for k in range(model.neq):
        name = re.sub(r"\W", "_", model.equality(k).name or f"equality_{k + 1}", flags=re.ASCII)
        ends = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
        if kinds(int(model.eq_type[k])) == kinds.mjEQ_JOINT:
            found.append(_coupling(reader, name, ends, model.eq_data[k]))
            continue
        weld = kinds(int(model.eq_type[k])) == kinds.mjEQ_WELD
        sites = int(model.eq_objtype[k]) == int(reader.mujoco.mjtObj.mjOBJ_SITE)
        frames = _sites(reader, name, ends) if sites else _points(reader, name, ends, model.eq_data[k], weld)
        found.append(Closing(name, *frames, "pose" if weld else "position"))
    return found


def hold(robot: Robot, equality: Closing | Coupling, stabilise: Any) -> None:
    """Adds it to the robot. SceneError where no joint can satisfy it."""
    if isinstance(equality, Closing):
        robot.close(equality.frame_a, equality.frame_b, equality.what, stabilise, equality.name)
        return
    off = 0 if equality.leader is None else robot.place(equality.leader) - equality.leader_place
    chi, power = robot.place(equality.joint) - equality.place, ca.SX(1)
    for factor in equality.factors:
        chi, power = chi - factor * power, power * off
    if chi.is_constant():
        raise SceneError(
            f"equality {equality.name!r}: joint {equality.joint!r} is locked by joints=[...]; let it move, or take the "
            "equality out of the file"
        )
    robot.hold(PassiveHolonomic(equality.name, chi, stabilise))


def _coupling(reader: Reader, name: str, ends: tuple[int, int], data: Any) -> Coupling:
    joint, leader = ends
    at, leads = (float(reader.model.qpos0[int(reader.model.jnt_qposadr[j])]) if j >= 0 else 0.0 for j in ends)
    factors = tuple(float(c) for c in data[: 5 if leader >= 0 else 1])
    while len(factors) > 1 and factors[-1] == 0:
        factors = factors[:-1]
    return Coupling(
        name, reader.joint_name(joint), reader.joint_name(leader) if leader >= 0 else None, at, leads, factors
    )


def _sites(reader: Reader, name: str, ends: tuple[int, int]) -> tuple[str, str]:
    model = reader.model
    first, second = (
        reader.attach(
            int(model.site_bodyid[k]),
            f"{name} ({end})",
            reader.rotation(model.site_quat[k], name),
            decimals(model.site_pos[k]),
        )
        for end, k in zip("ab", ends, strict=True)
    )
    return first, second


def _points(reader: Reader, name: str, ends: tuple[int, int], data: Any, weld: bool) -> tuple[str, str]:
    """The anchors of two bodies; a weld's first has the axes that the second body is to have."""
    turn = reader.rotation(data[6:10], name) if weld else IDENTITY
    points = (data[3:6], data[0:3]) if weld else (data[0:3], data[3:6])
    first = reader.attach(ends[0], f"{name} (a)", turn, decimals(points[0]))
    return first, reader.attach(ends[1], f"{name} (b)", IDENTITY, decimals(points[1]))
