"""The closed loop as a vector field, and what of it the constraints leave free: the internal dynamics."""

from dataclasses import dataclass
from math import comb
from typing import Any

import casadi as ca

from servogen.compiler import motion_of
from servogen.derive.derive import derive
from servogen.derive.passive import accelerations, closure_of
from servogen.law.steps import React
from servogen.scene.constraints import expression_of
from servogen.scene.scene import Scene
from servogen.survey.extension import Extension, Reached, surveyed


@dataclass(frozen=True, eq=False)
class Inside:
    """x' = field of the closed loop, all SX of x, the parameters and the references.

    x: the entries of `states`, q and u, and tau where it is one. held: what is zero where all constraints are held, psi
    with its rates below the relative degree, and chi with chi' of passive constraints. controls: tau as the law gives
    it. scene: whose inputs and parameters the symbols are. speeds: so many entries of u, the first, are velocity
    parameters.
    """

    scene: Scene
    states: tuple[str, ...]
    speeds: int
    field: Any
    held: Any
    controls: Any

    @property
    def x(self) -> Any:
        return ca.vertcat(*(getattr(self.scene.mechanism, name) for name in self.states))


def inside_of_outputs(scene: Scene, extension: Extension) -> Inside:
    """A servo scene's, with the integrators it needs; errors of the constraints decay with eigenvalues of -1.

    Where the constraints leave controls free, y and the weight decide on these.
    """
    extended, reached = extension.scene, extension.reached
    assert reached is not None
    mech = extended.mechanism
    samples, found = surveyed(extended)
    own = not extension.integrators
    y = scene.y if own and isinstance(scene.y, ca.SX) else ca.SX(extended.controls, 1)
    S = reached.S
    if not own or scene.weight is None:
        back = S.T
    elif scene.weighs_by_inverse_mass:
        back = ca.mtimes(scene.mechanism.Q, S.T)
    else:
        back = ca.solve(scene.weight, S.T)
    missing = _prescribed(reached) - reached.drift - ca.mtimes(S, y)
    tau = y + ca.mtimes(back, ca.solve(ca.mtimes(S, back), missing))
    u_dot, _ = accelerations(samples, found, mech.P + ca.mtimes(mech.G, tau))
    held = ca.vertcat(*(x for row in reached.rates for x in row), *_closed(extended))
    return Inside(extended, ("q", "u"), int(scene.mechanism.u.size1()), ca.vertcat(mech.q_dot, u_dot), held, tau)


def inside_of(scene: Scene) -> Inside:
    """Of a scene whose answer is no derivative of outputs: tau' of a state tau, or the forces of ideal constraints."""
    mech = scene.mechanism
    samples, found = surveyed(scene)
    formulation = derive(samples, found)
    matrix, right = formulation[scene.system.matrix], None
    for step in formulation.law.routine("control").steps:
        if isinstance(step, React):
            J = formulation[step.jacobian]
            right = ca.mtimes(J.T, ca.solve(formulation[step.matrix], formulation[step.right]))
    right = formulation[scene.system.right] if right is None else right
    y = scene.y if isinstance(scene.y, ca.SX) else ca.SX(scene.controls, 1)
    missing = right - ca.mtimes(matrix, y)
    rows, columns = matrix.shape
    if rows <= columns:
        answer = y + ca.mtimes(matrix.T, ca.solve(ca.mtimes(matrix, matrix.T), missing))
    else:
        answer = y + ca.solve(ca.mtimes(matrix.T, matrix), ca.mtimes(matrix.T, missing))
    tau = mech.tau if scene.system.tau_is_state else answer
    u_dot, _ = accelerations(samples, found, mech.P + ca.mtimes(mech.G, tau))
    held = []
    for c in scene.constraints:
        drift, values = motion_of(scene, c), [expression_of(c)]
        for _ in range(c.order - 1):
            values.append(drift.rate(values[-1], f"constraint {c.name!r}"))
        held += drift.filled(*values)
    held = ca.vertcat(*held, *_closed(scene))
    speeds = int(mech.u.size1())
    if scene.system.tau_is_state:
        return Inside(scene, ("q", "u", "tau"), speeds, ca.vertcat(mech.q_dot, u_dot, answer), held, tau)
    return Inside(scene, ("q", "u"), speeds, ca.vertcat(mech.q_dot, u_dot), held, tau)


def _prescribed(reached: Reached) -> Any:
    """Row by row (d/dt + 1)^r psi = 0, less psi^(r)."""
    rows = []
    for degree, rates in zip(reached.degrees, reached.rates, strict=True):
        rows.append(-sum(comb(degree, k) * value for k, value in enumerate(rates)))
    return ca.vertcat(*rows)


def _closed(scene: Scene) -> tuple[Any, ...]:
    """chi and chi' of passive constraints."""
    if not scene.mechanism.passive:
        return ()
    closure = closure_of(scene)
    return closure.chi, closure.chi_dot
