"""The base of the tree: fixed to the world, or floating freely with a unit quaternion."""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from servogen.urdf.vectors import NOWHERE, Mat, Vec, column, cross, minus, plus, product, product_transposed, unpack

FLOATING_Q = ("base_x", "base_y", "base_z", "base_qw", "base_qx", "base_qy", "base_qz")
FLOATING_U = ("base_vx", "base_vy", "base_vz", "base_wx", "base_wy", "base_wz")
FLOATING_TAU = ("base_fx", "base_fy", "base_fz", "base_mx", "base_my", "base_mz")

_IDENTITY: Mat = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class Base:
    """Where the root's frame is in the world, and its velocity in its own axes.

    All else is computed in the root's axes and turned by `rotation` last. With w^2 + x^2 - y^2 - z^2 and its like in
    `rotation`, its rate is rotation (omega x) for quaternions of any length, so that rates belong to what they are
    rates of even where rounding has stretched the quaternion.
    """

    floating: bool
    position: Vec
    rotation: Mat
    velocity: Vec
    omega: Vec
    gravity: Vec

    @property
    def size(self) -> int:
        """Velocity parameters of the base."""
        return 6 if self.floating else 0

    def to_world(self, a: Vec) -> Vec:
        return product(self.rotation, a)

    def gravity_here(self) -> Vec:
        """Gravity in the root's axes, m/s^2."""
        return product_transposed(self.rotation, self.gravity)

    def acceleration(self) -> Vec:
        """Of the root's origin at zero u', without gravity: omega x v, since u holds v in turning axes."""
        return cross(self.omega, self.velocity)

    def felt(self) -> Vec:
        """The same less gravity: what recursive Newton-Euler starts from."""
        return minus(self.acceleration(), self.gravity_here())

    def without_gravity(self, felt: Vec) -> Vec:
        """The acceleration of a point, in the root's axes, from one that gravity's reaction is in."""
        return plus(felt, self.gravity_here())


def fixed_base(gravity: Vec) -> Base:
    return Base(False, NOWHERE, _IDENTITY, NOWHERE, NOWHERE, gravity)


def floating_base(q: Any, u: Any, gravity: Vec) -> Base:
    """q: 7, position (m, in the world) and unit quaternion (w, x, y, z), body to world. u: 6, linear (m/s) and angular
    velocity (rad/s), both in the base's own axes."""
    return Base(True, unpack(q[:3]), quaternion_rows(q[3:]), unpack(u[:3]), unpack(u[3:]), gravity)


def quaternion_rotation(quaternion: Any) -> Any:
    """The rotation, 3 x 3, of a quaternion (w, x, y, z); |quaternion|^2 times a rotation if it is no unit one."""
    return ca.vertcat(*(column(row).T for row in quaternion_rows(quaternion)))


def quaternion_rows(quaternion: Any) -> Mat:
    """The rows of quaternion_rotation."""
    w, x, y, z = (quaternion[k] for k in range(4))
    return (
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )


def rate_map(base: Base, quaternion: Any, joints: int) -> Any:
    """C, (7 + joints) x (6 + joints): q' = C u, with quaternion' = quaternion o (0, omega) / 2."""
    w, x, y, z = (quaternion[k] for k in range(4))
    half = ca.vertcat(
        ca.horzcat(-x, -y, -z),
        ca.horzcat(w, -z, y),
        ca.horzcat(z, w, -x),
        ca.horzcat(-y, x, w),
    )
    rotation = ca.vertcat(*(column(row).T for row in base.rotation))
    return ca.diagcat(rotation, half / 2, ca.SX.eye(joints))
