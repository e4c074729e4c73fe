"""Scenes whose controls have limits: both twins against exact rationals, the bits of those that no limit touches."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen import exact
from servogen.scalars import EPSILON
from servogen.scene.domain import draw_states
from servogen.scenes import skewed_thrusters
from servogen.simulate.closed_loop import simulate
from servogen.verify import check as check_module
from servogen.verify.check import check
from servogen.verify.exact_steps import admissible

WEIGHT = ca.DM([[2, 0.5, 0, 0], [0.5, 1, 0, 0], [0, 0, 3, 0.1], [0, 0, 0.1, 1]])
Y = [0.1, 0.0, 0.2, 0.0]


def arm(limits=None, **more) -> sg.Scene:
    """Two rows on four controls of three speeds; limits may be a function of parameters and u."""
    par = sg.Parameters(most=sg.Parameter(2.0, "N m", "stall torque"))
    q, u, tau = ca.SX.sym("q", 3), ca.SX.sym("u", 3), ca.SX.sym("tau", 4)
    Q = ca.diagcat(par.most + ca.cos(q[1]), 1.5, 1.0)
    Q[0, 1] = Q[1, 0] = 0.3 * ca.cos(q[0])
    return sg.Scene(
        "limited_arm",
        sg.Mechanism(
            q=q, u=u, tau=tau, Q=Q, P=ca.vertcat(-0.2 * u[0], ca.sin(q[1]), 0),
            G=[[1, 0.5, 0, 0.3], [0, 1, -0.5, 0.2], [0.2, 0, 1, -1]],
        ),
        [
            sg.Nonholonomic("a", u[0] * u[1] + u[0] - 0.3, Theta=-2.0),
            sg.Nonholonomic("b", u[2] - ca.sin(q[0]), Theta=-1.0),
        ],
        parameters=par,
        domain={"q": (-2, 2), "u": (-2, 2)},
        limits=limits(par, u) if callable(limits) else limits,
        **more,
    )  # fmt: skip


def curve(par, u) -> sg.Limits:
    """A torque-speed curve, thrusters that only push, and no limit."""
    return sg.Limits([-par.most, 0, -1, -np.inf], [par.most - 0.3 * u[0], np.inf, 1.0, 0.5])


LOWER, UPPER = [-1.0, -np.inf, -0.5, -1.0], [1.0, 0.5, np.inf, 1.0]
VARIANTS = {
    "curve": (curve, {}),
    "inputs, weighed": (sg.Limits("input", "input"), {"weight": WEIGHT, "y": ca.SX(ca.DM(Y))}),
    "slowed": (sg.Limits(-1.0, 1.0, "keep_direction"), {}),
    "slowed, weighed": (sg.Limits(-1.0, 1.0, "keep_direction"), {"weight": WEIGHT, "y": "input"}),
}


def sides(name: str, u) -> tuple[np.ndarray, np.ndarray]:
    if name == "curve":
        return np.array([-2, 0, -1, -np.inf]), np.array([2.0 - 0.3 * u[0], np.inf, 1.0, 0.5])
    if name.startswith("inputs"):
        return np.array(LOWER), np.array(UPPER)
    return np.full(4, -1.0), np.full(4, 1.0)


@pytest.mark.parametrize("scalar", ["float64", "float32"])
@pytest.mark.parametrize("name", VARIANTS)
def test_the_best_within_the_limits(name: str, scalar: str) -> None:
    """Generated code and reference against the exact optimum of the code's own S and z; slowed by exactly s."""
    limits, more = VARIANTS[name]
    scene = arm(limits, **more)
    twin, reference = sg.build(scene, scalar=scalar).load(), sg.reference(scene, scalar)
    rng, real, close = np.random.default_rng(5), np.dtype(scalar).type, 200 * EPSILON[scalar]
    said, slowed = set(), 0
    for _ in range(40):
        state = {n: rng.uniform(-2, 2, 3).astype(real) for n in ("q", "u")}
        given = dict(state)
        given |= {"tau_min": LOWER, "tau_max": UPPER} if name.startswith("inputs") else {}
        given |= {"y": Y} if more.get("y") == "input" else {}
        S, z = twin.S(**state).astype(float), twin.z(**state).astype(float)
        u, q = state["u"].astype(float), state["q"].astype(float)
        z_1 = np.array([-2 * (u[0] * u[1] + u[0] - 0.3), -(u[2] - np.sin(q[0]))])
        lower, upper = sides(name, u)
        answer, other = twin.control(**given), reference.control(**given)
        tau, info = answer.value.astype(float), answer.info
        assert np.all((lower.astype(real) <= answer.value) & (answer.value <= upper.astype(real))), "beyond a limit"
        metric = np.linalg.cholesky(np.array(WEIGHT)).T if "weight" in more else None
        wish = np.array(Y) if "y" in more else np.zeros(4)
        best = admissible(S, z, wish, lower, upper, z_1 if name.startswith("slowed") else None, metric)
        truth = exact.nearest(best.x)[:, 0]
        size = 1 + np.max(np.abs(z)) + np.max(np.abs(truth))
        assert np.allclose(tau, truth, rtol=0, atol=close * size)
        assert np.allclose(other.value, truth, rtol=0, atol=close * size)
        assert other.info.status == info.status
        assert other.info.active == info.active
        assert np.isclose(other.info.scale, info.scale, rtol=0, atol=close * size)
        assert (info.status == sg.Status.LIMITED_INCONSISTENT) == (np.linalg.norm(exact.nearest(best.rest)) > 1e-3)
        said.add(info.status)
        if name.startswith("slowed") and info.status == sg.Status.LIMITED and info.scale < 1:
            slowed += 1
            assert np.allclose(S @ tau, z - z_1 + info.scale * z_1, rtol=0, atol=close * size)
    assert sg.Status.OK in said
    assert sg.Status.LIMITED in said
    assert slowed > 10 or not name.startswith("slowed")


@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_limits_that_are_not_met_change_no_bit(scalar: str) -> None:
    """Also where the matrix is known and its inverse at hand, and one by one as in a batch."""
    thrusters = skewed_thrusters.scene
    weighed = arm(weight=WEIGHT), arm(sg.Limits(-np.inf, 1e4, "keep_direction"), weight=WEIGHT)
    known = thrusters, replace(thrusters, limits=sg.Limits(-1e4, 1e4))
    for plain, wide in [known, (arm(), arm(sg.Limits(-1e4, 1e4)))] if scalar == "float64" else [weighed]:
        drawn = {n: v[:40] for n, v in draw_states(plain, 40).items()}
        without = sg.build(plain, scalar=scalar).load().control_batch(**drawn)
        within = (twin := sg.build(wide, scalar=scalar).load()).control_batch(**drawn)
        assert within.value.tobytes() == without.value.tobytes()
        assert np.array_equal(within.status, without.status)
        assert np.all(within.scale == 1)
        assert not np.any(within.active)
        one = twin.control(**{n: v[3] for n, v in drawn.items()})
        assert one.value.tobytes() == within[3].value.tobytes()
        assert one.info == within[3].info


def test_a_scene_with_limits_passes_its_check() -> None:
    """Every entry point, boundary states (crossed, NaN and infinite limits among them), both scalars and compilers."""
    limits, more = sg.Limits("input", [np.inf, 1.0, 0.5, 1.0], "keep_direction"), {"weight": WEIGHT}
    report = check([arm(limits, **more)], states=4)
    assert report.passed, report.problems


def test_a_control_that_rounding_alone_connects_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    """At q = pi/2 the first control's entry of S is cos(pi/2) = 6e-17, whose limit the exact optimum would go to."""
    q, u, tau = ca.SX.sym("q"), ca.SX.sym("u"), ca.SX.sym("tau", 2)
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=1, P=9.0 * ca.sin(q), G=ca.horzcat(ca.cos(q), -2.5))
    held = [sg.Nonholonomic("rate", u, Theta=-4.0)]
    scene = sg.Scene("quarter", mech, held, limits=sg.Limits([-20, -1], [20, 1], "keep_direction"))
    monkeypatch.setattr(check_module, "HOST_COMPILERS", ("gcc",))  # it is about the truth
    report = check([scene], states=2)
    assert report.passed, report.problems


def test_thrusters_only_push() -> None:
    """A closed loop with limits active all the way: no control is negative by one bit, and the verdict tells."""
    limited = replace(skewed_thrusters.scene, name="pushing", limits=sg.Limits(0.0, np.inf))
    run = simulate(limited, replace(skewed_thrusters.simulation, duration=1.0))
    assert np.all(run.tau >= 0)
    assert np.any(run.tau == 0)
    assert np.all(np.isin(run.status, (sg.Status.OK, sg.Status.LIMITED, sg.Status.LIMITED_INCONSISTENT)))
    assert run.verdict.word == "limited"
    assert "the scene's limits held tau[1]" in run.verdict.reason


@pytest.mark.parametrize(
    ("limits", "told"),
    [
        (lambda p, u: sg.Limits(1, 0), r"lower 1 of tau\[0\] is above upper 0"),
        (lambda p, u: sg.Limits([0, 0], 1), "lower has 2 entries; give one number, or one for each of 4 controls"),
        (lambda p, u: sg.Limits([[0, 1], [2, 3]], 9), "lower has shape 2x2"),
        (lambda p, u: sg.Limits([0, np.nan, 0, 0], 1), r"lower of tau\[1\] is nan"),
        (lambda p, u: sg.Limits(0, -np.inf), r"upper of tau\[0\] is -inf; give a finite number, SX, or inf for no"),
        (lambda p, u: sg.Limits("tau_max", 1), "'input' for the input tau_min"),
        (lambda p, u: sg.Limits(None, 1), "lower is None"),
        (lambda p, u: sg.Limits(-ca.SX.sym("most"), 1), "lower holds the symbol 'most', which is not an input"),
        (lambda p, u: sg.Limits(0, 1, "clip"), "choose 'least_squares' or 'keep_direction'"),
        (lambda p, u: (0, 1), r"limits is a tuple; give sg.Limits\(lower, upper\)"),
    ],
)
def test_limits_that_make_no_sense(limits, told: str) -> None:
    with pytest.raises(sg.SceneError, match=told):
        arm(limits)


def test_what_limits_do_not_go_with() -> None:
    tau = ca.SX.sym("tau")
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    body = sg.Mechanism(q=x, u=v, tau=tau, Q=1, P=0, G=1)
    row = [sg.Nonholonomic("v", v, Theta=-1)]
    ends = sg.Limits(-1, 1)
    with pytest.raises(sg.SceneError, match="limits are for servo scenes"):
        sg.Scene("s", body, row, mode="ideal", limits=ends)
    with pytest.raises(sg.SceneError, match="this one's is tau', the rate of the controls"):
        sg.Scene("s", body, [sg.ControlsInvolved("c", tau - x, Theta=-1)], limits=ends)
    with pytest.raises(sg.SceneError, match="limits: upper depends on tau"):
        sg.Scene("s", body, row, limits=sg.Limits(-1, tau))
    with pytest.raises(sg.SceneError, match="brings the input tau_min, but a parameter or reference has that name"):
        sg.Scene("s", body, row, parameters=sg.Parameters(tau_min=1.0), limits=sg.Limits("input", 1))
    with pytest.raises(sg.SceneError, match="leave out damping"):
        sg.Scene("s", body, row, solver=sg.Solver(damping=0.1), limits=ends)
    scene = sg.Scene("s", body, row, limits=sg.Limits("input", 1))
    with pytest.raises(sg.SceneError, match="leave out core"):
        sg.build(scene, core="servogen_core")
    with pytest.raises(TypeError, match=r"tau_min .*left out"):
        sg.reference(scene).control(q=0, u=0)
    crossed = sg.reference(scene).control(q=0, u=0.5, tau_min=2, last=[7])
    assert crossed.info.status == sg.Status.LIMITS_CROSSED
    assert crossed.value == 7
