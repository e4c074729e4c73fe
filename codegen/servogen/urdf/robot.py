"""A robot as CasADi SX: its mechanism, and the kinematics of its links."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import casadi as ca

from servogen.errors import SceneError
from servogen.scene.convert import matrix
from servogen.scene.known_rates import Gauge, KnownRates
from servogen.scene.mechanism import Mechanism
from servogen.scene.passive import PassiveHolonomic
from servogen.urdf import dynamics, placement
from servogen.urdf.base import FLOATING_Q, FLOATING_TAU, FLOATING_U, fixed_base, floating_base, rate_map
from servogen.urdf.limits import JointLimits
from servogen.urdf.motion import Link, Motion, Motions, link, motions
from servogen.urdf.payload import Payload
from servogen.urdf.regroup import regroup
from servogen.urdf.skeleton import skeleton
from servogen.urdf.tree import Drive, Frame, Tree
from servogen.urdf.vectors import NOWHERE, Mat, Vec, column, cross, plus, times

FRICTION_WIDTH = 0.01
"""rad/s or m/s: friction="tanh" is friction tanh(rate / width), within 1 % of itself from 2.7 widths on."""
_ROUNDING = 1e-12
"""m or sine: frames that no joint can bring nearer are together where they are not farther apart."""


@dataclass(frozen=True, eq=False)
class Joints:
    """What resists each moving body's joint, by body from 1 on: numbers or SX; none where it is 0.

    damping: N m s/rad or N s/m. friction: N m or N. armature: kg m^2 or kg, of what turns with the joint. stiffness:
    N m/rad or N/m, of a spring at ease at `rest`, rad or m.
    """

    damping: Sequence[Any]
    friction: Sequence[Any]
    armature: Sequence[Any]
    stiffness: Sequence[Any]
    rest: Sequence[Any]

    def force(self, links: Sequence[Link]) -> list[Any]:
        """Of damping and friction against the joints' rates, and of springs against their places."""
        found = []
        for k, at in enumerate(links):
            d, f, s = self.damping[k], self.friction[k], self.stiffness[k]
            force = 0.0 if _is_zero(d) else d * at.u
            force = force if _is_zero(f) else force + f * ca.tanh(at.u / FRICTION_WIDTH)
            found.append(force if _is_zero(s) else force + s * (at.q - self.rest[k]))
        return found


class Robot:
    """A tree of rigid bodies from a file; every result is SX of `q` and `u`. Frames are named by links.

    q: n joint coordinates (rad, m), after position (m) and unit quaternion (w, x, y, z) of a floating base.
    u: n joint rates, after linear and angular velocity of a floating base in its own axes. tau: n joint efforts; of a
    single free body without joints, the force (N) and moment (N m) on it at its frame's origin, in its own axes.
    notes: what was read otherwise than written (angles taken as exact quarter turns). limits: of the joints.
    """

    def __init__(
        self,
        tree: Tree,
        joints: Sequence[str],
        floating: bool,
        gravity: Vec,
        notes: Sequence[str],
        resisting: Joints,
        payloads: Sequence[Payload],
        limits: JointLimits,
    ) -> None:
        self.joints = tuple(joints)
        self.notes = tuple(notes)
        self.limits = limits
        names = self.joints
        self.q = _symbols((*FLOATING_Q, *names) if floating else names)
        rates = tuple(f"{name}_rate" for name in names)
        self.u = _symbols((*FLOATING_U, *rates) if floating else rates)
        self.tau = _symbols(tuple(f"{name}_effort" for name in names) if names else FLOATING_TAU)
        self._base = floating_base(self.q, self.u, gravity) if floating else fixed_base(gravity)
        self._resisting = resisting
        self._loads: dict[int, dynamics.Composite] = {}
        for body, load in (payload.on(tree) for payload in payloads):
            self._loads[body] = self._loads[body] + load if body in self._loads else load
        self._regrouped = regroup(tree, self._loads)
        self._tree = self._regrouped.tree
        drives = [body.drive for body in tree.bodies[1:]]
        # body k + 1 moves by a coordinate, whose place the caller chose, times a factor
        self._place = [self.joints.index(drive.joint) for drive in drives]
        self._factor = [float(drive.factor) for drive in drives]
        self._plain = all(drive.is_plain for drive in drives)
        first_q, first_u = (len(FLOATING_Q), len(FLOATING_U)) if floating else (0, 0)
        self._links = [
            link(body, *_driven(body.drive, self.q[first_q + at], self.u[first_u + at]))
            for body, at in zip(self._tree.bodies[1:], self._place, strict=True)
        ]
        self._known = KnownRates()
        self._closures: list[PassiveHolonomic] = []
        self._poses: dict[str, tuple[Any, Any, Any]] = {}

    @property
    def frames(self) -> tuple[str, ...]:
        """The links, each of which names a frame."""
        return tuple(self._tree.frames)

    @cached_property
    def mechanism(self) -> Mechanism:
        """Q: mass matrix with armature; P = -(bias forces, damping, friction); C for the rates of a floating base.

        G: identity, or the joints' rows for a floating base.

        Composite rigid bodies and recursive Newton-Euler: Featherstone (2008), Chapters 5, 6 and 9.
        u' of a floating base are the derivatives of the components in its own, turning axes.
        """
        n, base = len(self.joints), self._base.size
        G = ca.vertcat(ca.SX(base, n), ca.SX.eye(n)) if n else ca.SX.eye(base)
        C = rate_map(self._base, self.q[3:7], n) if base else None
        Q, P = self._mass_matrix(), -self._forces(self._motion)
        self._known.gauge = Gauge(Q, P, self._accelerations_at_ease(), -self._forces(self._at_ease))
        return Mechanism(q=self.q, u=self.u, tau=self.tau, Q=Q, P=P, G=G, C=C, known_rates=self._known,
                         passive=self._closures,
                         skeleton=skeleton(self._links, self._axes, self._tree, self._base))  # fmt: skip

    def close(
        self,
        frame_a: str,
        frame_b: str,
        what: Literal["position", "pose"] = "position",
        stabilise: Any = 0.0,
        name: str | None = None,
    ) -> PassiveHolonomic:
        """Joins two frames by a passive constraint, which `mechanism` has from then on; one taken before stays open.

        what: "position" holds the origins together (a ball joint, a hinge in the plane), "pose" the axes, too (a weld).
        stabilise: see sg.PassiveHolonomic. name: of the constraint, <frame_a>_to_<frame_b> if absent. SceneError where
        no joint can bring the frames together, and for a name that another closure has.
        """
        if what not in ("position", "pose"):
            raise SceneError(f"close: {what!r}; choose 'position' or 'pose'")
        rows, meant = [self.position(frame_a) - self.position(frame_b)], ca.SX(0, 1)
        if what == "pose":
            B = ca.mtimes(self.rotation(frame_a), self.rotation(frame_b).T)
            rows.append(ca.vertcat(B[2, 1] - B[1, 2], B[0, 2] - B[2, 0], B[1, 0] - B[0, 1]) / 2)
            meant = ca.trace(B)  # these sines of the angles vanish half a turn away, too, where this is -1
        entries = [e for e in ca.vertcat(*rows).elements() if not (e.is_constant() and abs(float(e)) <= _ROUNDING)]
        apart = self._frame(frame_a).body != self._frame(frame_b).body
        if not (entries and apart) or any(e.is_constant() for e in entries):
            told = "no joint can bring them together" if apart else "no joint moves one from the other"
            raise SceneError(
                f"close: frames {frame_a!r} and {frame_b!r}: {told}; name two that joints between them move"
            )
        if name is None:
            name = re.sub(r"\W", "_", f"{frame_a}_to_{frame_b}", flags=re.ASCII)
            name = f"_{name}" if name[0].isdigit() else name
        if any(c.name == name for c in self._closures):
            raise SceneError(f"close: frames {frame_a!r} and {frame_b!r}: a closure is named {name!r}; give a name")
        return self.hold(PassiveHolonomic(name, ca.vertcat(*entries), stabilise, meant))

    def hold(self, constraint: PassiveHolonomic) -> PassiveHolonomic:
        """Adds a passive constraint of `q`, which `mechanism` has from then on; one taken before does not have it."""
        self._closures.append(constraint)
        self.__dict__.pop("mechanism", None)
        return constraint

    def place(self, joint: str) -> Any:
        """The joint's coordinate, rad or m, from the name it has in the file; 0 where it is locked. Of one that mimics
        another, SX of that one's."""
        for body, at in zip(self._tree.bodies[1:], self._links, strict=True):
            if body.joint == joint:
                return at.q
        return ca.SX(0)

    def posture(self, damping: Any = 0.0, stiffness: Any = 0.0, centre: Any = None) -> Any:
        """The joint efforts that by themselves would give u' = -damping u - stiffness (q - centre): a scene's `y`.

        See `sg.Mechanism.posture`. damping: 1/s; stiffness: 1/s^2; centre: joint coordinates, rad or m.
        """
        return self.mechanism.posture(damping, stiffness, centre)

    def position(self, frame: str) -> Any:
        """The frame's origin in the world, 3, m. Holonomic constraints on it are derived without differentiation."""
        return self._pose(frame)[0]

    def rotation(self, frame: str) -> Any:
        """The frame's axes as the columns of a rotation matrix, 3 x 3, frame to world."""
        return self._pose(frame)[1]

    def orientation_error(self, frame: str, reference: Any) -> Any:
        """sin(angle) axis of the turn that takes the reference to the frame, in the world's axes, 3.

        reference: 3 x 3 rotation to the world, SX of references and parameters or numbers. Zero half a turn away, too.
        """
        wanted = matrix(reference, "orientation_error: reference", 3, 3, "a rotation")
        B = ca.mtimes(self.rotation(frame), wanted.T)
        psi = ca.vertcat(B[2, 1] - B[1, 2], B[0, 2] - B[2, 0], B[1, 0] - B[0, 1]) / 2
        self._make_error_known(frame, B, psi, wanted)
        return psi

    def jacobian(self, frame: str) -> Any:
        """6 x n_u: linear velocity of the frame's origin (m/s), then angular velocity (rad/s), in the world's axes."""
        linear, angular = self._jacobian(self._frame(frame))
        turn = self._base_rotation
        return ca.vertcat(ca.mtimes(turn, linear), ca.mtimes(turn, angular))

    def velocity(self, frame: str) -> Any:
        """6: the frame's linear velocity (m/s) and angular velocity (rad/s) in the world's axes, J u."""
        return self._pose(frame)[2]

    def bias_acceleration(self, frame: str) -> Any:
        """6: linear (m/s^2) and angular (rad/s^2) acceleration at u' = 0, J' u, in the world's axes."""
        at = self._frame(frame)
        linear, angular = self._bias(at, [], self._motion)
        return ca.vertcat(ca.mtimes(self._base_rotation, linear), ca.mtimes(self._base_rotation, angular))

    def center_of_mass(self) -> Any:
        """Of the whole robot, links fixed to the world included, in the world, 3, m. SceneError for a massless one."""
        whole = self._composites[0]
        if ca.SX(whole.mass).is_constant() and float(whole.mass) <= 0:
            raise SceneError("the robot has no mass; give its links an <inertial>")
        return column(plus(self._base.position, self._base.to_world(times(1 / whole.mass, whole.first))))

    # ------------------------------------------------------------------ recursions, each once

    @cached_property
    def _motion(self) -> Motions:
        """At u' = 0."""
        return motions(self._links, Motion(self._base.omega, NOWHERE, self._base.felt()))

    @cached_property
    def _at_ease(self) -> Motions:
        """At the accelerations that make this cheapest: a floating base falls freely.

        Joints that mimic others cannot each have their own, so then no joint accelerates.
        """
        felt = NOWHERE if self._base.floating else self._base.felt()
        return motions(self._links, Motion(self._base.omega, NOWHERE, felt), at_ease=self._plain)

    @cached_property
    def _axes(self) -> list[Mat]:
        return placement.rotations(self._links)

    @cached_property
    def _composites(self) -> list[dynamics.Composite]:
        return dynamics.composites(self._links, [body.inertia for body in self._tree.bodies], self._loads)

    @cached_property
    def _base_rotation(self) -> Any:
        return ca.vertcat(*(column(row).T for row in self._base.rotation))

    def _mass_matrix(self) -> Any:
        floating = self._base.floating
        rows = dynamics.mass_matrix(self._links, self._composites, self._regrouped.rotors, floating)
        for k, armature in enumerate(self._resisting.armature, start=self._base.size):
            if not _is_zero(armature):
                rows[k][k] = rows[k][k] + armature
        if self._plain:
            order = self._order()
            return ca.vertcat(*(ca.horzcat(*(ca.SX(rows[i][j]) for j in order)) for i in order))
        K = self._coupling
        full = ca.vertcat(*(ca.horzcat(*map(ca.SX, row)) for row in rows))
        return ca.triu2symm(ca.triu(ca.densify(ca.mtimes(K.T, ca.mtimes(full, K)))))

    def _forces(self, motion: Motions) -> Any:
        bodies = [dynamics.alone(body.inertia, self._loads.get(k)) for k, body in enumerate(self._tree.bodies)]
        f, n, joint = dynamics.forces(self._links, motion.of, bodies, self._regrouped.rotors)
        resistance = self._resisting.force(self._links)
        joint = [own if _is_zero(against) else own + against for own, against in zip(joint, resistance, strict=True)]
        for k, armature in enumerate(self._resisting.armature):
            if not _is_zero(armature) and not _is_zero(motion.joints[k]):
                joint[k] = joint[k] + armature * motion.joints[k]
        return self._by_coordinate([*f, *n, *joint] if self._base.floating else joint)

    def _accelerations_at_ease(self) -> Any:
        falling = [-x for x in self._base.felt()] + [0.0] * 3 if self._base.floating else []
        if not self._plain:  # no joint accelerates
            return column([*falling, *([0.0] * len(self.joints))])
        return self._by_coordinate([*falling, *self._at_ease.joints])

    def _by_coordinate(self, entries: list[Any]) -> Any:
        """A covector of the recursions (base first, then bodies) as one of u."""
        if self._plain:
            return column([entries[i] for i in self._order()])
        return ca.densify(ca.mtimes(self._coupling.T, column(entries)))

    @cached_property
    def _coupling(self) -> Any:
        """K: the rates of the recursions (base first, then bodies) are K u."""
        base = self._base.size
        K = ca.SX(base + len(self._links), base + len(self.joints))
        for i in range(base):
            K[i, i] = 1
        for k, (at, factor) in enumerate(zip(self._place, self._factor, strict=True)):
            K[base + k, base + at] = factor
        return ca.sparsify(K)

    def _order(self) -> list[int]:
        """For each entry of u, its place in the recursions: base first, then bodies."""
        base = self._base.size
        body_of = {at: k for k, at in enumerate(self._place)}
        return [*range(base), *(base + body_of[at] for at in range(len(self.joints)))]

    # ------------------------------------------------------------------ frames

    def _frame(self, name: str) -> Frame:
        if name not in self._tree.frames:
            raise SceneError(f"no frame {name!r}; the links that name frames are {', '.join(self.frames)}")
        return self._tree.frames[name]

    def _jacobian(self, frame: Frame) -> tuple[Any, Any]:
        """Linear and angular rows, 3 x n_u each, in the root's axes."""
        base = self._base.size
        at = placement.point(self._links, self._axes, frame)
        linear: list[Vec] = [NOWHERE] * (base + len(self.joints))
        angular = list(linear)
        for i in range(3 if base else 0):
            unit: Vec = (float(i == 0), float(i == 1), float(i == 2))
            linear[i], linear[3 + i], angular[3 + i] = unit, cross(unit, at.arm), unit
        for k, along, about in at.columns:
            i = base + self._place[k - 1]
            if self._plain:
                linear[i], angular[i] = along, about
            else:
                factor = self._factor[k - 1]
                linear[i], angular[i] = plus(linear[i], times(factor, along)), plus(angular[i], times(factor, about))
        return ca.horzcat(*map(column, linear)), ca.horzcat(*map(column, angular))

    def _bias(self, frame: Frame, besides: list[Any], motion: Motions) -> tuple[Any, Any]:
        """Linear and angular acceleration in that motion, in the root's axes."""
        linear = self._base.without_gravity(placement.bias(self._links, self._axes, motion.of, frame, besides))
        alpha = motion.of[frame.body].alpha
        angular = placement.in_root_axes(self._links, self._axes, frame.body, alpha, besides)
        return column(linear), column(angular)

    def _pose(self, name: str) -> tuple[Any, Any, Any]:
        """Position, rotation and velocity, with their rates made known; the same SX at each call."""
        if name not in self._poses:
            frame = self._frame(name)
            arm = placement.point(self._links, self._axes, frame).arm
            position = column(plus(self._base.position, self._base.to_world(arm)))
            axes = [column(axis) for axis in placement.frame_axes(self._axes, frame)]
            rotation = ca.mtimes(self._base_rotation, ca.horzcat(*axes))
            self._known.frames[name] = position, rotation
            self._poses[name] = position, rotation, self._make_known(frame, position, rotation, axes)
        return self._poses[name]

    def _make_known(self, frame: Frame, position: Any, rotation: Any, axes: list[Any]) -> Any:
        """Tells the rates of position, rotation and velocity; returns the velocity."""
        turn = self._base_rotation
        J, J_angular = self._jacobian(frame)
        linear, alpha = zip(*(self._bias(frame, J.nonzeros(), m) for m in (self._motion, self._at_ease)), strict=True)
        v, omega = ca.mtimes(J, self.u), ca.mtimes(J_angular, self.u)
        v_world, omega_world = ca.mtimes(turn, v), ca.mtimes(turn, omega)
        self._known.add(turn, J, v_world, [ca.mtimes(turn, a) for a in linear], value=position)
        self._known.add(turn, J_angular, omega_world, [ca.mtimes(turn, a) for a in alpha])
        # each column c turns by c' = omega x c
        factor = ca.vertcat(*(ca.mtimes(turn, -ca.skew(axis)) for axis in axes))
        spin = ca.vertcat(*(ca.mtimes(turn, ca.cross(omega, ca.cross(omega, axis))) for axis in axes))
        accelerations = [ca.mtimes(factor, a) + spin for a in alpha]
        self._known.add(factor, J_angular, ca.mtimes(factor, omega), accelerations, value=ca.vec(rotation))
        return ca.vertcat(v_world, omega_world)

    def _make_error_known(self, name: str, B: Any, psi: Any, wanted: Any) -> None:
        """psi' = E omega with E = (tr(B) I - B) / 2, and psi'' = E omega' + omega x psi' - omega (omega . psi), where
        B = rotation wanted^T and wanted stands still."""
        frame, turn, omega = self._frame(name), self._base_rotation, self.velocity(name)[3:]
        _, J = self._jacobian(frame)
        alpha = [self._bias(frame, J.nonzeros(), motion)[1] for motion in (self._motion, self._at_ease)]
        E = (ca.trace(B) * ca.SX.eye(3) - B) / 2
        rate = ca.mtimes(E, omega)
        spin = ca.cross(omega, rate) - omega * ca.dot(omega, psi)
        factor = ca.mtimes(E, turn)
        accelerations = [ca.mtimes(factor, a) + spin for a in alpha]
        self._known.add(factor, J, rate, accelerations, value=psi, still=wanted)


def _symbols(names: Sequence[str]) -> Any:
    return ca.vertcat(*(ca.SX.sym(name) for name in names))


def _driven(drive: Drive, q: Any, u: Any) -> tuple[Any, Any]:
    """Angle or length of a body's joint, and its rate."""
    if drive.is_plain:
        return q, u
    factor = float(drive.factor)
    return factor * q + float(drive.offset), factor * u


def _is_zero(value: Any) -> bool:
    return bool(value.is_zero()) if isinstance(value, ca.SX) else value == 0
