"""Remarks: what is odd about a scene and no error, said at the line that builds it, and again by the next build."""

import warnings
from typing import Any

import casadi as ca
import pytest
import servogen as sg
from servogen.scene.review import review

q, u, tau = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau", 2)
par = sg.Parameters(a=1.0, k=[1.0, 2.0], zero=0.0)


def scene(*constraints: Any, uses: Any = 0.0, P: Any = None, l: int = 2, **more: Any) -> sg.Scene:
    """uses: SX that y holds, so that nothing of it is unused."""
    P = ca.DM.zeros(2) if P is None else P
    mech = sg.Mechanism(q=q, u=u, tau=tau[:l], Q=ca.DM.eye(2), P=P, G=ca.DM.ones(2, l) + ca.DM.eye(2)[:, :l])
    y = ca.SX.ones(l) * ca.sum1(ca.SX(uses))
    return sg.Scene("odd", mech, constraints or [sg.Nonholonomic("speed", u[0], -1.0)], y=y, **more)


def test_theta_of_parameters_is_judged_at_their_defaults() -> None:
    def told(*constraints: Any) -> tuple[str, ...]:
        return review(scene(*constraints, uses=ca.vertcat(par.a, par.k, par.zero), parameters=par))

    (unstable,) = told(sg.Nonholonomic("speed", u[0], par.a))
    assert "constraint 'speed': Theta at the parameters' defaults is unstable" in unstable
    (unstable,) = told(sg.Holonomic("path", q[0], -1.0, par.a))
    assert "Theta1 and Theta2 at the parameters' defaults is unstable" in unstable
    (marginal,) = told(sg.Nonholonomic("speed", u[0], par.zero))
    assert "Theta at the parameters' defaults is marginal" in marginal
    assert told(sg.Nonholonomic("speed", u[0], -par.a)) == ()
    assert told(sg.ControlsInvolved("law", tau[0], par.zero)) == ()


def test_more_rows_than_controls_are_named() -> None:
    rows = sg.Nonholonomic("speed", u[0], -1.0), sg.Nonholonomic("other", u[1], -1.0)
    (told,) = review(scene(*rows, l=1))
    assert "2 rows of constraints ('speed', 'other') for 1 controls can never be independent" in told


@pytest.mark.parametrize(
    ("force", "names"),
    [
        (ca.sign(u[0]), "sign"),
        (ca.if_else(u[0] > 0, 1.0, u[1]), "if_else"),
        (u[0] * (q[0] < 1), "a comparison"),
        (ca.floor(q[0]) + ca.sign(u[1]), "floor and sign"),
    ],
)
def test_what_may_jump_is_named(force: Any, names: str) -> None:
    (told,) = review(scene(P=ca.vertcat(force, 0)))
    assert told.startswith(f"scene 'odd': P holds {names}, which may jump: the answer jumps with it; write a smooth")
    (told,) = review(scene(sg.Nonholonomic("speed", u[1] + force, -1.0)))
    assert f"constraint 'speed': psi holds {names}, which may jump: the derivatives" in told


def test_what_has_a_kink_alone_is_not() -> None:
    assert review(scene(P=ca.vertcat(ca.fabs(u[0]), ca.fmax(q[0], u[1]) + ca.tanh(u[0] / 0.01)))) == ()


def test_parameters_and_references_that_nothing_uses() -> None:
    ref = sg.References(hold=0.0, r=sg.Ref([0.0, 0.0], order=1), spare=sg.Ref(0.0, order=2))
    told = review(scene(uses=ca.vertcat(par.k[1], ref.r_dot), parameters=par, references=ref))
    assert [text.split("; ")[0] for text in told] == [
        f"scene 'odd': {thing} is in no expression"
        for thing in ("parameter 'a'", "parameter 'zero'", "reference 'hold'", "reference 'spare'")
    ]


def test_a_build_says_them_at_the_line_that_called_it_and_the_next_build_again() -> None:
    odd = scene(P=ca.vertcat(ca.sign(u[0]), 0), parameters=sg.Parameters(spare=1.0))
    for _ in range(2):
        with warnings.catch_warnings(record=True) as heard:
            warnings.simplefilter("always")
            package = sg.build(odd)
        told = [w for w in heard if issubclass(w.category, UserWarning)]  # not that a temporary folder goes
        assert [str(w.message) for w in told] == list(package.remarks)
        assert len(package.remarks) == 2
        assert {(w.category, w.filename) for w in told} == {(sg.Remark, __file__)}
    with warnings.catch_warnings():
        warnings.simplefilter("error", sg.Remark)
        with pytest.raises(sg.Remark, match="P holds sign"):
            sg.build(odd)
