"""The bicycle of examples/ linearised about upright rolling: the matrices of Meijaard et al. (2007)."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import servogen as sg
from servogen.derive.formulation import MassFindings
from servogen.derive.plant import derive_plant
from servogen.loading import load_scene

BICYCLE = Path(__file__).parents[2] / "examples" / "whipple_bicycle.py"
GRAVITY, REAR_RADIUS = 9.81, 0.3
MOVED = ("lean", "steer")

# Published: M q'' + v C1 q' + (g K0 + v^2 K2) q = torques, q lean and steer, v the forward speed.
M = np.array([[80.81722, 2.31941332208709], [2.31941332208709, 0.29784188199686]])
K0 = np.array([[-80.95, -2.59951685249872], [-2.59951685249872, -0.80329488458618]])
K2 = np.array([[0, 76.59734589573222], [0, 2.65431523794604]])
C1 = np.array([[0, 33.86641391492494], [-0.85035641456978, 1.68540397397560]])


def linearised(scene: sg.Scene) -> Any:
    """v -> u' of lean and steer under unit torques on them, and its slopes in lean, steer and their rates.

    The other rates follow from those and the speed by the passive constraints; the other places do not change to first
    order, by symmetry.
    """
    mech = scene.mechanism
    names = [s.name() for s in mech.q.nonzeros()]
    at = [names.index(n) for n in MOVED]
    free = [*at, names.index("rear_spin")]
    bound = [k for k in range(len(names)) if k not in free]
    rates = [ca.jtimes(c.chi, mech.q, mech.u) if isinstance(c, sg.PassiveHolonomic) else c.chi for c in mech.passive]
    J = ca.jacobian(ca.vertcat(*rates), mech.u)
    given = ca.SX.sym("rates", 3)
    u = ca.SX.zeros(len(names))
    u[free] = given
    u[bound] = ca.solve(J[:, bound], -ca.mtimes(J[:, free], given))
    draw: Any = scene.domain
    torques = replace(mech, tau=ca.SX.sym("torques", 2), G=np.eye(len(names))[:, at])
    pushed = sg.Scene(
        "pushed", torques, [sg.Nonholonomic("lean", mech.u[at[0]], Theta=-1)],
        domain=lambda g: {n: v for n, v in draw(g).items() if n in "qu"},
    )  # fmt: skip
    (_, u_dot), _ = derive_plant(pushed, MassFindings(symmetric=True, positive_definite=True, remarks=()))
    plant = ca.Function("plant", [mech.q, mech.u, torques.tau], [u_dot.expression[at]])
    places = ca.SX.sym("places", 2)
    q = ca.SX.zeros(len(names))
    q[at] = places
    moving = ca.Function("moving", [mech.q, given], [u])(q, given)
    answer = plant(q, moving, torques.tau)
    slopes = ca.Function(
        "slopes", [places, given, torques.tau],
        [ca.jacobian(answer, x) for x in (torques.tau, places, given[:2])],
    )  # fmt: skip
    return lambda v: [np.array(x) for x in slopes(np.zeros(2), [0, 0, -v / REAR_RADIUS], np.zeros(2))]


def test_the_published_matrices() -> None:
    slopes = linearised(load_scene(str(BICYCLE)))
    gain, standing, damping = slopes(0.0)
    ours = np.linalg.inv(gain)
    np.testing.assert_allclose(ours, M, rtol=0, atol=1e-8)
    np.testing.assert_allclose(-ours @ standing / GRAVITY, K0, rtol=0, atol=1e-8)
    np.testing.assert_allclose(ours @ damping, 0, rtol=0, atol=1e-8)
    for v in (1.0, 4.6):
        _, rolling, damping = slopes(v)
        np.testing.assert_allclose(-ours @ damping / v, C1, rtol=0, atol=1e-8)
        np.testing.assert_allclose((-ours @ rolling - GRAVITY * K0) / v**2, K2, rtol=0, atol=1e-8)
