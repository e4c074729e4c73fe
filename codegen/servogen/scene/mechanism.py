"""The mechanical model (1)-(2): q' = C u + D, Q u' = P + G tau."""

from dataclasses import dataclass, field
from typing import Any

import casadi as ca

from servogen.errors import SceneError
from servogen.scene.convert import column, is_identity, matrix, rates, symbols
from servogen.scene.known_rates import Gauge, KnownRates
from servogen.scene.passive import check_passive
from servogen.scene.polylines import polylines


@dataclass(frozen=True, eq=False, repr=False)
class Mechanism:
    """A model in first-order form, Bajodah, Hodges and Chen (2004), Eqs. (1)-(2).

    q: n_q configuration parameters, u: n_u velocity parameters, tau: l controls, t: time, all SX symbols.
    Q: n_u x n_u of q, t. P: n_u of q, u, t. G: n_u x l of q, u, t (l may exceed n_u).
    C: n_q x n_u of q, t, identity if absent. D: n_q of q, t, zero if absent.
    known_rates: expressions of q whose rates need no differentiation (sg.urdf fills it); None if there are none.
    skeleton: polylines of q by which a report draws it (sg.urdf fills it), as sg.Simulation(drawing=...); () if none.
    passive: sg.PassiveHolonomic and sg.PassiveNonholonomic, loops and rolling: Q u' = P + G tau + J^T lam with
        J u' + j = 0; () if none.
    Entries may be SX or numbers, and may hold parameters. SceneError for wrong shapes and kinds.
    """

    q: Any
    u: Any
    tau: Any
    Q: Any
    P: Any
    G: Any
    C: Any = None
    D: Any = None
    t: Any = None
    known_rates: KnownRates | None = None
    skeleton: Any = ()
    passive: Any = ()
    _postures: list[tuple[Any, Any, Any]] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        for name in ("q", "u", "tau"):
            put(name, symbols(getattr(self, name), name))
        if self.t is not None:
            put("t", symbols(self.t, "t"))
            if self.t.size1() != 1:
                raise SceneError(f"t has {self.t.size1()} entries; time is one SX symbol")
        n_q, n_u, n_tau = self.q.size1(), self.u.size1(), self.tau.size1()
        put("Q", matrix(self.Q, "Q", n_u, n_u, "one row and column per velocity parameter"))
        put("P", column(self.P, "P", n_u))
        put("G", matrix(self.G, "G", n_u, n_tau, "one row per velocity parameter, one column per control"))
        if self.C is not None:
            put("C", matrix(self.C, "C", n_q, n_u, "one row per configuration, one column per velocity parameter"))
        elif n_q != n_u:
            raise SceneError(f"q has {n_q} entries and u has {n_u}; give C ({n_q}x{n_u}), for q' = C u + D")
        if self.D is not None:
            put("D", column(self.D, "D", n_q))
        put("passive", check_passive(self.passive, self.q, self.u, self.tau))
        put("skeleton", polylines(self.skeleton, "skeleton"))
        for name in ("C", "D", "Q"):
            expression = getattr(self, name)
            if expression is not None and ca.depends_on(expression, self.u):
                raise SceneError(f"{name} depends on u; {name} is a function of q and t only, Eqs. (1)-(2)")
        for name in ("C", "D", "Q", "P", "G"):
            expression = getattr(self, name)
            if expression is not None and ca.depends_on(expression, self.tau):
                raise SceneError(f"{name} depends on tau; the controls enter the model through G tau only, Eq. (2)")

    def __repr__(self) -> str:
        named = (("q", self.q), ("u", self.u), ("tau", self.tau))
        return f"<Mechanism: {'; '.join(f'{n} = ' + ', '.join(e.name() for e in s.nonzeros()) for n, s in named)}>"

    @property
    def q_dot(self) -> Any:
        """q' = C u + D, Eq. (1)."""
        rate = self.u if self.C is None else ca.mtimes(self.C, self.u)
        return rate if self.D is None else rate + self.D

    @property
    def gauge(self) -> Gauge | None:
        """A cheaper form of Q u' = P + G tau, where Q and P are those it is known for."""
        gauge = self.known_rates.gauge if self.known_rates is not None else None
        return gauge if gauge is not None and gauge.holds_for(self.Q, self.P) else None

    def posture(self, damping: Any = 0.0, stiffness: Any = 0.0, centre: Any = None) -> Any:
        """The controls that by themselves would give u' = -damping u - stiffness (q - centre): SX, l; a scene's `y`.

        G y = Q (-damping u - stiffness (q - centre)) - P: gravity, Coriolis and all other forces of P compensated.
        With weight="inverse_mass" the answer is then the one whose u' is nearest to that in the kinetic metric
        (Gauss' principle; Peters et al., "A unifying framework for robot control with redundant DOFs", Autonomous
        Robots 24, 2008), so that what the constraints leave free comes to rest.
        damping: 1/s; stiffness: 1/s^2; each a number, one per velocity parameter, or SX of parameters. centre: n_q, in
        q's units, numbers or SX of parameters and references. SceneError for a mechanism without one control per
        velocity parameter, and for a stiffness where q' is not u.
        """
        d, k = (rates(v, f"posture: {name}", self.u.size1()) for v, name in
                ((damping, "damping"), (stiffness, "stiffness")))  # fmt: skip
        wanted = -d * self.u
        if k.is_zero() != (centre is None):
            raise SceneError("posture: stiffness draws q to a centre; give both, or neither")
        if centre is not None:
            if self.C is not None or self.D is not None:
                raise SceneError(
                    "posture: stiffness needs q' = u, but the mechanism has a C or D; leave it out, or write y yourself"
                )
            wanted -= k * (self.q - column(centre, "posture: centre", self.q.size1()))
        force = self.P
        if self.gauge is not None:
            wanted, force = wanted - self.gauge.u_dot, self.gauge.force
        n = self.u.size1()
        if self.tau.size1() != n or ca.sprank(ca.sparsify(self.G)) < n:
            raise SceneError(
                f"posture: G is {n}x{self.tau.size1()}; it is for mechanisms with one control per velocity parameter, "
                "which G y reaches: write y yourself"
            )
        y = ca.mtimes(self.Q, wanted) - force
        if not is_identity(self.G):
            return ca.solve(self.G, y)
        self._postures.append((y, force, wanted))
        return y

    def posture_of(self, y: Any) -> tuple[Any, Any] | None:
        """(force, a) of a y = Q a - force made by `posture`, where G is the identity; None for any other y."""
        return next(((force, a) for known, force, a in self._postures if ca.is_equal(known, y)), None)
