"""Passive constraints: what joins the bodies of a mechanism beside its velocity parameters, loops and rolling."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from servogen.errors import SceneError
from servogen.scene.convert import column, rates
from servogen.scene.names import check_identifier


@dataclass(frozen=True, eq=False)
class PassiveHolonomic:
    """chi(q, t) = 0: p rows, held by forces J^T lam without work, J = chi_q C.

    stabilise: omega, 1/s, a number or SX of parameters: 2 omega chi' + omega^2 chi is added to chi'' in the plant of a
    simulation, and nowhere else (Baumgarte (1972)). meant: SX that are positive where chi = 0 is meant, where it has
    other solutions, too (an elbow that bends the other way): states of a domain and starts are closed there alone.
    SceneError for wrong shapes.
    """

    name: str
    chi: Any
    stabilise: Any = 0.0
    meant: Any = ()

    def __post_init__(self) -> None:
        _check(self)
        meant = ca.SX(0, 1) if isinstance(self.meant, tuple | list) and not self.meant else self.meant
        object.__setattr__(self, "meant", ca.densify(column(meant, passive_name(self, "meant"))))


@dataclass(frozen=True, eq=False)
class PassiveNonholonomic:
    """chi(q, u, t) = 0, affine in u: p rows, held by forces J^T lam without work, J = chi_u.

    stabilise: omega, 1/s, a number or SX of parameters: omega chi is added to chi' in the plant of a simulation, and
    nowhere else. SceneError for wrong shapes.
    """

    name: str
    chi: Any
    stabilise: Any = 0.0

    def __post_init__(self) -> None:
        _check(self)


Passive = PassiveHolonomic | PassiveNonholonomic


def passive_name(constraint: Passive, part: str) -> str:
    """What an error calls a part of it, "chi" or "stabilise"."""
    return f"passive constraint {constraint.name!r}: {part}"


def _check(constraint: Passive) -> None:
    check_identifier(constraint.name, "passive constraint")
    chi, stabilise = (passive_name(constraint, n) for n in ("chi", "stabilise"))
    object.__setattr__(constraint, "chi", ca.densify(column(constraint.chi, chi)))
    object.__setattr__(constraint, "stabilise", rates(constraint.stabilise, stabilise, 1))


def check_passive(given: Any, q: Any, u: Any, tau: Any) -> tuple[Passive, ...]:
    """A mechanism's passive constraints; SceneError for other things, names used twice, and a chi of the wrong kind."""
    listed = (given,) if isinstance(given, Passive) else given
    if not isinstance(listed, Sequence) or not all(isinstance(c, Passive) for c in listed):
        raise SceneError("passive: give a list of sg.PassiveHolonomic and sg.PassiveNonholonomic")
    names = [c.name for c in listed]
    for c in listed:
        what = f"passive constraint {c.name!r}"
        if names.count(c.name) > 1:
            raise SceneError(f"passive: two constraints are named {c.name!r}; rename one")
        if ca.depends_on(c.chi, tau):
            raise SceneError(f"{what}: chi depends on tau; a passive constraint is of q, u and t")
        if isinstance(c, PassiveHolonomic):
            if ca.depends_on(c.chi, u):
                raise SceneError(f"{what}: a holonomic chi is of q and t only; use sg.PassiveNonholonomic")
            if ca.depends_on(c.meant, ca.vertcat(u, tau)):
                raise SceneError(f"{what}: meant depends on u or tau; it is of q and t")
            for k in range(c.chi.size1()):
                if not ca.depends_on(c.chi[k], q):
                    row = "chi" if c.chi.size1() == 1 else f"row {k + 1} of chi"
                    raise SceneError(
                        f"{what}: {row} does not depend on q; write it as a function of q, or leave it out"
                    )
            continue
        slope = ca.jacobian(c.chi, u)
        if slope.nnz() == 0:
            raise SceneError(f"{what}: chi does not depend on u; use sg.PassiveHolonomic")
        if ca.depends_on(slope, u):
            raise SceneError(f"{what}: chi is not affine in u; write it as J(q, t) u + c(q, t)")
    return tuple(listed)
