"""sg.analyse: relative degree, dynamic extension, internal dynamics and their stability, and what that means."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca
import numpy as np

from servogen.analysis.inside import Inside, inside_of, inside_of_outputs
from servogen.analysis.zero_dynamics import STARTS, Equilibrium, Search, invariants_of
from servogen.results import FloatArray
from servogen.scene.scene import Scene, check_scene
from servogen.survey.degree import LARGEST
from servogen.survey.extension import extend, states_of

Verdict = Literal["none", "stable", "marginal", "unstable", "unknown"]

Degrees = Mapping[str, tuple[int | None, ...]]

_ZERO = 1e-6
"""Of an eigenvalue's real part beside the largest eigenvalue: what is smaller decides nothing."""


BRIEF = 2000
"""Operations of a closed loop beyond which who looks at it beside other things does not look for states of rest: for a
robot with seven joints that takes as long as a check."""

_PRESCRIBE = "prescribe {}, or a combination with it"

_NEAR = 0.5
"""Of half a range of the domain: a state of rest no further outside it counts as one of the scene's."""


@dataclass(frozen=True, eq=False)
class Analysis:
    """What a scene's constraints ask of its controls, and what they leave to itself.

    relative_degree: constraint -> for each row the order of its first derivative that the controls reach, None where
        they reach none; 0 for a phi that holds tau itself.
    extension: control -> integrators before it, by the dynamic extension algorithm, until all rows are independent; {}
        where they are so without any, None where no number of them is enough (`reason`).
    exchanged: control -> the row whose derivative stands in its place there, for several controls reach that row.
    extended_degree: the relative degree with these integrators.
    rank: of the rows' factors of tau, for almost all states, without integrators.
    internal_dimension: states, integrators included, that the rows and their derivatives leave free; None where the
        rows are dependent. flat: whether none is left, and as many rows as controls: psi is then a flat output.
    equilibrium: {"q", "u", "tau"} at rest with all constraints held, parameters and references at their defaults; None
        where none was found. zero_dynamics: the eigenvalues there, 1/s, of what the constraints leave free, by the
        linearised closed loop on the states that hold them; None without an equilibrium.
    verdict: "none": nothing is left free; "stable", "unstable": the eigenvalues say so; "marginal": one is on the
        imaginary axis, and the linearisation does not decide; "unknown": `reason` says why.
    meaning: the verdict in plain words.
    """

    scene: str
    relative_degree: Degrees
    extension: Mapping[str, int] | None
    exchanged: Mapping[str, str]
    extended_degree: Degrees
    rank: int
    rows: int
    controls: int
    internal_dimension: int | None
    flat: bool
    equilibrium: Mapping[str, FloatArray] | None
    zero_dynamics: Any
    verdict: Verdict
    reason: str
    meaning: str

    def __str__(self) -> str:
        return "\n".join(f"{name}: {text}" for name, text in self.lines())

    def lines(self) -> list[tuple[str, str]]:
        """(subject, sentence), in the order in which one reads them."""
        told = [("relative degree", _degrees_told(self.relative_degree))]
        told.append(("rank", f"{self.rank}, at almost all states, for {_count(self.rows, 'row')} and "
                             f"{_count(self.controls, 'control')}"))  # fmt: skip
        if self.extension is None:
            told.append(("extension", f"none is enough: {self.reason}"))
        elif self.extension:
            told.append(("extension", self._extension_told()))
        if self.internal_dimension is not None:
            flat = "; psi is a flat output" if self.flat else ""
            told.append(("internal dynamics", f"of dimension {self.internal_dimension}{flat}"))
        if self.zero_dynamics is not None and len(self.zero_dynamics):
            told.append(("eigenvalues", f"{', '.join(map(_eigenvalue, self.zero_dynamics))} per second"))
        return [*told, ("verdict", f"{self.verdict}: {self.meaning}")]

    def _extension_told(self) -> str:
        assert self.extension is not None
        parts = []
        for name, count in self.extension.items():
            place = f" (in its place, a derivative of {self.exchanged[name]})" if name in self.exchanged else ""
            parts.append(f"{_count(count, 'integrator')} before {name}{place}")
        return f"{', '.join(parts)}; with them the relative degree is {_degrees_told(self.extended_degree)}"


def analyse(scene: Scene, largest: int = LARGEST) -> Analysis:
    """Relative degree, dynamic extension, internal dynamics, and their stability at a state of rest.

    largest: operations of a closed loop beyond which its states of rest are not looked for.
    SceneError where `scene` is no Scene, and for an error of its own that no analysis gets around.
    """
    check_scene(scene, "sg.analyse")
    if not scene.system.of_outputs:
        return _of_a_law(scene, largest)
    found = extend(scene)
    facts: dict[str, Any] = {
        "relative_degree": _by_constraint(scene, found.first_degrees),
        "rank": found.first_rank,
        "extended_degree": _by_constraint(scene, found.degrees),
        "exchanged": dict(found.exchanged),
        "extension": None if found.reason else dict(found.integrators),
    }
    if found.reason:
        return _undecided(scene, facts, found.reason)
    assert found.reached is not None
    free = states_of(found.scene) - sum(found.reached.degrees) - invariants_of(scene)
    return _inside(scene, facts, free, lambda: inside_of_outputs(scene, found), largest)


def _of_a_law(scene: Scene, largest: int) -> Analysis:
    """Of a scene whose controls are no derivatives' factors: ideal forces, or a rate of tau."""
    with_tau = scene.system.tau_is_state
    orders = tuple(0 if with_tau else c.order for c in scene.constraints for _ in range(c.size))
    degrees = _by_constraint(scene, orders)
    facts: dict[str, Any] = {"relative_degree": degrees, "extended_degree": degrees, "extension": {}, "exchanged": {}}
    facts["rank"] = min(scene.rows, scene.system_shape[1])
    states = states_of(scene) + (scene.controls - scene.rows if with_tau else -sum(orders))
    return _inside(scene, facts, states - invariants_of(scene), lambda: inside_of(scene), largest)


def _inside(scene: Scene, facts: dict[str, Any], free: int, make: Callable[[], Inside], largest: int) -> Analysis:
    """What the internal dynamics, of dimension `free`, do."""
    flat = free == 0 and scene.rows == scene.controls
    facts |= {"internal_dimension": free, "flat": flat}
    if free == 0:
        meaning = "no motion is left that the constraints do not prescribe"
        return _analysis(scene, facts, "none", meaning)
    inside = make()
    if scene.mechanism.t is not None and ca.depends_on(ca.vertcat(inside.field, inside.held), scene.mechanism.t):
        return _undecided(scene, facts, "the scene depends on t, so it has no state of rest")
    if ca.Function("size", ca.symvar(inside.field), [inside.field]).n_instructions() > largest:
        return _undecided(scene, facts, f"the closed loop has more than {largest} operations")
    found, dependent = Search(inside).equilibria()
    if not found and dependent:
        return _undecided(scene, facts, "at the states of rest that were found the constraints are dependent, or a row "
                                        "of them vanishes")  # fmt: skip
    if not found:
        tried = f"from {STARTS} states of the domain, parameters and references at their defaults"
        return _undecided(scene, facts, f"no state of rest was found {tried}")
    judged = [_judged(scene, inside, e) for e in found]
    near = [k for k, e in enumerate(found) if e.far <= _NEAR]
    best = next((k for k in near if judged[k][0] == "stable"), 0)
    verdict, meaning = judged[best]
    unlike = sum(word != verdict for word, _ in judged)
    if unlike:
        meaning += (
            f"; of {len(judged) - 1} other states of rest {unlike} {'is' if unlike == 1 else 'are'} not {verdict}"
        )
    return _analysis(scene, facts, verdict, meaning, inside, found[best])


def _judged(scene: Scene, inside: Inside, at: Equilibrium) -> tuple[Verdict, str]:
    """The verdict of one equilibrium, and what it means."""
    values = at.eigenvalues
    held = " and ".join(repr(c.name) for c in scene.constraints)
    zero = _ZERO * max(1.0, float(np.max(np.abs(values))))
    worst, name = values[0], _moving_most(inside, at.modes[:, 0])
    where = "" if at.far == 0 else " (at a state of rest outside the domain)"
    if worst.real > zero:
        pace = f"{worst.real:+.4g} per second{where}"
        return "unstable", f"with {held} held, {name} runs away from rest at {pace}: {_PRESCRIBE.format(name)}"
    if worst.real >= -zero:
        remedy = "prescribe it, too"
        if scene.rows < scene.controls:
            remedy += ", or damp it with y or a weight, for there are more controls than rows"
        return (
            "marginal",
            f"with {held} held, {name} neither decays nor grows, as far as the linearisation tells{where}: {remedy}",
        )
    return "stable", f"with {held} held, all else comes to rest, the slowest at {worst.real:.4g} per second{where}"


def _moving_most(inside: Inside, mode: Any) -> str:
    """The entry of q that has the largest part in a mode, or of what else it moves."""
    sizes, n = np.abs(mode), int(inside.scene.mechanism.q.size1())
    k = int(np.argmax(sizes[:n])) if np.max(sizes[:n]) > 1e-6 * np.max(sizes) else int(np.argmax(sizes))
    name: str = inside.x[k].name()
    return name


def _undecided(scene: Scene, facts: dict[str, Any], reason: str) -> Analysis:
    return _analysis(scene, {"internal_dimension": None, "flat": False} | facts, "unknown", reason, reason=reason)


def _analysis(
    scene: Scene,
    facts: dict[str, Any],
    verdict: Verdict,
    meaning: str,
    inside: Inside | None = None,
    at: Equilibrium | None = None,
    reason: str = "",
) -> Analysis:
    rest = None
    if inside is not None and at is not None:
        n, m = (int(x.size1()) for x in (inside.scene.mechanism.q, inside.scene.mechanism.u))
        rest = {"q": at.x[:n], "u": at.x[n : n + m], "tau": at.tau}
    return Analysis(
        scene=scene.name,
        rows=scene.rows,
        controls=scene.controls,
        equilibrium=rest,
        zero_dynamics=None if at is None else at.eigenvalues,
        verdict=verdict,
        meaning=meaning,
        reason=reason,
        **facts,
    )


def _by_constraint(scene: Scene, degrees: Sequence[int | None]) -> dict[str, tuple[int | None, ...]]:
    found, row = {}, 0
    for c in scene.constraints:
        found[c.name] = tuple(degrees[row : row + c.size])
        row += c.size
    return found


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _degrees_told(degrees: Degrees) -> str:
    return "; ".join(
        f"{name!r} {', '.join('none' if d is None else str(d) for d in own)}" for name, own in degrees.items()
    )


def _eigenvalue(value: complex) -> str:
    return (
        f"{value.real:.4g}"
        if value.imag == 0
        else f"{value.real:.4g} {'+' if value.imag > 0 else '-'} {abs(value.imag):.4g}i"
    )
