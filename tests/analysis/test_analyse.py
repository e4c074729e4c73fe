"""What sg.analyse says, against closed forms, Markov parameters and the zeros of a matrix pencil."""

import json
import math
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from scipy.optimize import linear_sum_assignment
from servogen.cli.analyse import analyse_command
from support.high_degree import cars, cars_scene, crane, flexible_joint_arm, thetas
from support.linear_systems import random_linear


@pytest.mark.parametrize("seed", [*range(16), 1004, 1010, 1017, 1044])
def test_random_linear_mechanisms(seed: int) -> None:
    """Relative degrees, rank, invertibility, dimension and eigenvalues of what is left inside."""
    truth = random_linear(seed)
    found = sg.analyse(truth.scene)
    degrees = [truth.degree(k) for k in range(len(truth.K))]
    assert [own for (own,) in found.relative_degree.values()] == degrees
    if None in degrees:
        assert found.verdict == "unknown"
        assert "no control moves" in found.reason
        return
    assert found.rank == np.linalg.matrix_rank(truth.decoupling())
    assert (found.extension is not None) == truth.invertible()
    if not truth.invertible():
        assert "never independent" in found.reason
        return
    zeros = truth.zeros()
    assert found.internal_dimension == len(zeros)
    assert found.flat == (len(zeros) == 0)
    if not len(zeros):
        assert found.verdict == "none"
        return
    apart = np.abs(found.zero_dynamics[:, None] - zeros[None, :])
    assert apart[linear_sum_assignment(apart)].max() < 1e-6 * max(1.0, np.abs(zeros).max())
    worst = zeros.real.max()
    assert found.verdict == ("unstable" if worst > 1e-5 else "stable" if worst < -1e-5 else "marginal")


def segway(psi: Any) -> sg.Scene:
    """A wheeled pendulum: one torque between wheel and rod; psi(position, pitch) held."""
    par = sg.Parameters(M=1.0, m=5.0, L=0.4, r=0.1, g=9.81, J=0.3)
    q, u, tau = ca.vertcat(ca.SX.sym("position"), ca.SX.sym("pitch")), ca.SX.sym("u", 2), ca.SX.sym("tau")
    coupling = par.m * par.L * ca.cos(q[1])
    Q = ca.blockcat([[1.5 * par.M + par.m, coupling], [coupling, par.m * par.L**2 + par.J]])
    P = par.m * par.L * ca.sin(q[1]) * ca.vertcat(u[1] ** 2, par.g)
    mech = sg.Mechanism(q, u, tau, Q=Q, P=P, G=ca.vertcat(1 / par.r, -1))
    domain = {"q": ([-1.0, -0.5], [1.0, 0.5]), "u": (-1.0, 1.0)}
    return sg.Scene("segway", mech, [sg.Holonomic("held", psi(q), -2.0, -1.0)], parameters=par, domain=domain)


def test_a_wheel_that_is_held_lets_the_pitch_run_away() -> None:
    found = sg.analyse(segway(lambda q: q[0]))
    rate = math.sqrt(5 * 9.81 * 0.4 / (5 * 0.4**2 + 0.3 + 0.1 * 5 * 0.4))  # (m L^2 + J + r m L) a'' = m g L a
    np.testing.assert_allclose(found.zero_dynamics, [rate, -rate], rtol=1e-6)
    assert (found.verdict, found.internal_dimension, found.flat) == ("unstable", 2, False)
    assert "'held' held, pitch runs away from rest at +3.885 per second: prescribe pitch" in str(found)


def test_a_pitch_that_is_held_lets_the_wheel_roll_on() -> None:
    found = sg.analyse(segway(lambda q: q[1]))
    np.testing.assert_allclose(np.abs(found.zero_dynamics), 0, atol=1e-6)
    assert found.verdict == "marginal"
    assert "position neither decays nor grows" in found.meaning


def test_a_combination_that_is_held_brings_all_to_rest() -> None:
    """psi = position + c pitch: of second order still, and with c = 1 what is left is stable or a centre."""
    found = {c: sg.analyse(segway(lambda q, c=c: q[0] + c * q[1])) for c in (-0.6, -2.0)}
    for c, analysis in found.items():
        # position'' = -c a'': the wheel's row times r plus the rod's, linearised, without the torque
        inertia = -c * (0.1 * 6.5 + 5 * 0.4) + 0.1 * 5 * 0.4 + 5 * 0.4**2 + 0.3
        square = 5 * 9.81 * 0.4 / inertia
        np.testing.assert_allclose(analysis.zero_dynamics[0] ** 2, square, rtol=1e-6)
        assert analysis.verdict == ("unstable" if square > 0 else "marginal")


def test_cars_and_the_flexible_arm_are_flat() -> None:
    for count in (2, 3):
        scene = cars_scene(count, 2 * count)
        plain = sg.Scene("plain", scene.mechanism, [sg.Holonomic("first", scene.mechanism.q[0], -2.0, -1.0)])
        found = sg.analyse(plain)
        assert (found.relative_degree, found.flat) == ({"first": (2 * count,)}, True)
    arm = sg.analyse(flexible_joint_arm())
    assert (arm.relative_degree, arm.extension, arm.verdict) == ({"end": (4, 4)}, {}, "none")


def test_a_crane_needs_two_integrators() -> None:
    scene = crane()
    found = sg.analyse(scene)
    assert found.relative_degree == {"load": (2, 2)}
    assert (found.rank, found.extension, found.extended_degree) == (1, {"M": 2}, {"load": (4, 4)})
    assert found.exchanged == {"M": "constraint 'load', row 1"}  # both controls pull the rope
    assert (found.internal_dimension, found.flat, found.verdict) == (0, True, "none")
    with pytest.warns(sg.Remark, match=r"make constraint 'load', row 0 an sg.Output with Theta=\[T0, T1, T2, T3\]"):
        sg.build(scene, entry_points="S")


def test_thrust_gets_the_integrators_of_a_planar_rotorcraft() -> None:
    q, u, thrust, moment = ca.SX.sym("q", 3), ca.SX.sym("u", 3), ca.SX.sym("T"), ca.SX.sym("M")
    G = ca.vertcat(ca.horzcat(-ca.sin(q[2]), 0), ca.horzcat(ca.cos(q[2]), 0), ca.horzcat(0, 1))
    mech = sg.Mechanism(q, u, ca.vertcat(thrust, moment), Q=ca.DM.eye(3), P=[0, -9.81, 0], G=G)
    found = sg.analyse(sg.Scene("pvtol", mech, [sg.Holonomic("place", q[:2], -4.0, -4.0)]))
    assert (found.extension, found.exchanged, found.flat) == ({"T": 2}, {}, True)


def test_rows_that_say_the_same_are_never_independent() -> None:
    mech = cars(2)
    driven = sg.Mechanism(mech.q, mech.u, ca.SX.sym("F", 2), Q=mech.Q, P=mech.P, G=ca.DM.eye(2))
    q = mech.q
    twice = [sg.Holonomic("one", q[0], -2.0, -1.0), sg.Holonomic("two", 2 * q[0] + q[0] ** 2, -2.0, -1.0)]
    found = sg.analyse(sg.Scene("twice", driven, twice))
    assert (found.extension, found.verdict, found.internal_dimension) == (None, "unknown", None)
    assert "constraint 'one', constraint 'two' are never independent" in found.reason
    both = sg.analyse(sg.Scene("both", mech, [sg.Output("both", q, thetas(2, 1.0))]))
    assert "2 rows for 1 controls" in both.reason


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "pair.py").write_text(
        "import casadi as ca, servogen as sg\n"
        "q, u = ca.SX.sym('q', 2), ca.SX.sym('u', 2)\n"
        "mech = sg.Mechanism(q, u, ca.SX.sym('F'), Q=ca.DM.eye(2), P=ca.vertcat(0, q[1] - u[1]), G=[1, 1])\n"
        "scene = sg.Scene('pair', mech, [sg.Holonomic('first', q[0], -2, -1)])\n"
    )
    for option in ([], ["--json"]):
        with pytest.raises(SystemExit) as ended:
            analyse_command([str(tmp_path / "pair.py"), *option])
        assert ended.value.code == 1
    said = capsys.readouterr().out
    text, told = said[: said.index("{")], json.loads(said[said.index("{") :])
    root = (math.sqrt(5) - 1) / 2  # s^2 + s - 1
    assert f"verdict: unstable: with 'first' held, q_1 runs away from rest at +{root:.4g} per second" in text
    assert told["pair"]["zero_dynamics"][0] == pytest.approx([root, 0.0])
