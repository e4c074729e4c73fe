"""One controller: a mechanism, its servo-constraints, and what the solver is asked for."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import casadi as ca
import numpy as np

from servogen.errors import SceneError
from servogen.ir.ops import constants, unsupported_operations
from servogen.results import FloatArray
from servogen.scene.constraints import (
    CONSTRAINTS,
    Constraint,
    ControlsInvolved,
    Holonomic,
    expression_of,
    is_holonomic,
    theta_parts,
)
from servogen.scene.convert import column, matrix
from servogen.scene.limits import INPUTS, Limits, Side, Sides, read_limits
from servogen.scene.mechanism import Mechanism
from servogen.scene.names import check_identifier
from servogen.scene.passive import PassiveHolonomic, passive_name
from servogen.scene.solver import Solver
from servogen.scene.symbols import Field, Parameters, References
from servogen.scene.system import SYSTEMS, Function, Kind, System

State = dict[str, FloatArray]
Domain = Mapping[str, tuple[Any, Any]] | Callable[[np.random.Generator], Mapping[str, Any]]


MOST_SWITCHES = 4
"""Constraints that may come and go: where all of them do at once, 2^4 answers are found on the way to the last."""


@dataclass(frozen=True, eq=False, repr=False)
class Scene:
    """One controller, checked as a whole on construction (SceneError names the thing and the remedy).

    constraints: Nonholonomic, Holonomic and Output ones, or ControlsInvolved ones; rows stack in the order given.
        Those of several priorities are met one level after the other, the lowest number first.
    y: the free vector of Eqs. (10) and (54): None (zero), SX of the inputs, or "input".
    weight: W, l x l, symmetric positive definite, numbers or SX of the inputs and parameters: tau minimises
        (tau - y)^T W (tau - y) among the answers, tau = y + W^-1 S^T (S W^-1 S^T)^+ (z - S y); None: the identity;
        "inverse_mass": W = Q^-1, at little cost, for Q is factorised anyway.
    mode: "servo" (Eq. 10), or "ideal": G tau = R, the forces of an ideal passive constraint (Eqs. 13-17).
    limits: sg.Limits(lower, upper) on tau, for servo scenes; None: none.
    domain: ranges {"q": (lo, hi), ...} or a callable taking a numpy Generator and returning one state;
        every check draws its states from it.
    """

    name: str
    mechanism: Mechanism
    constraints: Sequence[Constraint]
    parameters: Parameters = field(default_factory=Parameters)
    references: References = field(default_factory=References)
    y: Any = None
    weight: Any = None
    mode: Literal["servo", "ideal"] = "servo"
    domain: Domain | None = None
    solver: Solver = field(default_factory=Solver)
    limits: Limits | None = None

    def __post_init__(self) -> None:
        check_identifier(self.name, "scene")
        if not isinstance(self.mechanism, Mechanism):
            raise SceneError(f"scene {self.name!r}: give an sg.Mechanism; got {type(self.mechanism).__name__}")
        given = self.constraints
        if isinstance(given, CONSTRAINTS):
            given = (given,)
        if not isinstance(given, list | tuple):
            raise SceneError(f"scene {self.name!r}: constraints must be a list; got {type(given).__name__}")
        object.__setattr__(self, "constraints", tuple(given))
        for word, kind in (("parameters", Parameters), ("references", References)):
            value = kind() if getattr(self, word) is None else getattr(self, word)
            if not isinstance(value, kind):
                got = type(value).__name__
                raise SceneError(
                    f"scene {self.name!r}: {word} must be sg.{kind.__name__}(name=default, ...); got {got}"
                )
            object.__setattr__(self, word, value)
        if self.y is not None and not (isinstance(self.y, str) and self.y == "input"):
            if isinstance(self.y, str):
                raise SceneError(f"y={self.y!r}; give None, an SX expression of the inputs, or 'input'")
            object.__setattr__(self, "y", column(self.y, "y", self.controls))
        if isinstance(self.weight, str):
            _check_inverse_mass(self)
        elif self.weight is not None:
            l = self.controls
            object.__setattr__(self, "weight", matrix(self.weight, "weight", l, l, "one row and column per control"))
        _check_mode(self)
        if not isinstance(self.solver, Solver):
            raise SceneError(f"scene {self.name!r}: solver is {type(self.solver).__name__}; give an sg.Solver(...)")
        _check_kinds(self)
        if self.limits is not None:
            _check_limits(self)
        _check_names(self)
        _check_symbols(self)
        _check_operations(self)
        _check_domain(self)

    def __repr__(self) -> str:
        names = ", ".join(repr(c.name) for c in self.constraints)
        return (
            f"<Scene {self.name!r} ({self.kind}): {self.rows} rows of constraints ({names}), {self.controls} controls>"
        )

    @property
    def kind(self) -> Kind:
        """Servo-constraints (S tau = z), ideal control forces (G tau = R) or controls-involved ones (A tau' = B)."""
        return "controls" if isinstance(self.constraints[0], ControlsInvolved) else self.mode

    @property
    def system(self) -> System:
        """What the kind's linear system is called."""
        system = SYSTEMS[self.kind]
        return system.with_passive() if self.mechanism.passive else system

    @property
    def rows(self) -> int:
        """m, the number of constraint rows."""
        return sum(c.size for c in self.constraints)

    @property
    def controls(self) -> int:
        """l, the number of controls."""
        return int(self.mechanism.tau.size1())

    @property
    def weighs_by_inverse_mass(self) -> bool:
        """Whether W is Q^-1."""
        return isinstance(self.weight, str)

    @property
    def system_shape(self) -> tuple[int, int]:
        """Rows and columns of the matrix that is solved with: S or A (m x l), G of ideal control forces (n x l)."""
        rows = int(self.mechanism.u.size1()) if self.kind == "ideal" else self.rows
        return rows, self.controls

    @property
    def levels(self) -> tuple[tuple[int, ...], ...]:
        """The rows of each priority, the most important first; one level where all constraints are alike."""
        rows: dict[int, list[int]] = {}
        at = 0
        for c in self.constraints:
            priority = 0 if isinstance(c, ControlsInvolved) else c.priority
            rows.setdefault(priority, []).extend(range(at, at + c.size))
            at += c.size
        return tuple(tuple(rows[priority]) for priority in sorted(rows))

    @property
    def switches(self) -> tuple[tuple[str, tuple[int, ...]], ...]:
        """(input, rows) of each constraint that an input brings in and takes out."""
        found, at = [], 0
        for c in self.constraints:
            if not isinstance(c, ControlsInvolved) and c.active is not None:
                found.append((f"{c.name}_active", tuple(range(at, at + c.size))))
            at += c.size
        return tuple(found)

    @property
    def cascaded(self) -> bool:
        """Whether tau is found level by level: there are priorities, or constraints that come and go."""
        return len(self.levels) > 1 or bool(self.switches)

    def shape_of(self, function: Function) -> tuple[int, ...]:
        """The shape of what a function of the scene's twins returns."""
        passive = self.mechanism.passive
        p = sum(c.chi.size1() for c in passive)
        c = p + sum(c.chi.size1() for c in passive if isinstance(c, PassiveHolonomic))
        sizes = {"m": self.rows, "l": self.controls, "n": int(self.mechanism.u.size1()), "p": p, "c": c}
        return tuple(sizes[letter] for letter in function.shape)

    def input_fields(self) -> tuple[Field, ...]:
        """Every input the scene may have, in the order of the generated struct: q, u, t, tau, y, the references."""
        mech = self.mechanism
        fields = [_state_field("q", mech.q), _state_field("u", mech.u)]
        if mech.t is not None:
            fields.append(_state_field("t", mech.t))
        if self.tau_is_input:
            fields.append(_state_field("tau", mech.tau))
        if isinstance(self.y, str):
            fields.append(_state_field("y", self.y_symbol))
        if self.sides is not None:
            sides = [side for side, given in self.sides.each() if isinstance(given, str)]
            fields += [self._limit_field(INPUTS[side], f"{side} limits of tau, an infinity for none") for side in sides]
        fields += [
            Field(name, ca.SX.sym(name), (1.0,), "", "0: the constraint is left out, 1: it holds")
            for name, _ in self.switches
        ]
        return (*fields, *self.references)

    def _limit_field(self, name: str, text: str) -> Field:
        return Field(name, ca.SX.sym(name, self.controls), (0.0,) * self.controls, "", text)

    @property
    def sides(self) -> Sides | None:
        """The limits as they were read; None where there are none."""
        return self.__dict__.get("_sides")

    @property
    def tau_is_input(self) -> bool:
        """Whether a function of the scene takes tau: where it is a state, or for multipliers of passive constraints."""
        return self.system.tau_is_state or bool(self.mechanism.passive)

    @property
    def y_symbol(self) -> Any:
        """The symbol that stands for y where it is an input; one per scene, so that expressions can share it."""
        cached = self.__dict__.get("_y_symbol")
        if cached is None:
            cached = ca.SX.sym("y", self.controls)
            object.__setattr__(self, "_y_symbol", cached)
        return cached


def check_scene(scene: object, what: str) -> None:
    """SceneError unless it is a Scene; what: the function that was called."""
    if not isinstance(scene, Scene):
        raise SceneError(f"{what}: give an sg.Scene; got {type(scene).__name__}")


def _state_field(name: str, symbol: Any) -> Field:
    elements = [e.name() for e in symbol.nonzeros()]
    return Field(name, symbol, (0.0,) * symbol.size1(), "", ", ".join(elements))


def expressions(scene: Scene) -> dict[str, Any]:
    """Every expression of the scene by the words an error names it with."""
    mech = scene.mechanism
    parts = {name: getattr(mech, name) for name in ("Q", "P", "G", "C", "D") if getattr(mech, name) is not None}
    for passive in mech.passive:
        parts |= {passive_name(passive, n): getattr(passive, n) for n in ("chi", "stabilise")}
    for c in scene.constraints:
        symbol = "phi" if isinstance(c, ControlsInvolved) else "psi"
        parts[f"constraint {c.name!r}: {symbol}"] = expression_of(c)
        for name, theta in theta_parts(c).items():
            parts[f"constraint {c.name!r}: {name}"] = theta
    if isinstance(scene.y, ca.SX):
        parts["y"] = scene.y
    if isinstance(scene.weight, ca.SX):
        parts["weight"] = scene.weight
    if scene.sides is not None:
        parts |= {f"limits: {name}": side.expression for name, side in scene.sides.each() if isinstance(side, Side)}
    return parts


def _check_inverse_mass(scene: Scene) -> None:
    n = scene.mechanism.u.size1()
    if scene.weight != "inverse_mass":
        raise SceneError(f"weight={scene.weight!r}; give None, 'inverse_mass', or a matrix of numbers or SX")
    if scene.controls != n:
        raise SceneError(
            f"weight='inverse_mass' is {n}x{n}, as Q is, but there are {scene.controls} controls; it is for mechanisms "
            "with one control per velocity parameter: give a weight of your own, one row and column per control"
        )


def _check_limits(scene: Scene) -> None:
    """Read them. SceneError where they make no sense, or for a kind of scene that takes none."""
    if scene.kind != "servo":
        unknown = "tau', the rate of the controls" if scene.kind == "controls" else "forces of an ideal constraint"
        raise SceneError(
            f"scene {scene.name!r}: limits are for servo scenes, whose answer is tau; this one's is {unknown}: "
            "leave out limits"
        )
    if scene.cascaded:
        raise SceneError(
            f"scene {scene.name!r}: limits with priorities or with active='input' are not built; give all constraints "
            "one priority and keep them active, or leave out limits"
        )
    sides = read_limits(scene.limits, scene.controls)
    for name, side in sides.each():
        if isinstance(side, Side) and ca.depends_on(side.expression, scene.mechanism.tau):
            raise SceneError(f"limits: {name} depends on tau, which the scene solves for; make it of the inputs")
        taken = {f.name for f in (*scene.parameters, *scene.references)}
        if isinstance(side, str) and INPUTS[name] in taken:
            raise SceneError(
                f"limits: {name}='input' brings the input {INPUTS[name]}, but a parameter or reference has that name; "
                f"rename it, or give limits={name} as SX of it"
            )
    if scene.solver.damping is not None:
        raise SceneError(
            f"Solver(damping={scene.solver.damping!r}) and limits: a damped answer is no least-squares optimum, so "
            "nothing could be certified; leave out damping (limits bound tau near a singularity, too), or the limits"
        )
    object.__setattr__(scene, "_sides", sides)


def _check_mode(scene: Scene) -> None:
    if scene.mode not in ("servo", "ideal"):
        raise SceneError(f"scene {scene.name!r}: mode={scene.mode!r}; choose 'servo' or 'ideal'")


def _check_kinds(scene: Scene) -> None:
    if not scene.constraints:
        raise SceneError(f"scene {scene.name!r} has no constraints; give at least one")
    for c in scene.constraints:
        if not isinstance(c, CONSTRAINTS):
            raise SceneError(
                f"scene {scene.name!r}: {type(c).__name__} is no servo-constraint; "
                "give sg.Nonholonomic, sg.Holonomic, sg.Output or sg.ControlsInvolved"
            )
    involved = [c.name for c in scene.constraints if isinstance(c, ControlsInvolved)]
    if involved and len(involved) < len(scene.constraints):
        other = next(c.name for c in scene.constraints if c.name not in involved)
        raise SceneError(
            f"scene {scene.name!r} mixes controls-involved constraints ({involved[0]!r}) with others ({other!r}); "
            "make two scenes of them: the first gives tau', the second tau"
        )
    if scene.mode == "ideal" and scene.cascaded:
        raise SceneError(
            f"scene {scene.name!r}: mode='ideal' takes all constraints alike, for G tau = R has no rows of theirs; "
            "leave mode at 'servo', or give all constraints one priority and no active='input'"
        )
    if scene.solver.method == "cod" and scene.cascaded:
        raise SceneError(
            f"scene {scene.name!r}: Solver(method='cod') and priorities or active='input': what is left to a level "
            "is decided by singular values; choose method 'auto' or 'svd', or give all constraints one priority and "
            "leave them active"
        )
    names = [c.name for c in scene.constraints]
    for name in names:
        if names.count(name) > 1:
            raise SceneError(f"scene {scene.name!r} has two constraints named {name!r}; rename one")
    mech = scene.mechanism
    for c in scene.constraints:
        what, expression = f"constraint {c.name!r}", expression_of(c)
        if isinstance(c, Holonomic) and ca.depends_on(expression, mech.u):
            raise SceneError(f"{what}: a holonomic psi is a function of q and t only, but it depends on u; "
                             "use sg.Nonholonomic for psi(q, u, t)")  # fmt: skip
        if isinstance(c, ControlsInvolved):
            if not ca.depends_on(expression, mech.tau):
                raise SceneError(f"{what}: tau is missing from phi; use sg.Nonholonomic for psi(q, u, t)")
        elif ca.depends_on(expression, mech.tau):
            raise SceneError(f"{what}: psi depends on tau; use sg.ControlsInvolved for phi(q, u, tau, t)")
    if scene.mode == "ideal" and mech.passive:
        raise SceneError(
            f"scene {scene.name!r}: mode='ideal' is not supported with passive constraints "
            f"({mech.passive[0].name!r}); leave mode at 'servo'"
        )
    higher = [c.name for c in scene.constraints if c.order > 1 and not is_holonomic(c, mech.u)]
    if scene.mode == "ideal" and higher:
        raise SceneError(
            f"scene {scene.name!r}: mode='ideal' asks for the forces of a constraint on u' itself, but the output "
            f"{higher[0]!r} prescribes a derivative beyond it; leave mode at 'servo'"
        )
    if scene.mode == "ideal" and involved:
        raise SceneError(
            f"scene {scene.name!r}: mode='ideal' has no meaning for the controls-involved constraint {involved[0]!r}; "
            "leave mode at 'servo'"
        )
    if scene.kind == "ideal" and scene.rows > mech.u.size1():
        raise SceneError(
            f"scene {scene.name!r}: {scene.rows} rows of constraints on {mech.u.size1()} velocity parameters; "
            "an ideal constraint force takes at most as many: drop the others"
        )
    for what in ("y", "weight"):
        value = getattr(scene, what)
        if not scene.system.tau_is_state and isinstance(value, ca.SX) and ca.depends_on(value, mech.tau):
            raise SceneError(f"{what} depends on tau, which the scene solves for; make {what} a function of the inputs")
    parameters = ca.vertcat(*(f.symbol for f in scene.parameters))
    for c in scene.constraints:
        for name, theta in theta_parts(c).items():
            for symbol in ca.symvar(theta):
                if not _among(symbol, parameters):
                    raise SceneError(
                        f"constraint {c.name!r}: {name} holds {symbol.name()!r}, which is not a parameter; "
                        "make it of numbers and sg.Parameters"
                    )
    _check_passive_symbols(scene)


def _check_passive_symbols(scene: Scene) -> None:
    """chi is of the state, time and parameters, stabilise of parameters: else no state could be closed onto them."""
    mech = scene.mechanism
    parameters = ca.vertcat(*(f.symbol for f in scene.parameters))
    state = ca.vertcat(mech.q, mech.u, ca.SX(0, 1) if mech.t is None else mech.t, parameters)
    for c in mech.passive:
        speeds = "" if isinstance(c, PassiveHolonomic) else "u, "
        for name, allowed, made_of in (
            ("chi", state, f"make it of q, {speeds}t and sg.Parameters"),
            ("stabilise", parameters, "make it of numbers and sg.Parameters"),
        ):
            for symbol in ca.symvar(getattr(c, name)):
                if not _among(symbol, allowed):
                    kind = "not a parameter" if name == "stabilise" else "neither state, time nor parameter"
                    raise SceneError(f"{passive_name(c, name)} holds {symbol.name()!r}, which is {kind}; {made_of}")


def _among(symbol: Any, symbols: Any) -> bool:
    return any(symbol.__hash__() == s.__hash__() for s in symbols.nonzeros())


def _check_names(scene: Scene) -> None:
    assert scene.references is not None
    references = {f.name for f in scene.references}
    if len(scene.switches) > MOST_SWITCHES:
        raise SceneError(
            f"scene {scene.name!r}: {len(scene.switches)} constraints with active='input'; there may be "
            f"{MOST_SWITCHES}, for all that move at once are solved with and without one another: make one "
            "constraint of those that come and go together"
        )
    for name, _ in scene.switches:
        if name in references | {f.name for f in scene.parameters}:
            raise SceneError(
                f"constraint {name.removesuffix('_active')!r}: active='input' brings the input {name}, but a parameter "
                "or reference has that name; rename one"
            )
    for f in scene.parameters:
        if f.name in references:
            raise SceneError(f"parameter {f.name!r} collides with the reference of that name; rename one")


def _check_symbols(scene: Scene) -> None:
    assert scene.references is not None
    mech = scene.mechanism
    owners: dict[int, str] = {}
    named = [("q", mech.q), ("u", mech.u), ("tau", mech.tau)] + ([("t", mech.t)] if mech.t is not None else [])
    named += [(f"parameter {f.name!r}", f.symbol) for f in scene.parameters]
    named += [(f"reference {f.name!r}", f.symbol) for f in scene.references]
    for owner, symbols in named:
        for s in symbols.nonzeros():
            if s.__hash__() in owners:
                raise SceneError(f"symbol {s.name()!r} stands in both {owners[s.__hash__()]} and {owner}; use two")
            owners[s.__hash__()] = owner
    known = ca.vertcat(mech.tau, *(f.symbol for f in scene.input_fields()), *(f.symbol for f in scene.parameters))
    known_ids = {s.__hash__() for s in known.nonzeros()}
    for what, expression in expressions(scene).items():
        for symbol in ca.symvar(expression):
            if symbol.__hash__() not in known_ids:
                raise SceneError(
                    f"{what} holds the symbol {symbol.name()!r}, which is not an input of scene {scene.name!r}; "
                    "put it among q, u, tau, t, the parameters or the references"
                )


def _check_operations(scene: Scene) -> None:
    for what, expression in expressions(scene).items():
        for name, casadi_id in unsupported_operations(expression):
            raise SceneError(
                f"{what}: operation {name} (CasADi id {casadi_id}) is not supported; "
                "express it by supported ones, or add a row to ir/ops.py"
            )
        for number in constants(expression):
            if not np.isfinite(number):
                raise SceneError(f"{what} holds the constant {number}; give finite numbers")


def _check_domain(scene: Scene) -> None:
    if scene.domain is None or callable(scene.domain):
        return
    if not isinstance(scene.domain, Mapping):
        got = type(scene.domain).__name__
        raise SceneError(f'domain is a {got}; give {{"q": (lo, hi), ...}}, or a function of a numpy Generator')
    sizes = {f.name: f.size for f in scene.input_fields()} | {"tau": scene.controls, "t": 1}
    for name, limits in scene.domain.items():
        if name not in sizes:
            raise SceneError(f"domain: {name!r} is no input of scene {scene.name!r}; there are {', '.join(sizes)}")
        try:
            lo, hi = (np.broadcast_to(np.asarray(b, dtype=float), (sizes[name],)) for b in limits)
        except (TypeError, ValueError):
            raise SceneError(
                f"domain[{name!r}] = {limits!r}; give (lo, hi), each a number or a list of {sizes[name]}"
            ) from None
        if not (np.all(np.isfinite(lo)) and np.all(np.isfinite(hi)) and np.all(lo <= hi)):
            raise SceneError(f"domain[{name!r}] = {limits!r}; the ends must be finite and lo <= hi")
