"""The textbook's QR with pivots, against scipy's; and the rank by pivots, against that in exact rationals."""

import numpy as np
import pytest
from scipy.linalg import qr
from servogen import exact
from servogen.textbook.pivoted import reduced, truncated


@pytest.mark.parametrize("shape", [(3, 3), (7, 3), (3, 7), (12, 12)])
def test_as_scipy_has_it(shape):
    A = np.random.default_rng(2).standard_normal(shape)
    Q, R, order = reduced(A)
    _, theirs, permutation = qr(A, pivoting=True)
    np.testing.assert_allclose(Q @ R, A[:, order], atol=1e-14)
    np.testing.assert_allclose(Q.T @ Q, np.eye(shape[0]), atol=1e-14)
    np.testing.assert_allclose(np.abs(np.diag(R)), np.abs(np.diag(theirs)), rtol=1e-12)
    assert order[: min(shape)] == list(permutation[: min(shape)])


@pytest.mark.parametrize("shape", [(4, 6), (6, 4), (5, 5)])
def test_what_is_kept_is_near_and_of_the_rank_of_exact_pivots(shape):
    generator = np.random.default_rng(3)
    for _ in range(30):
        rank = int(generator.integers(0, 5))
        S = 1.0 * generator.integers(-3, 4, (shape[0], rank)) @ generator.integers(-3, 4, (rank, shape[1]))
        S += 1e-9 * generator.integers(-1, 2, shape)
        for rtol in (1e-13, 1e-6):
            kept, found = truncated(S, rtol)
            assert found == exact.rank_by_pivots(exact.rational(S), rtol)
            size = np.linalg.norm(S)
            assert np.linalg.norm(kept - S) <= 20 * rtol * size
            if found:
                assert np.linalg.matrix_rank(kept, tol=1e-12 * size) == found
