"""What a URDF file says of a robot's mechanics: links, joints and their exact numbers.

Read are links' names and inertials, and joints' types, ends, origins, axes, limits, dynamics and mimics; all else
(shapes, materials, transmissions, blocks of simulators) is passed over unread. Every error about the file is raised
here, or in file.py before.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from servogen.errors import SceneError
from servogen.ir.lower import decimal_value
from servogen.urdf.exact import IDENTITY, ORIGIN, Matrix, Vector, rotation, snapped_turns, unit, vector
from servogen.urdf.file import check_expanded, robot_element
from servogen.urdf.inertia import NO_MATRIX, Inertia, second_moment
from servogen.urdf.markup import Element

MOVING = ("revolute", "continuous", "prismatic")
"""Joint types with one degree of freedom; "fixed" has none, "floating" can be the base, others are not supported."""

KNOWN = (*MOVING, "fixed", "floating", "planar")
LARGEST = 1e30
"""Numbers beyond it are no lengths, masses or angles, and their products would leave double precision."""

_X_AXIS: Vector = IDENTITY[0]


@dataclass(frozen=True)
class Mimic:
    """q = factor q_leader + offset."""

    leader: str
    factor: Fraction
    offset: Fraction


@dataclass(frozen=True)
class Joint:
    """A joint: the child link's frame at zero has `rotation` and `origin` (m) in the parent link's; `axis` is unit.

    lower, upper (rad, m), velocity (rad/s, m/s), effort (N m, N): infinite where there is none. damping: N m s/rad,
    N s/m. friction: N m, N. armature: kg m^2, kg. stiffness: N m/rad, N/m, of a spring at ease at `rest`, rad, m.
    """

    name: str
    kind: str
    parent: str
    child: str
    rotation: Matrix = IDENTITY
    origin: Vector = ORIGIN
    axis: Vector = _X_AXIS
    mimic: Mimic | None = None
    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    effort: float = math.inf
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0


@dataclass(frozen=True)
class Description:
    """links: name -> inertia about the link's frame, None where there is none. root: the link without a parent."""

    source: str
    links: dict[str, Inertia | None]
    joints: tuple[Joint, ...]
    root: str
    notes: tuple[str, ...]


def read(path: str | Path, quarter_turns: bool = True) -> Description:
    """The description in a URDF file. SceneError for anything wrong with it, naming the thing and the remedy.

    quarter_turns: whether an angle within QUARTER_TURN_TOLERANCE of a quarter turn is taken as exactly that.
    """
    source, robot = robot_element(path)
    reader = _Reader(source, quarter_turns)
    links = [(reader.name(element, "link"), reader.inertia(element)) for element in robot.all("link")]
    joints = tuple(reader.joint(element) for element in robot.all("joint"))
    _check_unique(source, "link", [name for name, _ in links])
    _check_unique(source, "joint", [joint.name for joint in joints])
    return Description(source, dict(links), joints, find_root(source, dict(links), joints), tuple(reader.notes))


def from_floating_root(given: Description) -> Description:
    """Where a root without inertia carries all else by one floating joint, that joint is the floating base."""
    below = [joint for joint in given.joints if joint.parent == given.root]
    if len(below) != 1 or below[0].kind != "floating" or given.links[given.root] not in (None, Inertia()):
        return given
    links = {name: inertia for name, inertia in given.links.items() if name != given.root}
    joints = tuple(joint for joint in given.joints if joint is not below[0])
    return replace(given, links=links, joints=joints, root=below[0].child)


class _Reader:
    """Reads elements of one file; collects the notes."""

    def __init__(self, source: str, quarter_turns: bool) -> None:
        self.source = source
        self.quarter_turns = quarter_turns
        self.notes: list[str] = []

    def fail(self, text: str) -> SceneError:
        return SceneError(f"{self.source}: {text}")

    def name(self, element: Element, kind: str) -> str:
        given = self.text(element, "name")
        if given is None or not given.strip():
            raise self.fail(f"line {element.line}: a <{kind}> has no name; give it one")
        return given

    def text(self, element: Element, attribute: str) -> str | None:
        value = element.attributes.get(attribute)
        if value is not None:
            check_expanded(self.source, element.line, value)
        return value

    def numbers(self, element: Element, attribute: str, count: int, what: str) -> list[float] | None:
        """The attribute's numbers; None where it is not there."""
        given = self.text(element, attribute)
        if given is None:
            return None
        try:
            if "_" in given:  # which Python would read over
                raise ValueError
            values = [float(word) for word in given.split()]
        except ValueError:
            raise self.fail(
                f"{what}: {attribute}={given[:60]!r} (line {element.line}) is no number; "
                f"give {'one' if count == 1 else f'{count}, with spaces between'}"
            ) from None
        if len(values) != count:
            raise self.fail(
                f"{what}: {attribute}={given[:60]!r} (line {element.line}) has {len(values)} numbers; give {count}"
            )
        for value in values:
            if not math.isfinite(value):
                raise self.fail(f"{what}: {attribute} holds {value}; give finite numbers")
            if abs(value) > LARGEST:
                raise self.fail(f"{what}: {attribute} holds {value:g}; give numbers below {LARGEST:g}")
        return values

    def number(self, element: Element | None, attribute: str, what: str, default: float) -> float:
        values = None if element is None else self.numbers(element, attribute, 1, what)
        return default if values is None else values[0]

    def placement(self, element: Element, what: str) -> tuple[Matrix, Vector]:
        """Rotation and position of an <origin>, with a note for each angle that is taken otherwise than written."""
        origin = element.first("origin")
        if origin is None:
            return IDENTITY, ORIGIN
        angles = self.numbers(origin, "rpy", 3, what) or [0.0, 0.0, 0.0]
        for angle in angles if self.quarter_turns else ():
            turns = snapped_turns(angle)
            if turns is not None and angle != turns * math.pi / 2:
                self.notes.append(f"{what}: the angle {angle!r} is taken as exactly {turns} quarter turn(s)")
        position = self.numbers(origin, "xyz", 3, what) or [0.0, 0.0, 0.0]
        return rotation(angles, self.quarter_turns), vector(position)

    def inertia(self, link: Element) -> Inertia | None:
        given = link.first("inertial")
        if given is None:
            return None
        what = f"link {link.attributes['name']!r}"
        element = given.first("mass")
        if element is None:
            raise self.fail(f"{what} has an <inertial> without a <mass>; give one")
        mass = self.numbers(element, "value", 1, f"{what}: mass")
        if mass is None:
            raise self.fail(f'{what}: its <mass> has no value; write <mass value="..."/>')
        if mass[0] < 0:
            raise self.fail(f"{what} has the mass {mass[0]}; give one that is not negative")
        turn, centre = self.placement(given, f"{what}, inertial")
        about_centre = Inertia(Fraction(0), ORIGIN, self.second(given, what)).seen_from(turn, ORIGIN)
        return Inertia(decimal_value(mass[0]), ORIGIN, about_centre.second).seen_from(IDENTITY, centre)

    def second(self, inertial: Element, what: str) -> Matrix:
        """The second moments of an <inertia>; of a point mass where there is none. Products left out are zero."""
        element = inertial.first("inertia")
        if element is None:
            return NO_MATRIX
        entries: dict[str, float] = {}
        for place in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"):
            value = self.numbers(element, place, 1, f"{what}: inertia")
            if value is None and place[1] == place[2]:
                raise self.fail(f"{what}: its <inertia> has no {place}; give the moment about the centre of mass")
            entries[place] = 0.0 if value is None else value[0]
        x, y, z = vector([entries["ixx"], entries["iyy"], entries["izz"]])
        xy, xz, yz = vector([entries["ixy"], entries["ixz"], entries["iyz"]])
        return second_moment(((x, xy, xz), (xy, y, yz), (xz, yz, z)))

    def joint(self, element: Element) -> Joint:
        name = self.name(element, "joint")
        what = f"joint {name!r}"
        kind = self.text(element, "type")
        if kind not in KNOWN:
            has = "no type" if kind is None else f"the type {kind[:50]!r}"
            raise self.fail(f"no valid URDF: {what} has {has}; choose among {', '.join(KNOWN)}")
        parent, child = (self.end(element, end, what) for end in ("parent", "child"))
        turn, origin = self.placement(element, what)
        found = Joint(name, kind, parent, child, turn, origin)
        return self.moving(element, found, what) if kind in MOVING else found

    def end(self, element: Element, end: str, what: str) -> str:
        link = element.first(end)
        name = None if link is None else self.text(link, "link")
        if name is None:
            raise self.fail(f'{what} names no {end}; write <{end} link="..."/>')
        return name

    def moving(self, element: Element, found: Joint, what: str) -> Joint:
        limit, dynamics = element.first("limit"), element.first("dynamics")
        bounded = found.kind != "continuous" and limit is not None and {"lower", "upper"} & set(limit.attributes)
        damping, friction = (self.number(dynamics, name, f"{what}: dynamics", 0.0) for name in ("damping", "friction"))
        for word, value in (("damping", damping), ("friction", friction)):
            if value < 0:
                raise self.fail(f"{what} has the {word} {value}; give one that is not negative")
        return replace(
            found,
            axis=self.axis(element, what),
            mimic=self.mimic(element, what),
            lower=self.number(limit, "lower", f"{what}: limit", 0.0) if bounded else -math.inf,
            upper=self.number(limit, "upper", f"{what}: limit", 0.0) if bounded else math.inf,
            velocity=self.number(limit, "velocity", f"{what}: limit", math.inf),
            effort=self.number(limit, "effort", f"{what}: limit", math.inf),
            damping=damping,
            friction=friction,
        )

    def axis(self, element: Element, what: str) -> Vector:
        given = element.first("axis")
        if given is None:
            return _X_AXIS
        values = self.numbers(given, "xyz", 3, f"{what}: axis")
        if values is None:
            written = ", ".join(given.attributes) or "nothing"
            raise self.fail(f'{what}: its <axis> has no xyz (it has {written}); write <axis xyz="x y z"/>')
        axis = vector(values)
        if axis == ORIGIN:
            raise self.fail(f"{what} has the axis 0 0 0; give its direction")
        return unit(axis)

    def mimic(self, element: Element, what: str) -> Mimic | None:
        given = element.first("mimic")
        if given is None:
            return None
        leader = self.text(given, "joint")
        if leader is None:
            raise self.fail(f'{what}: its <mimic> names no joint; write <mimic joint="..."/>')
        factor, offset = (
            self.number(given, word, f"{what}: mimic", default)
            for word, default in (("multiplier", 1.0), ("offset", 0.0))
        )
        return Mimic(leader, decimal_value(factor), decimal_value(offset))


def _check_unique(source: str, what: str, names: Sequence[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise SceneError(f"{source} has two {what}s named {name!r}; rename one")
        seen.add(name)


def find_root(source: str, links: dict[str, Inertia | None], joints: tuple[Joint, ...]) -> str:
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
                "a loop; cut it, and close it again with robot.close(frame_a, frame_b)"
            )
        parent_joint[joint.child] = joint
    roots = [link for link in links if link not in parent_joint]
    clear: set[str] = set()
    for link in links:
        seen: dict[str, None] = {}
        while link in parent_joint and link not in clear:
            if link in seen:
                names = [*list(seen)[list(seen).index(link) :], link]
                raise SceneError(
                    f"{source}: the links {', '.join(names)} form a loop; cut one of the joints between them"
                )
            seen[link] = None
            link = parent_joint[link].parent
        clear |= set(seen)
    if not roots:
        raise SceneError(f"{source} has no links; give a robot")
    if len(roots) > 1:
        raise SceneError(f"{source} has several links without a parent ({', '.join(roots)}); join them by fixed joints")
    return roots[0]
