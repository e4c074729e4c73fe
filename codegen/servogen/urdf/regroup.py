"""Base parameters: what a joint's motion does not show of a body's inertia is moved to its parent.

About a revolute axis, masses strung along that axis look the same at every angle: the body's mass, its first moment
along the axis and the second moment along the axis go to the parent. Along a prismatic axis the whole second moment
does. Khalil and Dombre (2002), Section 9.4.2.
A last body that is then symmetric about its axis, balanced and without products of inertia, is a rotor: only its spin
is seen apart from the parent (a gyrostat, Wittenburg (2008), Section 3.3).
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from fractions import Fraction

from servogen.urdf.exact import ORIGIN, ZERO, Matrix
from servogen.urdf.inertia import Inertia
from servogen.urdf.tree import Body, Tree


@dataclass(frozen=True)
class Regrouped:
    """A tree of the same motions; rotors: body index -> moment of inertia about its axis, kg m^2, in no body."""

    tree: Tree
    rotors: dict[int, Fraction]


def regroup(tree: Tree, loaded: Collection[int] = ()) -> Regrouped:
    """From the tips to the root, move to the parent what the joint does not show. loaded: bodies that carry more."""
    bodies = list(tree.bodies)
    leaves = set(range(1, len(bodies))) - {body.parent for body in bodies} - set(loaded)
    rotors: dict[int, Fraction] = {}
    for k in range(len(bodies) - 1, 0, -1):
        body = bodies[k]
        hidden = _hidden(body)
        rest = body.inertia - hidden
        if k in leaves and _is_rotor(body, rest):
            radial = rest.second[0][0]
            rotors[k] = 2 * radial
            # second moments diag(r, r, 0) mean the inertia diag(r, r, 2 r); without the spin, diag(r, r, 0)
            hidden += Inertia(ZERO, ORIGIN, _along_axis(radial))
            rest = Inertia()
        bodies[k] = replace(body, inertia=rest)
        parent = bodies[body.parent]
        moved = hidden.seen_from(body.rotation, body.origin)
        bodies[body.parent] = replace(parent, inertia=parent.inertia + moved)
    return Regrouped(Tree(tuple(bodies), tree.frames, tree.above), rotors)


def _hidden(body: Body) -> Inertia:
    inertia = body.inertia
    if body.prismatic:
        return Inertia(ZERO, ORIGIN, inertia.second)
    return Inertia(inertia.mass, (ZERO, ZERO, inertia.first[2]), _along_axis(inertia.second[2][2]))


def _is_rotor(body: Body, rest: Inertia) -> bool:
    radial = rest.second[0][0]
    symmetric: Matrix = ((radial, ZERO, ZERO), (ZERO, radial, ZERO), ORIGIN)
    return not body.prismatic and rest.first == ORIGIN and rest.second == symmetric


def _along_axis(moment: Fraction) -> Matrix:
    return ORIGIN, ORIGIN, (ZERO, ZERO, moment)
