"""What is found out about Q: its symmetry by proof, its signs by states of the domain, and what is said of them."""

import re
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.compiler import derived_scene
from servogen.ir.lower import lower_expressions
from servogen.ir.program import Input
from servogen.loading import builtin_names, load_scene
from servogen.scene.review import review
from servogen.survey.definiteness import is_symmetric

q, u, tau = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau", 2)
par = sg.Parameters(a=2.0, b=0.5)


def small(Q: Any, domain: Any = None, psi: Any = None) -> sg.Scene:
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=Q, P=ca.vertcat(-q[0], 0.3), G=ca.DM.eye(2))
    task = u[0] + 0.5 * u[1] if psi is None else psi
    return sg.Scene("small", mech, [sg.Nonholonomic("task", task, -1.0)], parameters=par, domain=domain)


def entries(a: Any, b: Any, c: Any, d: Any) -> Any:
    return ca.vertcat(ca.horzcat(a, b), ca.horzcat(c, d))


def symmetric(Q: Any) -> bool:
    inputs = [(Input("q", 2), q), (Input("a", 1), par.a), (Input("b", 1), par.b)]
    return is_symmetric(lower_expressions("Q", inputs, [("Q", Q)]), "Q")


def test_commuted_products_are_symmetric_by_proof() -> None:
    a, b = q[0], par.a
    for upper, lower in (
        (a * b, b * a),
        (ca.sin(a * b), ca.sin(b * a)),
        (a * b + 1, 1 + b * a),
        (-(a * b), a * -b),
        (ca.cos(q[0] - q[1]), ca.cos(-(q[0] - q[1]))),
        (2 * a, a + a),
    ):
        Q = entries(4, upper, lower, 4)
        assert symmetric(Q), (upper, lower)
    for upper, lower in ((a * b, a / b), (ca.sin(a), ca.cos(a)), (a, -a), (a, a + 1e-15)):
        Q = entries(4, upper, lower, 4)
        assert not symmetric(Q), (upper, lower)


@pytest.mark.parametrize(
    ("Q", "where"),
    [
        (ca.diag(ca.vertcat(2.0, -1.0)), "8 of 8 states"),
        (entries(1, 2, 2, 1), "8 of 8 states"),
        (ca.diag(ca.vertcat(q[0], 1)), "[1-7] of 8 states"),
    ],
)
def test_a_mass_matrix_of_wrong_signs_is_said(Q: Any, where: str) -> None:
    (remark,) = derived_scene(small(Q, {"q": (-1.0, 1.0)}))[0].remarks
    assert re.match(f"scene 'small': Q is not positive definite at {where}", remark)


def test_a_mass_matrix_that_is_not_symmetric_is_said() -> None:
    told = "scene 'small': Q is not symmetric, as a mass matrix is: Q[0, 1] is not Q[1, 0]; check its entries"
    units = np.diag([1e-6, 1e6])
    for Q in (
        entries(2 + q[0], 0.1, 0.2, 1),
        entries(1, 2, 0, -1),
        ca.DM(units @ np.array([[2, 0.1], [0, 2]]) @ units),
    ):
        assert derived_scene(small(Q, {"q": (-1.0, 1.0)}))[0].remarks == (told,)


def test_a_mass_matrix_as_it_should_be_is_not_remarked() -> None:
    L, units = np.array([[2.0, 0.0], [1.9, 1.0]]), np.diag([1e-5, 1e4])
    rounded = 1 + 0.1 * ca.cos(q[0] + q[1]), 1 + 0.1 * (ca.cos(q[0]) * ca.cos(q[1]) - ca.sin(q[0]) * ca.sin(q[1]))
    for Q in (
        ca.diag(ca.vertcat(par.a, 3.0)),
        entries(2 + q[0], 0.1, 0.1, 1),
        ca.DM(units @ L @ L.T @ units),
        entries(3, rounded[0], rounded[1], 3),  # equal, as far as rounding tells
        entries(1, 1e-20, 0, 1),
    ):
        assert derived_scene(small(Q, {"q": (-1.0, 1.0)}))[0].remarks == ()


@pytest.mark.parametrize("name", builtin_names())
def test_no_built_in_scene_is_remarked_on(name: str) -> None:
    assert (*derived_scene(load_scene(name))[0].remarks, *review(load_scene(name))) == ()
