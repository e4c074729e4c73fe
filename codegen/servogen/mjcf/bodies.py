"""MuJoCo's compiled bodies, joints and sites as the description of links and joints that robots are made of.

MuJoCo computes in doubles: what rounding leaves where a zero was meant is taken as zero, so that the robot's structure
is found. A body with several joints is a chain of links without inertia, one a joint.
"""

import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

from servogen.errors import SceneError
from servogen.ir.lower import decimal_value
from servogen.mjcf.model import compiled_model
from servogen.urdf.description import Description, Joint
from servogen.urdf.exact import (
    IDENTITY,
    ORIGIN,
    ZERO,
    Matrix,
    Vector,
    about,
    add,
    apply,
    multiply,
    scale,
    transpose,
    unit,
    vector,
)
from servogen.urdf.inertia import Inertia, second_moment
from servogen.urdf.vectors import Vec

_ROUNDING = 1e-14
"""Of the largest entry beside it: what is not larger is taken as zero."""
_QUARTER_TURN = 5e-6
"""Entries of a rotation that are this near to a rotation by quarter turns are meant as that."""


class Reader:
    """Reads one file, body by body; SceneError where it does not fit the base asked for."""

    def __init__(
        self,
        mujoco: ModuleType,
        path: str | Path,
        base: Literal["fixed", "floating"] | None,
        quarter_turns: bool,
    ) -> None:
        compiled = compiled_model(mujoco, path)
        self.mujoco, self.model, self.source = mujoco, compiled.model, compiled.source
        self.notes = list(compiled.notes)
        self._quarter_turns = quarter_turns
        self._links: dict[str, Inertia | None] = {}
        self._joints: list[Joint] = []
        self._bodies = [self.model.body(k).name or f"body_{k}" for k in range(self.model.nbody)]
        root = self._root(base)
        self.floating = root > 0
        self._inside = [root]
        self._links[self._bodies[root]] = self._inertia(root) if root else None
        for k in range(root + 1, self.model.nbody):
            if int(self.model.body_parentid[k]) in self._inside:
                self._inside.append(k)
                self._add_body(k)
        if root:
            self._check_alone()
        for k in range(self.model.nsite):
            at, name = int(self.model.site_bodyid[k]), self.model.site(k).name
            if name and at in self._inside:
                name = f"{name} (site)" if name in self._bodies else name
                self.attach(at, name, self.rotation(self.model.site_quat[k], name), decimals(self.model.site_pos[k]))

    def description(self) -> Description:
        """What was read, with the frames attached."""
        links, joints = dict(self._links), tuple(self._joints)
        return Description(self.source, links, joints, self._bodies[self._inside[0]], tuple(self.notes))

    def gravity(self) -> Vec:
        """The file's, m/s^2."""
        off = self.model.opt.disableflags & int(self.mujoco.mjtDisableBit.mjDSBL_GRAVITY)
        x, y, z = (0.0 if off else float(g) for g in self.model.opt.gravity)
        return x, y, z

    def attach(self, body: int, name: str, rotation: Matrix, origin: Vector) -> str:
        """A frame fixed to a body; returns its name. SceneError where the body does not belong to the base."""
        if body not in self._inside:
            raise SceneError(
                f"{self.source}: {name!r} is on {self._bodies[body]!r}, which stands beside the floating base; take it "
                "out of the file, or give base='fixed'"
            )
        self._links[name] = None
        self._joints.append(Joint(f"{name} (fixed)", "fixed", self._bodies[body], name, rotation, origin))
        return name

    def rotation(self, quaternion: Any, what: str) -> Matrix:
        """Of a quaternion (w, x, y, z), exactly orthogonal; near quarter turns exactly these, where they are wanted."""
        largest = max(abs(float(x)) for x in quaternion)
        w, x, y, z = (decimal_value(float(c)) if abs(c) > _ROUNDING * largest else ZERO for c in quaternion)
        square = w * w + x * x + y * y + z * z
        rows = (
            (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
        )
        found: Matrix = tuple(scale(1 / square, row) for row in rows)  # type: ignore[assignment]
        nearest: Matrix = tuple(tuple(Fraction(round(e)) for e in row) for row in found)  # type: ignore[assignment]
        off = float(
            max(abs(e - n) for row, near in zip(found, nearest, strict=True) for e, n in zip(row, near, strict=True))
        )
        if off > (_QUARTER_TURN if self._quarter_turns else _ROUNDING):
            return found
        if off > _ROUNDING:
            self.notes.append(f"{what}: its rotation, {off:.1g} off quarter turns, is taken as exactly these")
        return nearest

    # ------------------------------------------------------------------ bodies

    def _root(self, base: str | None) -> int:
        """The body that is the tree's root: the world, or the one free body."""
        free = [int(self.model.jnt_bodyid[k]) for k in range(self.model.njnt) if self._is_free(k)]
        if base == "fixed" or (base is None and not free):
            return 0
        if not free:
            raise SceneError(f"{self.source} has no free joint; give the base a <freejoint/>, or leave out base=")
        if len(free) > 1:
            names = ", ".join(self._bodies[k] for k in free)
            raise SceneError(f"{self.source} has several free bodies ({names}); leave one in it, or give base='fixed'")
        return free[0]

    def _check_alone(self) -> None:
        for k in range(self.model.njnt):
            if int(self.model.jnt_bodyid[k]) not in self._inside:
                raise SceneError(
                    f"{self.source}: joint {self.joint_name(k)!r} moves beside the free body "
                    f"{self._bodies[self._inside[0]]!r}; take one of the two out of the file, or give base='fixed', "
                    "which holds free bodies where the file places them"
                )

    def _inertia(self, k: int) -> Inertia | None:
        mass, moments = float(self.model.body_mass[k]), self.model.body_inertia[k]
        if mass == 0 and not moments.any():
            return None
        x, y, z = vector([float(m) for m in moments])
        second = second_moment(((x, ZERO, ZERO), (ZERO, y, ZERO), (ZERO, ZERO, z)))
        turn = self.rotation(self.model.body_iquat[k], f"body {self._bodies[k]!r}, inertial")
        turned = _cleaned(multiply(turn, multiply(second, transpose(turn))))
        own = Inertia(decimal_value(mass), ORIGIN, turned)
        return own.seen_from(IDENTITY, decimals(self.model.body_ipos[k]))

    def _add_body(self, k: int) -> None:
        """Its joints, each with the link that it moves; the last of them is the body."""
        name, model = self._bodies[k], self.model
        parent = self._bodies[int(model.body_parentid[k])]
        turn = self.rotation(model.body_quat[k], f"body {name!r}")
        first, count = int(model.body_jntadr[k]), int(model.body_jntnum[k])
        at, anchor = decimals(model.body_pos[k]), ORIGIN
        for j in range(first, first + count):
            moves = self._joint(j, parent)
            # where the joint stands at zero, which its angle in the file's drawing is not, if it has a ref
            there = decimals(model.jnt_pos[j])
            at = add(at, apply(turn, add(there, scale(Fraction(-1), anchor))))
            turn, at = self._at_zero(j, moves, turn, at)
            last = j == first + count - 1 and there == ORIGIN
            child = name if last else f"{name}/{moves.name}"
            self._links[child] = None
            self._joints.append(replace(moves, child=child, rotation=turn, origin=at))
            parent, turn, at, anchor = child, IDENTITY, ORIGIN, there
        if parent != name:  # what is left is fixed: a body without joints, or one whose last joint is not at its origin
            at = add(at, apply(turn, scale(Fraction(-1), anchor))) if count else at
            self._joints.append(Joint(f"{name} (fixed)", "fixed", parent, name, turn, at))
        self._links[name] = self._inertia(k)

    # ------------------------------------------------------------------ joints

    def _kind(self, j: int) -> str:
        kinds = self.mujoco.mjtJoint
        named = {kinds.mjJNT_HINGE: "continuous", kinds.mjJNT_SLIDE: "prismatic", kinds.mjJNT_BALL: "ball"}
        return named.get(kinds(int(self.model.jnt_type[j])), "fixed")  # a free body below a fixed base is held

    def _is_free(self, j: int) -> bool:
        return bool(self.model.jnt_type[j] == int(self.mujoco.mjtJoint.mjJNT_FREE))

    def joint_name(self, j: int) -> str:
        return self.model.joint(j).name or f"joint_{j}"

    def _joint(self, j: int, parent: str) -> Joint:
        """Between its two links, which the caller places."""
        model, kind, name = self.model, self._kind(j), self.joint_name(j)
        found = Joint(name, kind, parent, "")
        if kind not in ("continuous", "prismatic"):
            return found
        dof = int(model.jnt_dofadr[j])
        polynomials = model.dof_dampingpoly[dof].any(), model.jnt_stiffnesspoly[j].any()
        for what, there in zip(("damping", "stiffness"), polynomials, strict=True):
            if there:
                self.notes.append(f"joint {name!r}: of its {what} the linear part alone is taken")
        effort = float(abs(model.jnt_actfrcrange[j]).min()) if model.jnt_actfrclimited[j] else math.inf
        return replace(
            found,
            axis=unit(decimals(model.jnt_axis[j])),
            lower=float(model.jnt_range[j, 0]) if model.jnt_limited[j] else -math.inf,
            upper=float(model.jnt_range[j, 1]) if model.jnt_limited[j] else math.inf,
            effort=effort,
            damping=float(model.dof_damping[dof]),
            friction=float(model.dof_frictionloss[dof]),
            armature=float(model.dof_armature[dof]),
            stiffness=float(model.jnt_stiffness[j]),
            rest=float(model.qpos_spring[int(model.jnt_qposadr[j])]),
        )

    def _at_zero(self, j: int, joint: Joint, turn: Matrix, at: Vector) -> tuple[Matrix, Vector]:
        """Of the moved link, by what the joint has of it where the file draws it."""
        if joint.kind not in ("continuous", "prismatic"):
            return turn, at
        drawn = float(self.model.qpos0[int(self.model.jnt_qposadr[j])])
        if joint.kind == "prismatic":
            return turn, add(at, apply(turn, scale(decimal_value(-drawn), joint.axis)))
        return multiply(turn, about(joint.axis, -drawn)), at


def decimals(numbers: Any) -> Vector:
    """Three numbers of a model as decimals, those that rounding has left beside the others as zero."""
    largest = max(abs(float(x)) for x in numbers)
    return vector([float(x) if abs(x) > _ROUNDING * largest else 0.0 for x in numbers])


def _cleaned(m: Matrix) -> Matrix:
    largest = max(abs(e) for row in m for e in row)
    limit = largest * decimal_value(_ROUNDING)
    return tuple(tuple(e if abs(e) > limit else ZERO for e in row) for row in m)  # type: ignore[return-value]
