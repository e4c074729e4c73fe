"""The five-bar linkage of examples/: its motors move the end effector as asked, by a dense solve of its motion."""

from pathlib import Path

import casadi as ca
import numpy as np
import servogen as sg
from servogen.compiler import derived_scene
from servogen.loading import load_scene
from servogen.scene.domain import draw_states

FIVE_BAR = Path(__file__).parents[2] / "examples" / "five_bar.py"


def test_the_end_effector_moves_as_asked() -> None:
    scene = load_scene(str(FIVE_BAR))
    mech, (path,) = scene.mechanism, scene.constraints
    chi = mech.passive[0].chi
    tip, tip_dot = path.psi, ca.jtimes(path.psi, mech.q, mech.u)
    rates = [ca.jtimes(chi, mech.q, mech.u), tip_dot]
    given = [mech.Q, mech.P, tip, tip_dot, *(ca.jacobian(r, mech.u) for r in rates)]
    given += [ca.jtimes(r, mech.q, mech.u) for r in rates]
    fields = scene.input_fields()
    symbols = [*(f.symbol for f in fields), *(f.symbol for f in scene.parameters)]
    function = ca.Function("given", symbols, given)
    formulation = derived_scene(scene)[0]
    ours = ca.Function("ours", symbols, [formulation["S"], formulation["z"]])
    textbook = sg.reference(scene)
    drawn, defaults = draw_states(scene, 4), [f.default for f in scene.parameters]
    for k in range(4):
        state = {n: v[k] for n, v in drawn.items()}
        numbers = [*(state[f.name] for f in fields), *defaults]
        Q, P, psi, moving, J, K, j, drift = (np.array(x) for x in function(*numbers))
        S, z = (np.array(x) for x in ours(*numbers))
        tau = np.linalg.solve(S, z)
        force = P + np.array(ca.DM(mech.G)) @ tau
        u_dot = np.linalg.solve(np.block([[Q, -J.T], [J, np.zeros((2, 2))]]), np.vstack([force, -j]))[:4]
        asked = state["place_ddot"][:, None] - 20.0 * (moving - state["place_dot"][:, None]) - 100.0 * psi
        np.testing.assert_allclose(K @ u_dot + drift, asked, rtol=0, atol=1e-9 * np.max(np.abs(asked)))
        answer = textbook.control(**state)
        np.testing.assert_allclose(answer.value, tau.ravel(), rtol=0, atol=1e-9 * np.max(np.abs(tau)))
