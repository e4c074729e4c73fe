"""A load fixed to a frame, whose mass, centre and inertia may be parameters."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from servogen.errors import SceneError
from servogen.results import FloatArray
from servogen.scene.convert import column, matrix
from servogen.urdf.dynamics import Composite
from servogen.urdf.tree import Tree
from servogen.urdf.vectors import number_rows, numbers, plus, product, symmetric, times, turned, unpack


@dataclass(frozen=True, eq=False)
class Payload:
    """mass (kg) at `centre` (3, m, in the axes of `frame`, a link), with `inertia` (3 x 3, kg m^2) about that centre.

    Each a number or SX of parameters. inertia: symmetric; of a point where none is given. SceneError for wrong shapes
    and for a negative mass.
    """

    frame: str
    mass: Any
    centre: Any = (0.0, 0.0, 0.0)
    inertia: Any = None

    def __post_init__(self) -> None:
        what = f"payload at {self.frame!r}"
        mass = column(self.mass, f"{what}: mass", 1)
        if mass.is_constant() and float(mass) < 0:
            raise SceneError(f"{what} has the mass {float(mass)}; give one that is not negative")
        inertia = ca.SX.zeros(3, 3) if self.inertia is None else self.inertia
        inertia = ca.densify(matrix(inertia, f"{what}: inertia", 3, 3, "about the payload's centre"))
        if not ca.is_equal(inertia, inertia.T, 1):
            raise SceneError(f"{what}: inertia is not symmetric; write I[j, i] as the same expression as I[i, j]")
        if inertia.is_constant():
            _check_moments(what, np.array(ca.DM(inertia)))
        object.__setattr__(self, "mass", mass)
        object.__setattr__(self, "centre", ca.densify(column(self.centre, f"{what}: centre", 3)))
        object.__setattr__(self, "inertia", inertia)

    def on(self, tree: Tree) -> tuple[int, Composite]:
        """The body that carries it, and its moments in that body's frame."""
        if self.frame not in tree.frames:
            raise SceneError(
                f"payload: no frame {self.frame!r}; the links that name frames are {', '.join(tree.frames)}"
            )
        at = tree.frames[self.frame]
        rows = number_rows(at.rotation)
        r = plus(numbers(at.origin), product(rows, unpack(self.centre)))
        I = self.inertia
        half = ca.trace(I) / 2
        about = symmetric(half - I[0, 0], half - I[1, 1], half - I[2, 2], -I[0, 1], -I[0, 2], -I[1, 2])
        s = turned(rows, about)
        first = times(self.mass, r)

        def moved(i: int, j: int) -> Any:
            return s[i][j] + first[i] * r[j]

        second = symmetric(moved(0, 0), moved(1, 1), moved(2, 2), moved(0, 1), moved(0, 2), moved(1, 2))
        return at.body, Composite(self.mass, first, second)


def _check_moments(what: str, inertia: FloatArray) -> None:
    """SceneError for moments that no body has: of masses, none is negative, and none exceeds the sum of both others."""
    smallest, middle, largest = np.linalg.eigvalsh(inertia)
    rounding = 1e-9 * abs(largest)
    if smallest < -rounding or largest > smallest + middle + rounding:
        raise SceneError(
            f"{what}: its inertia has the principal moments {smallest:.4g}, {middle:.4g}, {largest:.4g}, which no body "
            "has; give moments about its centre, none negative and none above the sum of both others"
        )
