"""The dynamic extension algorithm against an exact solution: an overhead crane along its path."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
from servogen.survey.extension import extend, reached_at
from support.high_degree import crane, crane_path

G, RADIUS = 9.81, 0.1


def along_the_path(times: Any) -> Any:
    """F and M by the extended scene: its law for psi^(4) = 0, and M from the row that took its place."""
    scene, t = crane(), ca.SX.sym("t")
    found = extend(scene)
    assert (dict(found.integrators), found.degrees) == ({"M": 2}, (4, 4))
    rates = [ca.vertcat(crane_path(t), 4 + crane_path(t))]
    for _ in range(4):
        rates.append(ca.jacobian(rates[-1], t))
    x, z = rates[0][0], rates[0][1]
    slope = -rates[2][0] / (G - rates[2][1])  # the rope pulls along the load's acceleration less gravity's
    angle = ca.atan(slope)
    q = ca.vertcat(x - z * slope, z / ca.cos(angle) / RADIUS, angle)
    # psi is zero all along, and so is what stands in M's place: the second derivative of psi's z row, and its rate
    state = ca.vertcat(q, ca.jacobian(q, t), 0, 0)
    mech, reached = found.scene.mechanism, found.reached
    assert reached is not None
    inputs = [f.symbol for f in scene.references]
    given = [(mech.q, state[:3]), (mech.u, state[3:]), *zip(inputs, rates, strict=True)]
    symbols, values = (ca.vertcat(*part) for part in zip(*given, strict=True))
    law = ca.solve(reached.S, -reached.drift)  # F and the second rate of what stands in M's place
    first = reached_at(scene, (2, 2))
    torque = -(first.drift[1] + first.S[1, 0] * law[0]) / first.S[1, 1]
    answer = ca.substitute(ca.densify(ca.vertcat(law[0], torque)), symbols, values)
    return np.array(ca.Function("answer", [t], [answer]).map(len(times))(np.array(times).reshape(1, -1))).T


def test_force_and_torque_of_the_crane() -> None:
    F, torque = along_the_path([1.5, 3.0]).T
    assert pytest.approx([25.264559, -0.252211], abs=6e-7) == F
    assert torque == pytest.approx([-95.571060, -98.080141], abs=6e-7)


def test_the_largest_force_of_the_crane() -> None:
    times = np.linspace(0.001, 5.999, 3001)
    F = along_the_path(times)[:, 0]
    assert F.max() == pytest.approx(36.0179, abs=6e-5)
    assert times[np.argmax(F)] == pytest.approx(2.05, abs=5e-3)
