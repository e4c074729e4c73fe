"""Through rest, where the rows vanish: torques stay finite, and the status says what was done."""

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.scenes.spacecraft import scene as spacecraft
from servogen.scenes.spacecraft import stabilisation
from servogen.simulate.closed_loop import ClosedLoop

SCALARS = ("float64", "float32")
TUMBLING = {"q": [0.0, 0.0, 0.0], "u": [0.1, -0.2, 0.15]}
LONG = {"duration": 2000.0, "step": 0.05}  # K falls by exp(-2000): its square of a speed is zero long before


def detumbling() -> sg.Scene:
    """Torques tau on a rigid body whose kinetic energy is to decay as exp(-t): S = omega^T."""
    inertia = ca.DM([10.0, 6.3, 8.5])
    angle, omega, tau = (ca.SX.sym(name, 3) for name in ("angle", "omega", "tau"))
    return sg.Scene(
        "detumbling",
        sg.Mechanism(
            q=angle, u=omega, tau=tau, Q=ca.diag(inertia), P=-ca.cross(omega, inertia * omega), G=ca.SX.eye(3)
        ),
        [sg.Nonholonomic("energy", ca.dot(inertia, omega**2) / 2, Theta=-1.0)],
        domain={"u": (-0.5, 0.5)},
    )


@pytest.mark.parametrize("scalar", SCALARS)
def test_a_body_is_detumbled_to_rest_and_stays_there(scalar):
    loop = ClosedLoop(detumbling(), scalar=scalar)
    run = loop.run(start=TUMBLING, **LONG)
    assert run.stop.reason == "finished"
    assert np.max(np.abs(run.u[-1])) < (1e-160 if scalar == "float64" else 1e-20)
    assert np.isfinite(run.tau).all()
    assert np.argmax(np.max(np.abs(run.tau), axis=1)) == 0  # never more torque than at the start
    assert set(run.status) == {sg.Status.OK}
    still = loop.run(start={**TUMBLING, "u": [0.0, 0.0, 0.0]}, duration=1.0, step=0.05)
    assert set(still.status) == {sg.Status.RANK_DEFICIENT_CONSISTENT}
    assert not np.any(still.tau)
    assert not np.any(still.u)


@pytest.mark.parametrize("scalar", SCALARS)
def test_the_papers_spacecraft_comes_to_rest_as_firmware_drives_it(scalar):
    """`step(dt)` each 50 ms, tau held in between."""
    loop = ClosedLoop(stabilisation("to_rest", smooth=True), scalar=scalar)
    start = {"q": [0.0, 0.0, 0.0], "u": [0.1, 0.1, 0.1], "tau": [0.1, 0.1, -0.3376]}
    run = loop.run(start=start, hold=True, **LONG)
    assert run.stop.reason == "finished"
    assert np.max(np.abs(run.u[-1])) < (1e-160 if scalar == "float64" else 1e-20)
    assert np.max(np.abs(run.tau)) < 0.34
    assert set(run.status) == {sg.Status.OK}


def test_from_rest_the_paper_s_phi_cannot_be_met_and_the_status_says_so():
    """At rest A = 0 and phi = 0 = K: with a torque applied phi' is not, for every tau'. One tick later all is well."""
    start = {"q": [0.0, 0.0, 0.0], "u": [0.0, 0.0, 0.0], "tau": [0.1, 0.1, -0.3376]}
    loop = ClosedLoop(stabilisation("from_rest", smooth=True))
    run = loop.run(start=start, duration=1.0, step=0.05, hold=True, project=False)
    assert run.status[0] == sg.Status.RANK_DEFICIENT_INCONSISTENT
    assert set(run.status[1:]) == {sg.Status.OK}
    assert np.max(np.abs(run.tau)) < 0.34


def test_control_at_rest_in_generated_code():
    """With a torque applied phi' needs tau' = B / |A|: none where A = 0, and beyond all numbers next to it."""
    code = sg.build(spacecraft).load()
    for speed, status in (
        (0.0, sg.Status.RANK_DEFICIENT_INCONSISTENT),
        (-0.0, sg.Status.RANK_DEFICIENT_INCONSISTENT),
        (5e-324, sg.Status.OVERFLOW),
        (1e-310, sg.Status.OVERFLOW),
        (1e-200, sg.Status.OK),
    ):
        answer = code.control(q=np.zeros(3), u=np.full(3, speed), tau=np.array([0.1, -0.2, 0.3]))
        assert answer.info.status == status
        if status == sg.Status.OK:
            assert 1e198 < np.max(np.abs(answer.value)) < 1e200
        elif status == sg.Status.RANK_DEFICIENT_INCONSISTENT:
            assert not np.any(answer.value)  # y = 0
