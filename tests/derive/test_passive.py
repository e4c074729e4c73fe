"""Passive constraints: S, z and lam against a dense solve to 50 digits, Gauss's principle, statuses, errors."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from hypothesis import given, settings
from hypothesis import strategies as st
from servogen.compiler import derived_scene
from servogen.scene.domain import draw_states
from servogen.simulate.claim import claim_of
from servogen.simulate.spread import draw
from support.loops import exact_motion, random_mechanism


def scene_of(mech: sg.Mechanism) -> sg.Scene:
    psi = ca.vertcat(mech.q[0] + ca.sin(mech.q[1]), mech.q[2] * mech.q[1])
    domain = {"q": (-1.5, 1.5), "u": (-1.0, 1.0)}
    return sg.Scene("joined", mech, [sg.Holonomic("psi", psi, Theta1=-2.0, Theta2=-3.0)], domain=domain)


def values(scene: sg.Scene, *names: str) -> Any:
    formulation, fields = derived_scene(scene)[0], scene.input_fields()
    function = ca.Function("f", [f.symbol for f in fields], [formulation[n] for n in names])
    return lambda state: [np.array(x) for x in function.call([state[f.name] for f in fields])]


@settings(max_examples=6, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.sampled_from([(4, 1, 0), (5, 1, 1), (5, 0, 2), (6, 2, 1)]),
    redundant=st.booleans(),
)
def test_against_a_dense_solve_to_50_digits(seed: int, shape: tuple[int, int, int], redundant: bool) -> None:
    scene = scene_of(random_mechanism(seed, *shape, redundant=redundant and shape[1] > 0))
    ours, textbook = values(scene, "S", "z", "lam", "closure"), sg.reference(scene)
    drawn = draw_states(scene, 2)
    for k in range(2):
        state = {n: v[k] for n, v in drawn.items()}
        *found, closure = ours(state)
        assert np.max(np.abs(closure)) < 1e-9  # states are drawn on the constraints
        for name, value, exact in zip(("S", "z", "lam"), found, exact_motion(scene, state), strict=True):
            expected = np.array(exact.tolist(), dtype=float)
            scale = max(1.0, np.max(np.abs(expected)))
            np.testing.assert_allclose(value, expected, rtol=0, atol=1e-10 * scale, err_msg=name)
            other = np.asarray(getattr(textbook, name)(**state)).reshape(expected.shape)
            np.testing.assert_allclose(other, expected, rtol=0, atol=1e-8 * scale, err_msg=f"reference {name}")


def test_gauss_principle() -> None:
    """Of all u' with J u' + j = 0, the motion is the one nearest to the free one in the metric of Q."""
    scene = scene_of(random_mechanism(5, 5, 1, 1, False))
    mech = scene.mechanism
    state = {n: v[0] for n, v in draw_states(scene, 1).items()}
    rate = ca.vertcat(ca.jtimes(mech.passive[0].chi, mech.q, mech.u), mech.passive[1].chi)
    J, Q, f = ca.jacobian(rate, mech.u), mech.Q, mech.P + ca.mtimes(mech.G, mech.tau)
    function = ca.Function("f", [mech.q, mech.u, mech.tau], [J, ca.jtimes(rate, mech.q, mech.u), Q, f])
    J, j, Q, f = (np.array(x) for x in function(state["q"], state["u"], state["tau"]))
    lam = values(scene, "lam")(state)[0]
    u_dot = np.linalg.solve(Q, f + J.T @ lam)
    np.testing.assert_allclose(J @ u_dot + j, 0, atol=1e-12)
    free = np.linalg.solve(Q, f)
    tangent = np.linalg.svd(J)[2][len(J) :].T
    np.testing.assert_allclose(tangent.T @ Q @ (u_dot - free), 0, atol=1e-12)


def test_controls_that_are_involved_see_the_loop() -> None:
    """A tau' = B with u' under tau and the loop's forces: against u' of a dense solve."""
    mech = random_mechanism(7, 5, 1, 1, False)
    phi = mech.tau[:2] * (1 + mech.q[:2] ** 2 / 4) + mech.u[:2] * mech.q[2] - ca.sin(mech.q[1:3])
    domain = {"q": (-1.0, 1.0), "u": (-1.0, 1.0), "tau": (-2.0, 2.0)}
    scene = sg.Scene("pushed", mech, [sg.ControlsInvolved("law", phi, Theta=-3.0)], domain=domain)
    rate = ca.vertcat(ca.jtimes(mech.passive[0].chi, mech.q, mech.u), mech.passive[1].chi)
    given = [mech.Q, mech.P + ca.mtimes(mech.G, mech.tau), ca.jacobian(rate, mech.u), ca.jtimes(rate, mech.q, mech.u)]
    given += [phi, ca.jtimes(phi, mech.q, mech.u), ca.jacobian(phi, mech.u), ca.jacobian(phi, mech.tau)]
    function = ca.Function("given", [mech.q, mech.u, mech.tau], given)
    ours, textbook, drawn = values(scene, "A", "B"), sg.reference(scene), draw_states(scene, 3)
    for k in range(3):
        state = {n: v[k] for n, v in drawn.items()}
        Q, force, J, j, phi_now, moving, slope, A = (
            np.array(x) for x in function(*(state[n] for n in ("q", "u", "tau")))
        )
        kkt = np.block([[Q, -J.T], [J, np.zeros((len(J), len(J)))]])
        u_dot = np.linalg.solve(kkt, np.vstack([force, -j]))[: len(Q)]
        B = -3.0 * phi_now - moving - slope @ u_dot
        for found in (ours(state), (textbook.A(**state), textbook.B(**state))):
            np.testing.assert_allclose(found[0], A, rtol=0, atol=1e-12)
            np.testing.assert_allclose(np.ravel(found[1]), B.ravel(), rtol=0, atol=1e-10 * max(1, np.max(np.abs(B))))


def two_bars(**more: Any) -> dict[str, Any]:
    """A slider-crank with a crank as long as its rod: at q = 0 both lie in a line, and J of the slider's guide is 0."""
    q, u, tau = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau", 2)
    guide = sg.PassiveHolonomic("guide", ca.sin(q[0]) + ca.sin(q[1]) - 1)
    Q = ca.vertcat(ca.horzcat(2, ca.cos(q[0] - q[1])), ca.horzcat(ca.cos(q[0] - q[1]), 1.5))
    return {"q": q, "u": u, "tau": tau, "Q": Q, "P": -ca.sin(q), "G": np.eye(2), "passive": [guide]} | more


def test_a_dead_centre_is_refused_by_both_twins() -> None:
    mech = sg.Mechanism(**two_bars())
    domain = {"q": ([-1.0, -1.0], [1.4, 1.4]), "u": (-1, 1)}
    scene = sg.Scene("crank", mech, [sg.Holonomic("x", mech.q[0], Theta1=-1.0, Theta2=-1.0)], domain=domain)
    twins = sg.build(scene).load(), sg.reference(scene)
    for twin in twins:
        answer = twin.control(q=[np.pi / 2, np.pi / 2], u=[0, 0], last=[7.0, 8.0])
        assert answer.info.status == sg.Status.DEAD_CENTRE
        assert list(answer.value) == [7.0, 8.0]
        good = twin.control(q=[0.3, np.arcsin(1 - np.sin(0.3))], u=[0, 0])
        assert good.info.status == sg.Status.OK
        assert twin.closure(q=[0.3, 0.2], u=[1.0, 2.0]).shape == (2,)
        assert np.isnan(twin.lam(q=[np.pi / 2, np.pi / 2], u=[0, 0])).all()
    assert next(twin.closure(q=[0.3, 0.2], u=[1.0, 2.0]).tolist() for twin in twins) == pytest.approx(
        [np.sin(0.3) + np.sin(0.2) - 1, np.cos(0.3) + 2 * np.cos(0.2)], abs=1e-15
    )


WRONG = [
    (lambda q, u, tau: [sg.PassiveHolonomic("a", q[0] + u[0])], ("'a'", "PassiveNonholonomic")),
    (lambda q, u, tau: [sg.PassiveNonholonomic("a", q[0])], ("'a'", "PassiveHolonomic")),
    (lambda q, u, tau: [sg.PassiveNonholonomic("a", u[0] ** 2)], ("'a'", "not affine in u")),
    (lambda q, u, tau: [sg.PassiveHolonomic("a", q[0] + tau[0])], ("'a'", "depends on tau")),
    (lambda q, u, tau: [sg.PassiveHolonomic("a", q[0]), sg.PassiveHolonomic("a", q[1])], ("'a'", "rename one")),
    (lambda q, u, tau: [sg.PassiveHolonomic("a", ca.vertcat(q[0], ca.SX.sym("r") - 1))], ("'a'", "row 2", "on q")),
    (lambda q, u, tau: [q[0]], ("sg.PassiveHolonomic", "list")),
    (lambda q, u, tau: [sg.PassiveHolonomic("a", q[0], stabilise=-1.0)], ("'a'", "stabilise", "-1.0")),
    (lambda q, u, tau: [sg.PassiveHolonomic("a b", q[0])], ("'a b'", "identifier")),
]


@pytest.mark.parametrize(("passive", "words"), WRONG)
def test_wrong_passive_constraints(passive: Any, words: tuple[str, ...]) -> None:
    given = two_bars()
    with pytest.raises(sg.SceneError) as raised:
        sg.Mechanism(**given | {"passive": passive(given["q"], given["u"], given["tau"])})
    for word in words:
        assert word in str(raised.value)


def test_what_passive_constraints_may_be_made_of() -> None:
    ref, given = sg.References(r=1.0), two_bars()
    q, u = given["q"], given["u"]
    for wrong, words in (
        (sg.PassiveHolonomic("a", q[0] - ref.r), "passive constraint 'a': chi holds 'r', which is neither state"),
        (sg.PassiveHolonomic("a", q[0], stabilise=q[1]), "'a': stabilise holds 'q_1', which is not a parameter"),
        (sg.PassiveNonholonomic("a", u[0], stabilise=ref.r), "'a': stabilise holds 'r', which is not a parameter"),
    ):
        mech = sg.Mechanism(**given | {"passive": [wrong]})
        with pytest.raises(sg.SceneError, match=words):
            sg.Scene("crank", mech, [sg.Holonomic("x", q[1], Theta1=-1.0, Theta2=-1.0)], references=ref)


def test_a_coordinate_by_which_only_chi_tells_places_apart_is_no_angle() -> None:
    q, u, tau = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau")
    screw = sg.PassiveHolonomic("screw", q[0] - 3 * q[1])
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=ca.DM.eye(2), P=ca.vertcat(0, ca.sin(q[1])), G=[1, 0], passive=[screw])
    scene = sg.Scene("screw", mech, [sg.Nonholonomic("v", u[0], Theta=-1.0)], domain={"q": (-1, 1)})
    assert not np.any(claim_of(scene, sg.Simulation(), {}).angle)


def test_a_draw_that_cannot_be_closed_is_named() -> None:
    par, given = sg.Parameters(r=0.8), two_bars()
    mech = sg.Mechanism(**given | {"passive": [sg.PassiveHolonomic("ring", ca.sin(given["q"][0]) - par.r)]})
    scene = sg.Scene("crank", mech, [sg.Holonomic("x", given["q"][1], Theta1=-1.0, Theta2=-1.0)], parameters=par)
    plant, start = {"r": np.array([0.8])}, {"q": np.array([0.9, 0.0]), "u": np.zeros(2), "tau": np.zeros(2)}
    drawn = draw(scene, {"r": 0.1}, np.arange(4), plant, start).arrays
    np.testing.assert_allclose(np.sin(drawn["q"][:, 0]), drawn["plant"][:, 0], rtol=0, atol=1e-12)
    alone = draw(scene, {"r": 0.1}, np.array([2]), plant, start).arrays
    np.testing.assert_allclose(alone["q"][0], drawn["q"][2], rtol=0, atol=1e-15)
    with pytest.raises(sg.SceneError, match=r"spread: the run of seed \d+ starts from r = 1\.\d+, where no q and u"):
        draw(scene, {"r": 0.5}, np.arange(8), plant, start)


def test_rows_that_others_make_up() -> None:
    """Left out with a remark where the others make them up whatever the parameters are, refused where by accident."""
    q, u, tau = ca.SX.sym("q", 3), ca.SX.sym("u", 3), ca.SX.sym("tau")
    par = sg.Parameters(a=1.0, b=1.0)
    first = par.a * q[0] - par.b * q[1]

    def scene(*rows: Any) -> sg.Scene:
        chi = sg.PassiveHolonomic("joint", ca.vertcat(*rows))
        mech = sg.Mechanism(q=q, u=u, tau=tau, Q=ca.DM.eye(3), P=-q, G=[1, 0, 0], passive=[chi])
        return sg.Scene("rows", mech, [sg.Nonholonomic("v", u[0], Theta=-1.0)], parameters=par)

    (told,) = derived_scene(scene(first, 2 * first))[0].remarks
    assert told.startswith("scene 'rows': passive constraint 'joint': row 2 of chi is left out")
    words = "'joint': row 2 of chi depends on the other passive constraints at the parameters' defaults, but not"
    with pytest.raises(sg.SceneError, match=words):
        derived_scene(scene(q[0] - q[1], first))


def test_errors_of_scenes_with_passive_constraints() -> None:
    mech = sg.Mechanism(**two_bars())
    psi = [sg.Holonomic("x", mech.q[0], Theta1=-1.0, Theta2=-1.0)]
    with pytest.raises(sg.SceneError, match="mode='ideal' is not supported with passive constraints"):
        sg.Scene("crank", mech, psi, mode="ideal")
    with pytest.raises(sg.SceneError, match="hardly a state drawn from it can be closed"):
        sg.reference(sg.Scene("crank", mech, psi, domain={"q": (-1, -0.5), "u": (-1, 1)})).control(q=[0, 0], u=[0, 0])
    lopsided = sg.Mechanism(**two_bars(Q=ca.DM([[2, 0.1], [0.3, 1]])))
    scene = sg.Scene("crank", lopsided, [sg.Holonomic("x", lopsided.q[0], Theta1=-1.0, Theta2=-1.0)])
    with pytest.raises(sg.SceneError, match="passive constraints need a Q that is symmetric"):
        derived_scene(scene)
