"""A robot as lines: the links' origins, from the root to each last link."""

from collections.abc import Iterator, Mapping
from typing import Any

import casadi as ca

from servogen.urdf.base import Base
from servogen.urdf.motion import Link
from servogen.urdf.placement import point
from servogen.urdf.tree import Tree
from servogen.urdf.vectors import Mat, column, plus


def skeleton(links: list[Link], axes: list[Mat], tree: Tree, base: Base) -> tuple[Any, ...]:
    """Polylines in the world, each SX of 3 x k, m; every joint is drawn once."""

    def origin(link: str) -> Any:
        return column(plus(base.position, base.to_world(point(links, axes, tree.frames[link]).arm)))

    return tuple(ca.densify(ca.horzcat(*map(origin, chain))) for chain in chains(tree.above))


def chains(above: Mapping[str, str]) -> Iterator[tuple[str, ...]]:
    """Links in a row, each from the root or from a link of another chain outwards. above: link -> its parent."""
    drawn: set[str] = set()
    for last in above:
        if last in above.values():
            continue
        chain = [last]
        while chain[-1] in above and chain[-1] not in drawn:
            drawn.add(chain[-1])
            chain.append(above[chain[-1]])
        yield tuple(reversed(chain))
