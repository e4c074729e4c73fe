"""Exact rationals: the Penrose identities hold as identities, and hand-made answers come out."""

import flint
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from servogen import exact


def penrose_holds(S, X):
    return S * X * S == S and X * S * X == X and (S * X).transpose() == S * X and (X * S).transpose() == X * S


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 4), st.integers(1, 4), st.data())
def test_penrose_identities_exactly(m, l, data):
    entries = data.draw(st.lists(st.integers(-2, 2), min_size=m * l, max_size=m * l))
    S = exact.rational(np.array(entries, float).reshape(m, l))
    assert penrose_holds(S, exact.pinv(S))
    assert exact.rank(S) == np.linalg.matrix_rank(np.array(entries).reshape(m, l))


def test_the_three_routes_agree():
    generator = np.random.default_rng(1)
    S = exact.rational(generator.standard_normal((3, 5)))
    assert exact.pinv(S) == exact.pinv_full(S)
    assert exact.pinv_full(S.transpose()) == exact.pinv_full(S).transpose()
    B, C = exact.rational(generator.integers(-3, 4, (4, 2))), exact.rational(generator.integers(-3, 4, (2, 5)))
    assert exact.pinv_product(B, C) == exact.pinv(B * C)


def test_known_by_hand():
    X = exact.pinv(exact.rational(np.array([[1.0, 2.0], [2.0, 4.0]])))
    assert flint.fmpq_mat(2, 2, [flint.fmpq(n, 25) for n in (1, 2, 2, 4)]) == X


def test_solution_keeps_y_in_the_null_space():
    S = exact.rational(np.array([[3.0, 4.0]]))
    tau = exact.solution(S, exact.pinv(S), exact.rational(np.array([25.0])), exact.rational(np.array([4.0, -3.0])))
    assert exact.nearest(tau)[:, 0].tolist() == [7.0, 1.0]


def test_every_double_is_itself():
    values = np.array([5e-324, -1.7976931348623157e308, 0.1, 0.0])
    assert (exact.nearest(exact.rational(values))[:, 0] == values).all()
    assert exact.nearest(exact.rational(values) * 4)[1, 0] == -np.inf


def test_difference_is_rounded_last():
    third = flint.fmpq_mat(1, 1, [flint.fmpq(1, 3)])
    error = exact.difference(np.array([1 / 3]), third)[0, 0]
    assert error == pytest.approx(-(2.0**-54) / 3, rel=1e-12)


def test_below_full_rank_is_an_error():
    with pytest.raises(ZeroDivisionError):
        exact.pinv_full(exact.rational(np.ones((2, 3))))
    with pytest.raises(ValueError, match="not rational"):
        exact.rational(np.array([np.nan]))
