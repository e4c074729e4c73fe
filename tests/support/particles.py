"""A robot from URDF without rigid-body algorithms: every link is a few particles, every derivative a difference.

Shares nothing with servogen.urdf: the file is read with the standard library, angles as written, poses as 4 x 4
matrices, mass matrix and bias forces by Jourdain's principle from particles along the exact motion at constant u.
"""

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm

MOVING = ("revolute", "continuous", "prismatic")


def rotation(rpy: Any) -> Any:
    turn = np.eye(3)
    for k, angle in enumerate(rpy):
        turn = expm(angle * skew(np.eye(3)[k])) @ turn
    return turn


def skew(a: Any) -> Any:
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0.0]])


def pose(turn: Any, origin: Any) -> Any:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn, origin
    return T


def numbers(element: Any, name: str, default: str = "0 0 0") -> Any:
    return np.array((default if element is None else element.get(name, default)).split(), dtype=float)


class Particles:
    """joints: the moving ones in the order of q. State: base pose (4 x 4) and joint coordinates."""

    def __init__(self, path: Path, joints: Any, floating: bool, gravity: Any = (0, 0, -9.81)) -> None:
        root = ET.parse(path).getroot()
        self.joints, self.floating, self.gravity = list(joints), floating, np.array(gravity)
        self.tree = [
            (
                j.get("name"),
                j.get("type"),
                j.find("parent").get("link"),  # type: ignore[union-attr]
                j.find("child").get("link"),  # type: ignore[union-attr]
                pose(rotation(numbers(j.find("origin"), "rpy")), numbers(j.find("origin"), "xyz")),
                numbers(j.find("axis"), "xyz", "1 0 0"),
            )
            for j in root.findall("joint")
        ]
        self.root = ({link.get("name") for link in root.findall("link")} - {j[3] for j in self.tree}).pop()
        self.particles = {link.get("name"): particles_of(link) for link in root.findall("link")}

    @property
    def n_u(self) -> int:
        return len(self.joints) + (6 if self.floating else 0)

    def poses(self, base: Any, q: Any) -> dict[str, Any]:
        found = {self.root: base}
        while len(found) < len(self.tree) + 1:
            for name, kind, parent, child, placed, axis in self.tree:
                if parent in found and child not in found:
                    T = found[parent] @ placed
                    if name in self.joints:
                        amount, along = q[self.joints.index(name)], axis / np.linalg.norm(axis)
                        move = pose(np.eye(3), amount * along)
                        T = T @ (move if kind == "prismatic" else pose(expm(amount * skew(along)), np.zeros(3)))
                    found[child] = T
        return found

    def moved(self, base: Any, q: Any, u: Any, time: float) -> tuple[Any, Any]:
        """Exactly, at constant u."""
        if not self.floating:
            return base, q + time * u
        twist = np.zeros((4, 4))
        twist[:3, :3], twist[:3, 3] = skew(u[3:6]), u[:3]
        return base @ expm(time * twist), q + time * u[6:]

    def points(self, base: Any, q: Any) -> Any:
        poses = self.poses(base, q)
        return np.array([T[:3, :3] @ r + T[:3, 3] for link, T in poses.items() for _, r in self.particles[link]])

    def masses(self, base: Any, q: Any) -> Any:
        return np.array([m for link in self.poses(base, q) for m, _ in self.particles[link]])

    def first_difference(self, what: Any, base: Any, q: Any, u: Any, h: float = 2e-3) -> Any:
        """d/dt of what(base, q) at constant u, sixth order."""
        at = {k: what(*self.moved(base, q, u, k * h)) for k in (-3, -2, -1, 1, 2, 3)}
        return (45 * (at[1] - at[-1]) - 9 * (at[2] - at[-2]) + (at[3] - at[-3])) / (60 * h)

    def second_difference(self, what: Any, base: Any, q: Any, u: Any, h: float = 1e-2) -> Any:
        at = {k: what(*self.moved(base, q, u, k * h)) for k in range(-3, 4)}
        wings = 2 * (at[3] + at[-3]) - 27 * (at[2] + at[-2]) + 270 * (at[1] + at[-1])
        return (wings - 490 * at[0]) / (180 * h * h)

    def jacobian(self, what: Any, base: Any, q: Any) -> Any:
        """Last axis: one column per entry of u."""
        return np.stack([self.first_difference(what, base, q, e) for e in np.eye(self.n_u)], axis=-1)

    def mass_matrix(self, base: Any, q: Any) -> Any:
        J = self.jacobian(self.points, base, q)
        return np.einsum("p,pik,pil->kl", self.masses(base, q), J, J)

    def bias_forces(self, base: Any, q: Any, u: Any) -> Any:
        J = self.jacobian(self.points, base, q)
        a = self.second_difference(self.points, base, q, u) - self.gravity
        return np.einsum("p,pik,pi->k", self.masses(base, q), J, a)

    def center_of_mass(self, base: Any, q: Any) -> Any:
        m = self.masses(base, q)
        return m @ self.points(base, q) / m.sum()


def particles_of(link: Any) -> list[tuple[float, Any]]:
    """(mass, place in the link's frame): seven particles with the link's mass, first and second moments."""
    inertial = link.find("inertial")
    if inertial is None:
        return []
    mass = float(inertial.find("mass").get("value"))
    turn, centre = rotation(numbers(inertial.find("origin"), "rpy")), numbers(inertial.find("origin"), "xyz")
    given = inertial.find("inertia").attrib
    I = np.array([[float(given["i" + "".join(sorted(a + b))]) for b in "xyz"] for a in "xyz"])
    moments, directions = np.linalg.eigh(turn @ (np.trace(I) / 2 * np.eye(3) - I) @ turn.T)
    arm = 0.1
    found = [(mass - sum(moments) / arm**2, centre)]
    for moment, direction in zip(moments, directions.T, strict=True):
        found += [(moment / (2 * arm**2), centre + sign * arm * direction) for sign in (-1, 1)]
    return found
