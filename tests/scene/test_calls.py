"""Calls that CasADi leaves in an expression: written out where the function is made of operations, else named."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.scene.calls import without_calls

X = ca.SX.sym("x", 2)
KEPT = {"never_inline": True}
SQUARE = ca.Function("square", [X], [X[0] ** 2 + X[1], ca.vertcat(ca.sin(X[0]), 0, X[1])], KEPT)
M = ca.MX.sym("m", 2, 2)
OF_MX = ca.Function("of_mx", [M], [ca.mtimes(M, M.T)], KEPT)
S = ca.SX.sym("s", 2, 2)
TURNED = ca.Function("turned", [S], [ca.mtimes(S, S.T)], KEPT)
INNER = ca.Function("inner", [X], [ca.exp(SQUARE(X)[0]) * SQUARE(2 * X)[1][2]], KEPT)
q = ca.SX.sym("q", 2)
TABLE = ca.interpolant("table", "linear", [[0.0, 0.5, 1.0]], [0.0, 1.0, 4.0])


@pytest.mark.parametrize(
    "expression",
    [
        ca.vertcat(*SQUARE(q)) * q[0],
        ca.if_else(q[0] > 0, SQUARE(q)[0], 1 / q[1]) ** 3 + 2 * q[0] - SQUARE(q[::-1])[0] ** 2,
        TURNED(ca.vertcat(ca.horzcat(q[0], 0), ca.horzcat(1, q[1]))),
        INNER(q) + INNER(ca.vertcat(SQUARE(q)[0], 1)),
        ca.jacobian(SQUARE(q)[0], q),
    ],
)
def test_calls_are_written_out(expression: Any) -> None:
    expanded = without_calls(expression, "psi")
    plain, called = ca.Function("p", [q], [expanded]), ca.Function("c", [q], [expression])
    assert ca.OP_CALL not in [plain.instruction_id(k) for k in range(plain.n_instructions())]
    assert plain.sparsity_out(0) == called.sparsity_out(0)
    for at in ([0.3, -0.7], [-1.2, 0.4]):
        np.testing.assert_allclose(np.array(plain(at)), np.array(called(at)), rtol=1e-15)


def test_what_calls_nothing_stays_the_same() -> None:
    expression = ca.sin(q) * q[0]
    assert without_calls(expression, "psi") is expression


def scene(psi: Any) -> sg.Scene:
    u, tau = ca.SX.sym("u", 2), ca.SX.sym("tau", 2)
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=np.eye(2), P=[0, 0], G=np.eye(2))
    return sg.Scene("s", mech, [sg.Holonomic("h", psi, Theta1=-2, Theta2=-1)])


def test_a_constraint_may_call() -> None:
    state = {"q": [0.3, 0.2], "u": [1.0, -2.0]}
    called, plain = (sg.reference(scene(psi)) for psi in (SQUARE(q)[0], q[0] ** 2 + q[1]))
    np.testing.assert_allclose(called.control(**state).value, plain.control(**state).value, rtol=1e-14)


@pytest.mark.parametrize(
    ("psi", "words"),
    [
        (TABLE(q[0]), r"psi calls the function 'table' \(LinearInterpolant\).*ca.pw_lin\(x, grid, values\)"),
        (ca.interpolant("curve", "bspline", [[0.0, 1, 2, 3, 4]], [0.0, 1, 4, 2, 1])(q[0]), "'curve' .*a polynomial"),
        (OF_MX(ca.horzcat(q, q))[0], "'of_mx' .MXFunction.*make it with ca.SX.sym"),
        (ca.rootfinder("root", "newton", ca.Function("g", [X], [X**2 - 2]))(q)[0], "'root' .Newton.*in SX operations"),
    ],
)
def test_a_function_that_is_no_sx_is_named(psi: Any, words: str) -> None:
    with pytest.raises(sg.SceneError, match=words):
        scene(psi)


def test_the_way_out_of_a_table_is_one() -> None:
    x = ca.SX.sym("x")
    way = ca.Function("way", [x], [ca.pw_lin(x, [0.0, 0.5, 1.0], [0.0, 1.0, 4.0])])
    for at in (0.1, 0.4, 0.7):
        assert float(way(at)) == pytest.approx(float(TABLE(at)), rel=1e-14)
    sg.reference(scene(ca.pw_lin(q[0], [0.0, 0.5, 1.0], [0.0, 1.0, 4.0])))
