"""What a URDF file says: links, joints and their exact numbers. Every error about the file is raised here."""

import contextlib
import io
import math
import xml.etree.ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from urdf_parser_py.urdf import URDF
from urdf_parser_py.xml_reflection.core import ParseError

from servogen.errors import SceneError
from servogen.urdf.exact import IDENTITY, ORIGIN, Matrix, Vector, rotation, snapped_turns, unit, vector
from servogen.urdf.inertia import NO_MATRIX, Inertia, second_moment

MOVING = ("revolute", "continuous", "prismatic")
"""Joint types with one degree of freedom; "fixed" has none, others are not supported."""

_X_AXIS: Vector = IDENTITY[0]


@dataclass(frozen=True)
class Joint:
    """A joint: the child link's frame at zero has `rotation` and `origin` (m) in the parent link's; `axis` is unit."""

    name: str
    kind: str
    parent: str
    child: str
    rotation: Matrix
    origin: Vector
    axis: Vector
    mimics: str | None


@dataclass(frozen=True)
class Description:
    """links: name -> inertia about the link's frame, None where there is none. root: the link without a parent."""

    source: str
    links: dict[str, Inertia | None]
    joints: tuple[Joint, ...]
    root: str
    notes: tuple[str, ...]


def read(path: str | Path) -> Description:
    """The description in a URDF file. SceneError for anything wrong with it, naming the thing and the remedy."""
    file = Path(path)
    if not file.is_file():
        raise SceneError(f"no URDF file at {str(path)!r}; give the path of one")
    parsed = _parse(file)
    notes: list[str] = []
    links = {link.name: _inertia(file.name, link, notes) for link in parsed.links}
    joints = tuple(_joint(file.name, joint, notes) for joint in parsed.joints)
    _check_unique(file.name, "link", [link.name for link in parsed.links])
    _check_unique(file.name, "joint", [joint.name for joint in joints])
    return Description(file.name, links, joints, _root(file.name, links, joints), tuple(notes))


def _parse(file: Path) -> Any:
    remarks = io.StringIO()  # the parser's remarks on tags of others (transmissions, plugins)
    try:
        with contextlib.redirect_stderr(remarks), contextlib.redirect_stdout(remarks):
            return URDF.from_xml_string(file.read_bytes())
    except (ParseError, xml.etree.ElementTree.ParseError, SyntaxError, ValueError, AssertionError) as error:
        raise SceneError(f"{file.name} is no valid URDF: {str(error).strip()}; correct the file") from error


def _numbers(source: str, what: str, values: Sequence[float]) -> Sequence[float]:
    for value in values:
        if not math.isfinite(value):
            raise SceneError(f"{source}: {what} holds {value}; give finite numbers")
    return values


def _placement(source: str, what: str, origin: Any, notes: list[str]) -> tuple[Matrix, Vector]:
    """Rotation and position of an <origin>, with a note for each angle that is no quarter turn to the last digit."""
    if origin is None:
        return IDENTITY, ORIGIN
    angles = _numbers(source, f"{what}: rpy", origin.rpy or (0.0, 0.0, 0.0))
    for angle in angles:
        turns = snapped_turns(angle)
        if turns is not None and angle != turns * math.pi / 2:
            notes.append(f"{what}: the angle {angle!r} is taken as exactly {turns} quarter turn(s)")
    return rotation(angles), vector(_numbers(source, f"{what}: xyz", origin.xyz or (0.0, 0.0, 0.0)))


def _inertia(source: str, link: Any, notes: list[str]) -> Inertia | None:
    given = link.inertial
    if given is None:
        return None
    what = f"link {link.name!r}"
    if given.mass is None:
        raise SceneError(f"{source}: {what} has an <inertial> without a <mass>; give one")
    _numbers(source, f"{what}: mass", [given.mass])
    if given.mass < 0:
        raise SceneError(f"{source}: {what} has the mass {given.mass}; give one that is not negative")
    turn, centre = _placement(source, f"{what}, inertial", given.origin, notes)
    if given.inertia is None:
        second = NO_MATRIX
    else:
        rows = given.inertia.to_matrix()
        for row in rows:
            _numbers(source, f"{what}: inertia", row)
        second = second_moment((vector(rows[0]), vector(rows[1]), vector(rows[2])))
    about_centre = Inertia(Fraction(0), ORIGIN, second).seen_from(turn, ORIGIN)
    mass = vector([given.mass, 0.0, 0.0])[0]
    return Inertia(mass, ORIGIN, about_centre.second).seen_from(IDENTITY, centre)


def _joint(source: str, joint: Any, notes: list[str]) -> Joint:
    what = f"joint {joint.name!r}"
    turn, origin = _placement(source, what, joint.origin, notes)
    axis = _X_AXIS if joint.axis is None else vector(_numbers(source, f"{what}: axis", joint.axis))
    if joint.type in MOVING:
        if axis == ORIGIN:
            raise SceneError(f"{source}: {what} has the axis 0 0 0; give its direction")
        axis = unit(axis)
    mimics = None if joint.mimic is None else str(joint.mimic.joint)
    return Joint(joint.name, joint.type, joint.parent, joint.child, turn, origin, axis, mimics)


def _check_unique(source: str, what: str, names: list[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise SceneError(f"{source} has two {what}s named {name!r}; rename one")


def _root(source: str, links: dict[str, Inertia | None], joints: tuple[Joint, ...]) -> str:
    """The one link without a parent; SceneError for unknown links, loops and forests."""
    parent_joint: dict[str, Joint] = {}
    for joint in joints:
        for end, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                raise SceneError(f"{source}: joint {joint.name!r} has the {end} {link!r}, no such link; add it")
        if joint.child in parent_joint:
            other = parent_joint[joint.child].name
            raise SceneError(
                f"{source}: link {joint.child!r} is the child of two joints, {other!r} and {joint.name!r}: "
                "a loop; cut it, and write the closure as a constraint"
            )
        parent_joint[joint.child] = joint
    roots = [link for link in links if link not in parent_joint]
    for link in links:
        seen = [link]
        while seen[-1] in parent_joint:
            seen.append(parent_joint[seen[-1]].parent)
            if seen[-1] in seen[:-1]:
                raise SceneError(
                    f"{source}: the links {', '.join(seen)} form a loop; cut one of the joints between them"
                )
    if not roots:
        raise SceneError(f"{source} has no links; give a robot")
    if len(roots) > 1:
        raise SceneError(f"{source} has several links without a parent ({', '.join(roots)}); join them by fixed joints")
    return roots[0]
