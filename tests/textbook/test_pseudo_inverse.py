"""The textbook solver against scipy, exact rationals and matrices whose answer is known by hand."""

import numpy as np
import pytest
import scipy.linalg
from servogen import exact
from servogen.results import Path, Status
from servogen.scene.solver import Solver
from servogen.textbook import pseudo_inverse
from servogen.textbook.policy import policy_for

SHAPES = [(1, 1), (1, 3), (3, 1), (2, 2), (3, 7), (7, 3), (6, 12)]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("rank", ["scaled", "raw"])
def test_full_rank_is_scipys(shape, rank):
    generator = np.random.default_rng(1)
    S, z, y = generator.standard_normal(shape), generator.standard_normal(shape[0]), generator.standard_normal(shape[1])
    policy = policy_for(*shape, "float64", Solver(rank=rank))
    expected = scipy.linalg.pinv(S)
    matrix, info = pseudo_inverse.pinv(S, policy)
    np.testing.assert_allclose(matrix, expected, rtol=0, atol=1e-13 * np.linalg.norm(expected))
    tau, info = pseudo_inverse.solve(S, z, y, policy)
    np.testing.assert_allclose(tau, y + expected @ (z - S @ y), atol=1e-12)
    assert info.status == (Status.OK if shape[0] <= shape[1] else Status.RANK_DEFICIENT_INCONSISTENT)
    assert info.path == (Path.CLOSED_FORM if min(shape) == 1 else Path.SVD)
    assert info.sigma_min == pytest.approx(scipy.linalg.svdvals(S).min())
    assert info.residual == pytest.approx(np.linalg.norm(z - S @ tau), abs=1e-14)


def test_rank_deficient_is_that_of_the_raw_matrix():
    S = np.array([[1.0, 2.0], [2.0, 4.0], [256.0, 512.0]])
    expected = exact.nearest(exact.pinv(exact.rational(S)))
    matrix, info = pseudo_inverse.pinv(S, policy_for(3, 2, "float64", Solver()))
    np.testing.assert_allclose(matrix, expected, atol=1e-17)
    assert info.rank == 1


@pytest.mark.parametrize(("z", "status"), [([1, 2], 1), ([1, 2.5], 2)])
def test_consistency(z, status):
    S = np.array([[1.0, 1.0], [2.0, 2.0]])
    tau, info = pseudo_inverse.solve(S, np.array(z), None, policy_for(2, 2, "float64", Solver()))
    assert info.status == status
    assert tau[0] == pytest.approx(tau[1])


def test_policies_differ_on_units():
    S = np.array([[1.0, 0.0], [0.0, 1e-17]])
    scaled = pseudo_inverse.pinv(S, policy_for(2, 2, "float64", Solver(rank="scaled")))
    raw = pseudo_inverse.pinv(S, policy_for(2, 2, "float64", Solver(rank="raw")))
    assert (scaled[1].rank, raw[1].rank) == (2, 1)
    assert scaled[0][1, 1] == pytest.approx(1e17)


@pytest.mark.parametrize("sigma", [2.0, 0.1 + 1e-9, 0.1 - 1e-9, 0.05, 1e-3, 0.0])
def test_damping_filter(sigma):
    S = np.diag([1.0, sigma])
    matrix, info = pseudo_inverse.pinv(S, policy_for(2, 2, "float64", Solver(damping=0.1)))
    # numerics.md: Damping: what is lost of the task is (1 - (sigma / eps_d)^2)^2
    lost = (1 - min(sigma / 0.1, 1.0) ** 2) ** 2
    assert sigma * matrix[1, 1] == pytest.approx(1 - lost if sigma else 0.0)
    # at 0.1 itself the last bit of LAPACK would decide
    assert (info.status == Status.REGULARISED) is (0 < sigma < 0.1)


def test_atol_is_per_row():
    S = np.array([[1e-9, 0.0], [0.0, 1e-9]])
    matrix, info = pseudo_inverse.pinv(S, policy_for(2, 2, "float64", Solver(atol=[1e-6, 0.0])))
    np.testing.assert_allclose(matrix, [[0, 0], [0, 1e9]], atol=1e-6)
    assert info.rank == 1


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_nonfinite_gives_last(bad):
    policy = policy_for(1, 2, "float64", Solver())
    last = np.array([3.0, 4.0])
    for S, z, y in (([[bad, 1]], [1], [0, 0]), ([[1, 1]], [bad], [0, 0]), ([[1, 1]], [1], [0, bad])):
        tau, info = pseudo_inverse.solve(np.array(S), np.array(z), np.array(y), policy, last)
        assert info.status == Status.NONFINITE
        assert (tau == last).all()


def test_overflow_is_that_of_the_target_type():
    S, z = np.array([[1e-30, 0.0]]), np.array([1e10])
    assert pseudo_inverse.solve(S, z, None, policy_for(1, 2, "float32", Solver()))[1].status == Status.OVERFLOW
    assert pseudo_inverse.solve(S, z, None, policy_for(1, 2, "float64", Solver()))[1].status == Status.OK


def test_wrong_shapes_are_named():
    with pytest.raises(ValueError, match=r"z has shape \(2,\), expected \(1,\)"):
        pseudo_inverse.solve(np.ones((1, 2)), np.ones(2), None, policy_for(1, 2, "float64", Solver()))
