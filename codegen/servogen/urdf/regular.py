"""Whether every joint moves something: a body without inertia, or with a wrong one, is named at load."""

from collections.abc import Collection, Sequence
from typing import Any

import casadi as ca
import numpy as np

from servogen.errors import SceneError
from servogen.urdf.description import Description
from servogen.urdf.exact import IDENTITY, ONE, ORIGIN, ZERO, scale
from servogen.urdf.inertia import Inertia
from servogen.urdf.tree import Tree, links_of

_ZERO = 1e-12
"""Of a matrix brought to one: what is not larger is rounding."""


def check_bodies(description: Description, tree: Tree, floating: bool, carrying: Collection[str]) -> bool:
    """Whether each body has mass and inertia in every direction: then the mass matrix is surely regular.

    SceneError for a negative inertia, and where nothing that a joint moves has an <inertial>. carrying: links and
    joints that the caller gives inertia.
    """
    carried = [links_of(tree, k) for k in range(len(tree.bodies))]
    sound = True
    for k in range(len(tree.bodies) - 1, -1 if floating else 0, -1):
        body = tree.bodies[k]
        smallest = _smallest_moment(body.inertia)
        if smallest < -_ZERO:
            link = _worst(description, links_of(tree, k))
            moved = f"joint {body.joint!r} moves" if k else "is the floating base"
            raise SceneError(
                f"{description.source}: link {link!r}, which {moved}, has a negative inertia about some axis; correct "
                "its <inertia>: moments about the centre of mass, kg m^2"
            )
        sound &= smallest > _ZERO and body.inertia.mass > 0
        empty = all(description.links[link] in (None, Inertia()) for link in carried[k])
        if k and empty and not {body.joint, *carried[k]} & set(carrying):
            if all(inertia in (None, Inertia()) for inertia in description.links.values()):
                raise SceneError(
                    f"{description.source}: no link has an <inertial>, so the file tells the robot's kinematics alone; "
                    "write masses and inertias into it, from a data sheet or an identification"
                )
            raise SceneError(
                f"{description.source}: link {carried[k][0]!r} has no <inertial>, and joint {body.joint!r} moves "
                "nothing else; give the link mass and inertia, or lock the joint by leaving it out of joints=[...]"
            )
        if k:
            carried[body.parent] += carried[k]
    return sound


def check_mass_matrix(description: Description, tree: Tree, q: Any, Q: Any, joints: Sequence[str]) -> None:
    """SceneError where Q is singular at every q, with the joint that moves no inertia. joints: of Q's last rows."""
    others = [s for s in ca.symvar(Q) if not any(ca.is_equal(s, e) for e in q.nonzeros())]
    function = ca.Function("Q", [q, ca.vertcat(*others)], [ca.densify(Q)])
    generator = np.random.default_rng(0)
    found = []
    for _ in range(4):
        value = np.array(function(generator.uniform(-1, 1, q.size1()), np.ones(len(others))))
        size = np.sqrt(np.abs(np.diag(value)))
        size[size == 0] = 1
        values, vectors = np.linalg.eigh(value / np.outer(size, size))
        if values[0] > _ZERO:
            return
        found.append(np.abs(vectors[:, 0]))
    worst = int(np.argmax(np.mean(found, axis=0))) - (Q.size1() - len(joints))
    if worst < 0:
        raise SceneError(f"{description.source}: the floating base has no inertia; give its links an <inertial>")
    joint = joints[worst]
    body = next(k for k, body in enumerate(tree.bodies) if body.drive.joint == joint)
    kind = "mass" if tree.bodies[body].prismatic else "inertia about its axis"
    raise SceneError(
        f"{description.source}: joint {joint!r} moves link {links_of(tree, body)[0]!r} without {kind}; correct its "
        f"<inertial>, give armature={{{joint!r}: ...}}, or lock the joint by leaving it out of joints=[...]"
    )


def _smallest_moment(inertia: Inertia) -> float:
    """The smallest principal moment about the centre of mass, of an inertia brought to one; 0 where there is none."""
    centre = scale(1 / inertia.mass, inertia.first) if inertia.mass else ORIGIN
    own = inertia.seen_from(IDENTITY, scale(-ONE, centre)).second
    trace = own[0][0] + own[1][1] + own[2][2]
    rows = [[(trace if i == j else ZERO) - own[i][j] for j in range(3)] for i in range(3)]
    largest = max(abs(x) for row in rows for x in row)
    if largest == 0:
        return 0.0
    return float(np.linalg.eigvalsh([[float(x / largest) for x in row] for row in rows])[0])


def _worst(description: Description, links: Sequence[str]) -> str:
    """The link whose own inertia is the most negative."""
    return min(links, key=lambda link: _smallest_moment(description.links[link] or Inertia()))
