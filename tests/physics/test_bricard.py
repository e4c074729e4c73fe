"""Bricard's mechanism, whose passive constraints are redundant, now in these rows and now in those."""

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from scipy.integrate import solve_ivp
from servogen.compiler import derived_scene
from servogen.derive.formulation import MassFindings
from servogen.derive.passive import left_out
from servogen.derive.plant import derive_plant
from servogen.scene.domain import draw_states
from servogen.scene.samples import draw_samples
from support.bricard import GRAVITY, robot, scene


@pytest.fixture(scope="module")
def ring(tmp_path_factory: pytest.TempPathFactory) -> tuple[sg.urdf.Robot, sg.Scene]:
    built = robot(tmp_path_factory.mktemp("bricard"))
    return built, scene(built)


def test_energy_is_constant_over_ten_seconds(ring: tuple[sg.urdf.Robot, sg.Scene]) -> None:
    """Let go on the edges of the cube it falls through states where each fixed choice of rows would be singular."""
    built, bricard = ring
    mech = bricard.mechanism
    (_, u_dot), _ = derive_plant(bricard, MassFindings(symmetric=True, positive_definite=True, remarks=()))
    plant = ca.Function("plant", [mech.q, mech.u, mech.tau], [u_dot.expression])
    height = built.center_of_mass()[1]
    kinetic = ca.dot(mech.u, ca.mtimes(mech.Q, mech.u)) / 2
    energy = ca.Function("energy", [mech.q, mech.u], [kinetic, 5 * GRAVITY * height, mech.passive[0].chi])

    def rate(_: float, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[5:], np.array(plant(x[:5], x[5:], 0.0)).ravel()])

    run = solve_ivp(rate, (0, 10), np.zeros(10), "DOP853", rtol=1e-9, atol=1e-9)
    told = energy.map(run.y.shape[1])(run.y[:5], run.y[5:])
    moving, falling, chi = (np.array(x) for x in told)
    total = (moving + falling).ravel()
    assert run.t[-1] == 10
    assert np.max(moving) > 10  # it moves in earnest
    assert np.max(np.abs(total / total[0] - 1)) < 1e-6
    assert np.max(np.abs(chi)) < 1e-6


def test_against_the_textbook(ring: tuple[sg.urdf.Robot, sg.Scene]) -> None:
    """S, z and the multipliers of least norm, against a dense solve by least squares; and what is remarked."""
    _, bricard = ring
    (said,) = left_out(draw_samples(bricard))
    assert said.startswith("passive constraints 'hinge_6': of 5 rows 1 follow from the others at every state")
    formulation, fields = derived_scene(bricard)[0], bricard.input_fields()
    names = ("S", "z", "lam")
    ours = ca.Function("ours", [f.symbol for f in fields], [formulation[n] for n in names])
    textbook = sg.reference(bricard)
    drawn = draw_states(bricard, 5)
    for k in range(5):
        state = {n: v[k] for n, v in drawn.items()}
        for name, value in zip(names, ours.call([state[f.name] for f in fields]), strict=True):
            expected = np.asarray(getattr(textbook, name)(**state)).ravel()
            size = max(1.0, float(np.max(np.abs(expected))))
            np.testing.assert_allclose(np.array(value).ravel(), expected, rtol=0, atol=1e-9 * size, err_msg=name)
