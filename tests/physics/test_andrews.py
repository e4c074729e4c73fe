"""Andrews' squeezing mechanism: published accelerations, multipliers and motion."""

import casadi as ca
import numpy as np
import servogen as sg
from scipy.integrate import solve_ivp
from servogen.compiler import derived_scene
from servogen.derive.formulation import MassFindings
from servogen.derive.plant import derive_plant
from support.andrews import ACCELERATIONS, END, MULTIPLIERS, START, TORQUE, scene


def test_inverse_and_multipliers() -> None:
    """Asked for the published beta'' the answer is the published torque, with the published multipliers."""
    squeezer = scene()
    formulation, fields = derived_scene(squeezer)[0], squeezer.input_fields()
    function = ca.Function("f", [f.symbol for f in fields], [formulation[n] for n in ("S", "z", "lam", "closure")])
    reference = sg.reference(squeezer)
    state = {"q": START, "u": [0.0] * 7, "speed": [0.0], "speed_dot": [ACCELERATIONS[0]], "tau": [TORQUE]}
    S, z, lam, closure = (np.array(x).ravel() for x in function(*(ca.DM(state[f.name]) for f in fields)))
    assert np.max(np.abs(closure)) < 1e-15
    assert abs(z[0] / S[0] - TORQUE) < 1e-10
    scale = MULTIPLIERS[0]
    np.testing.assert_allclose(lam, -np.array(MULTIPLIERS), rtol=0, atol=1e-9 * scale)
    assert abs(reference.control(**state).value[0] - TORQUE) < 1e-10
    np.testing.assert_allclose(reference.lam(**state), -np.array(MULTIPLIERS), rtol=0, atol=1e-9 * scale)


def test_forward_motion() -> None:
    """Under the published torque: accelerations at the start, and the state at 0.03 s."""
    squeezer = scene()
    (_, u_dot), _ = derive_plant(squeezer, MassFindings(symmetric=True, positive_definite=True, remarks=()))
    mech = squeezer.mechanism
    plant = ca.Function("f", [mech.q, mech.u, mech.tau], [u_dot.expression])
    first = np.array(plant(START, np.zeros(7), TORQUE)).ravel()
    np.testing.assert_allclose(first[:2], ACCELERATIONS, rtol=1e-11)

    def rate(_: float, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[7:], np.array(plant(x[:7], x[7:], TORQUE)).ravel()])

    run = solve_ivp(rate, (0, 0.03), [*START, *np.zeros(7)], "DOP853", rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(run.y[:7, -1], END, rtol=0, atol=1e-6)
