"""The generated solver against exact rationals and against the textbook, and at the edges of the number range."""

import ctypes
import functools
import itertools

import numpy as np
import pytest
import servogen as sg
from hypothesis import given, settings
from hypothesis import strategies as st
from servogen import exact
from servogen.plan.solver import plan_solver
from servogen.results import Path, Status
from servogen.scalars import EPSILON
from servogen.singular import smallest_singular_value
from servogen.textbook import pseudo_inverse
from servogen.textbook.policy import policy_for
from servogen.verify.stress import core
from servogen.verify.stress.matrices import spectra, with_spectra

pytestmark = pytest.mark.xdist_group("solvers")  # one process compiles each once

SCALARS = ["float64", "float32"]
SHIFTS = {
    "float64": [(130, 0), (0, 550), (-98, 600), (40, -300), (-120, 620)],
    "float32": [(20, 0), (13, -58), (-15, 76)],
}
SHAPES = [(1, 1), (1, 3), (3, 1), (2, 2), (2, 3), (3, 2), (3, 7), (7, 3), (6, 7), (12, 12)]


@functools.cache
def twin(m, l, scalar="float64", solver=None, flags=("-O2",), compiler=None):
    return sg.build_solver(m, l, scalar=scalar, solver=solver or sg.Solver()).load(compiler=compiler, flags=flags)


def given_system(shape, scalar, seed=1):
    generator = np.random.default_rng(seed)
    m, l = shape
    return tuple(generator.standard_normal(s).astype(scalar) for s in ((m, l), (m,), (l,)))


# ---- accuracy --------------------------------------------------------------


@pytest.mark.parametrize("scalar", SCALARS)
@pytest.mark.parametrize("shape", SHAPES)
def test_tau_and_pinv_against_rationals(shape, scalar):
    eps = EPSILON[scalar]
    for seed in range(20):
        S, z, y = given_system(shape, scalar, seed)
        s = exact.rational(S)
        truth = exact.pinv_full(s)
        kappa = np.linalg.cond(S.astype(float))
        X, _ = twin(*shape, scalar).pinv(S)
        error = np.linalg.norm(exact.difference(X, truth), 2)
        assert error <= 5 * eps * kappa * np.linalg.norm(exact.nearest(truth), 2)
        tau, info = twin(*shape, scalar).solve(S, z, y)
        right = exact.solution(s, truth, exact.rational(z), exact.rational(y))
        rest = np.linalg.norm(exact.nearest(exact.rational(z) - s * right))
        size = np.linalg.norm(exact.nearest(right)) + np.linalg.norm(y.astype(float))
        size += kappa * rest / np.linalg.norm(S.astype(float), 2)
        assert np.linalg.norm(exact.difference(tau, right)) <= 4 * eps * kappa * size
        residual = np.linalg.norm(exact.nearest(exact.rational(z) - s * exact.rational(tau)))
        bound = eps * (np.linalg.norm(S, 2) * np.linalg.norm(tau) + np.linalg.norm(z))
        assert abs(info.residual - residual) <= 3 * bound
        assert shape[0] > shape[1] or residual <= 1.5 * bound


@pytest.mark.parametrize("scalar", SCALARS)
@pytest.mark.parametrize("l", [2, 3, 4, 12])
def test_a_row_is_met_where_it_takes_all_of_y_away(l, scalar):
    """y along s and a small z: the residual was 18 to 369 eps (|s| |tau| + |z|) with one refinement."""
    eps = EPSILON[scalar]
    generator = np.random.default_rng(11)
    for reach in range(0, 70, 2):
        s = generator.standard_normal(l).astype(scalar) if reach % 4 else np.full(l, 1.7, scalar)
        y = (s * generator.standard_normal()).astype(scalar)
        z = np.array([generator.standard_normal() * 2.0**-reach], scalar)
        for target in (z, np.zeros(1, scalar)):
            tau, _ = twin(1, l, scalar).solve(s[None], target, y)
            row, wanted = exact.rational(s[None]), exact.rational(target)
            right = exact.solution(row, exact.pinv_full(row), wanted, exact.rational(y))
            size = np.linalg.norm(exact.nearest(right)) + np.linalg.norm(y)
            assert np.linalg.norm(exact.difference(tau, right)) <= 4 * eps * size
            residual = np.linalg.norm(exact.nearest(wanted - row * exact.rational(tau)))
            assert residual <= 1.5 * eps * (np.linalg.norm(s) * np.linalg.norm(tau) + abs(target[0]))
            # through the scaled path, and where what refines leaves the range
            for of_s, of_y in SHIFTS[scalar]:
                given = np.ldexp(s[None], of_s), np.ldexp(target, of_s + of_y), np.ldexp(y, of_y)
                expected = np.ldexp(tau, of_y)
                if np.abs(expected).min(where=expected != 0, initial=1.0) > np.ldexp(np.finfo(scalar).tiny, 30):
                    assert (twin(1, l, scalar).solve(*given)[0] == expected).all()


@pytest.mark.parametrize(
    ("scalar", "s", "y", "z"),
    [
        ("float32", ("0x1.9a3cbp+8", "0x1.068508p+5"), ("-0x1.72c39p-54", "-0x1.da88p-58"), "0x0p+0"),
        (
            "float64",
            ("0x1.5c778062b8efp+23", "0x1.ae476acf5c8eep+26"),
            ("0x1.0ef39ca6e6444p-491", "0x1.4e90a0e641091p-488"),
            "-0x1.1c67010e38cep-519",
        ),
    ],
)
def test_what_noise_decides_does_not_depend_on_the_unit(scalar, s, y, z):
    """Squares of a tau made of noise underflowed, and a power of two in y and z changed the answer."""
    S, y, z = (np.array([float.fromhex(x) for x in row], scalar) for row in (s, y, (z,)))
    tau, _ = twin(1, 2, scalar).solve(S[None], z, y)
    for k in (1, 5, 20, 40):
        moved, _ = twin(1, 2, scalar).solve(S[None], np.ldexp(z, k), np.ldexp(y, k))
        assert (moved == np.ldexp(tau, k)).all()


@pytest.mark.parametrize(
    ("scalar", "y", "z"),
    [
        ("float32", "0x1p+125", "0x1p-30"),
        ("float32", "0x1p+125", "0x1.3c0ca2p-10"),
        ("float64", "0x1p+1020", "-0x1p-60"),
        ("float64", "0x1p+1020", "0x1.3c0ca428c59fbp-20"),
    ],
)
@pytest.mark.parametrize("s", [(1.0, 0.0), (1.0, 1.0), (1.0, 1.0, 0.0, 1.0)])
def test_a_huge_y_along_the_row_leaves_z_alone(s, scalar, y, z):
    """z vanished in the unit of y: tau was 0, or had lost digits, and the residual told was 0."""
    S, z = np.array([s], scalar), np.array([float.fromhex(z)], scalar)
    tau, info = twin(*S.shape, scalar).solve(S, z, float.fromhex(y) * S[0])
    assert np.abs(tau - z[0] * S[0] / S[0].sum()).max() <= EPSILON[scalar] * abs(z[0])
    assert info.residual <= 3 * EPSILON[scalar] * abs(z[0])


@pytest.mark.parametrize("scalar", SCALARS)
@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (3, 3), (6, 6), (3, 1), (3, 2), (7, 3)])
@pytest.mark.parametrize("smallest", [1.0, 1e-3, 0.0])
def test_y_counts_only_where_tau_is_free(shape, scalar, smallest):
    """At full column rank tau = S+ z whatever y: S y taken from z, and y added again, only cost digits."""
    generator = np.random.default_rng(12)
    sigma = np.linspace(1.0, smallest, shape[1]) if shape[1] > 1 else np.ones(1)
    S = with_spectra(*shape, np.array([sigma] * 5), generator).astype(scalar)
    for s in S if smallest else []:
        z = generator.standard_normal(shape[0]).astype(scalar)
        for target in (z, np.ldexp(z, -60), np.zeros_like(z)):
            without, told = twin(*shape, scalar).solve(s, target)
            for reach in (1.0, 1e6, 1e30, float(np.finfo(scalar).max)):
                y = (generator.uniform(-1.0, 1.0, shape[1]) * reach).astype(scalar)
                tau, info = twin(*shape, scalar).solve(s, target, y)
                assert info == told
                assert (tau == without).all()
    if not smallest and shape[1] > 1:
        y = generator.standard_normal(shape[1]).astype(scalar)
        tau, info = twin(*shape, scalar).solve(S[0], np.zeros(shape[0], scalar), y)
        assert info.rank == shape[1] - 1
        assert np.linalg.norm(tau) > 0.01 * np.linalg.norm(y)


@pytest.mark.parametrize("scalar", SCALARS)
@pytest.mark.parametrize("shape", [(2, 3), (3, 7), (6, 7), (12, 12), (7, 3)])
def test_sigma_min_is_a_close_lower_bound(shape, scalar):
    """Never above the exact one, which float64 knows well enough of what is told here; at least half in 99 %."""
    m, l = shape
    generator = np.random.default_rng(21)
    eps = EPSILON[scalar]
    for kappa in (None, 10.0, 1e3, 1e5, 0.02 / (max(shape) * eps)):
        sigma = None if kappa is None else spectra(100, min(shape), kappa, generator)
        S = generator.standard_normal((400, m, l)) if kappa is None else with_spectra(m, l, sigma, generator)
        S = S.astype(scalar)
        values = np.linalg.svd(S.astype(float), compute_uv=False)
        _, info = twin(m, l, scalar).solve(S, np.ones((len(S), m)))
        noise = np.where(info.path == Path.SVD, 4 * eps * values[:, 0], 4 * EPSILON["float64"] * values[:, 0])
        assert (info.sigma_min <= values[:, -1] + noise).all()
        told = info.path != Path.SVD
        assert (info.sigma_min >= 0.1 * values[:, -1])[told].all()
        assert kappa is not None or np.mean(info.sigma_min >= 0.5 * values[:, -1]) >= 0.99
        # of the quick and of the scaled path, and of pinv: the same bits, but for the powers of two
        reach = 600 if scalar == "float64" else 60
        lowered = twin(m, l, scalar).pinv(np.ldexp(S, -reach))[1]
        assert (lowered.sigma_min >= np.ldexp(0.1 * values[:, -1], -reach))[told].all()
        raised = twin(m, l, scalar).solve(np.ldexp(S, reach), np.ldexp(np.ones((len(S), m)), reach))[1]
        assert (raised.sigma_min == np.ldexp(info.sigma_min, reach))[told].mean() > 0.9


def test_sigma_min_of_rows_far_apart():
    """Units 2^900 apart: what is out of reach for the unit of the smallest row only lowers the bound."""
    S = with_spectra(3, 7, np.array([[1.0, 0.5, 0.25]] * 20), np.random.default_rng(22))
    S[:, 0] = np.ldexp(S[:, 0], 450)
    S[:, 2] = np.ldexp(S[:, 2], -450)
    _, info = twin(3, 7).solve(S, np.ones((20, 3)))
    assert (info.path <= Path.QR).all()
    for s, told in zip(S, info.sigma_min, strict=True):
        truth = smallest_singular_value(s)
        assert 0.8 * truth <= told <= truth


@pytest.mark.parametrize("scalar", SCALARS)
def test_sigma_min_exact(scalar):
    """To 4 eps |S|, on every path, and tau's bits do not hang on it."""
    generator = np.random.default_rng(23)
    eps = EPSILON[scalar]
    sigma = np.concatenate([spectra(20, 3, kappa, generator) for kappa in (3.0, 1e4, 0.5 / eps)])
    S = with_spectra(3, 7, sigma, generator) * 2.0 ** generator.integers(-3, 4, (len(sigma), 3, 1))
    S = S.astype(scalar)
    z = generator.standard_normal((len(S), 3)).astype(scalar)
    tau, info = twin(3, 7, scalar, sg.Solver(sigma_min="exact")).solve(S, z)
    values = np.linalg.svd(S.astype(float), compute_uv=False)
    assert (np.abs(info.sigma_min - values[:, -1]) <= 4 * eps * values[:, 0]).all()
    other, bound = twin(3, 7, scalar).solve(S, z)
    assert (tau == other).all()
    assert (bound.sigma_min <= info.sigma_min + 4 * eps * values[:, 0]).all()


@pytest.mark.parametrize("scalar", SCALARS)
@pytest.mark.parametrize("solver", [sg.Solver(), sg.Solver(sigma_min="exact")])
@pytest.mark.parametrize("shape", [(2, 3), (3, 7), (7, 3)])
def test_sigma_min_after_an_svd_is_the_value(shape, solver, scalar):
    """In rows of one unit it was half of it, and in rows of unlike units a bound, which may be above it by rounding."""
    m, l = shape
    generator = np.random.default_rng(24)
    eps = EPSILON[scalar]
    S = generator.choice([-1.0, 1.0], (60, m, l)) * generator.uniform(1.0, 1.9, (60, m, l))
    short = S if m < l else S.transpose(0, 2, 1)
    noise = generator.standard_normal((60, max(m, l))) * np.array([[0.0], [5.0], [20.0], [50.0]] * 15) * eps
    short[:, -1] = 0.4 * (short[:, 0] + short[:, -2]) + noise
    S[1::2] *= 2.0 ** generator.integers(-9, 10, (30, m, 1))
    S = S.astype(scalar)
    _, info = twin(m, l, scalar, solver).solve(S, np.ones((len(S), m)))
    there = info.path == Path.SVD
    assert there.sum() >= 40
    for s, told in zip(S[there], info.sigma_min[there], strict=True):
        assert abs(told - smallest_singular_value(s)) <= 4 * eps * np.linalg.norm(s, 2)


@pytest.mark.parametrize("kappa", [1e6, 1e12, 5e13])
def test_tall_and_ill_conditioned_is_as_good_as_wide(kappa):
    """The first step of the QR must not trust that its pivots are orthogonal: errors of 1e9 eps kappa, until mended."""
    generator = np.random.default_rng(5)
    sigma = np.array([[1.0, 1 / kappa]] * 50)
    S = with_spectra(3, 2, sigma, generator)
    z = np.einsum("nij,nj->ni", S, generator.standard_normal((50, 2)))
    tau, _ = twin(3, 2).solve(S, z)
    for i in range(50):
        right = exact.pinv_full(exact.rational(S[i])) * exact.rational(z[i])
        error = np.linalg.norm(exact.difference(tau[i], right)) / np.linalg.norm(exact.nearest(right))
        assert error <= 4 * EPSILON["float64"] * np.linalg.cond(S[i])


@pytest.mark.parametrize("scalar", SCALARS)
@pytest.mark.parametrize("shape", [(2, 3), (3, 7), (7, 3)])
def test_singular_vectors_are_orthogonal_however_small_the_value(shape, scalar, need_tool):
    """B^T u / sigma alone turns towards the vectors of larger values by eps / sigma: 1e13 units, until mended."""
    need_tool("gcc", "gcc")
    eps, n = EPSILON[scalar], min(shape)
    sigma = (0.1 / eps) ** -(np.arange(n) / max(n - 1, 1))
    S = with_spectra(*shape, np.array([sigma] * 50), np.random.default_rng(6))
    for ratios in core.ratios(S, scalar, eps):
        assert ratios.max() <= 5


@pytest.mark.parametrize("scalar", SCALARS)
@pytest.mark.parametrize(
    "solver",
    [
        sg.Solver(),
        sg.Solver(rank="raw"),
        sg.Solver(damping=0.5),
        sg.Solver(rank="raw", damping=0.5),
        sg.Solver(rtol=0.05),
        sg.Solver(rank="raw", rtol=0.05),
        sg.Solver(atol=1.0),
        sg.Solver(method="cod"),
        sg.Solver(method="cod", rank="raw", atol=1.0),
    ],
)
@pytest.mark.parametrize("shape", [(1, 2), (3, 1), (2, 2), (3, 3), (3, 7), (7, 3)])
def test_like_the_textbook(shape, solver, scalar):
    """Rows of unlike size, low ranks, every option: decisions alike, answers to the digits the condition leaves."""
    generator = np.random.default_rng(7)
    m, l = shape
    plan = policy_for(m, l, scalar, solver)
    share = plan_solver(m, l, scalar, solver).sigma_share
    compared = 0
    for _ in range(150):
        rank = generator.integers(0, min(m, l) + 1)
        S = generator.integers(-3, 4, (m, rank)) @ generator.integers(-3, 4, (rank, l)) * 1.0
        S = np.ldexp(S, generator.integers(-3, 4, m)[:, None]).astype(scalar)
        z = (generator.integers(-3, 4, m) if generator.integers(2) else S @ generator.integers(-3, 4, l)).astype(scalar)
        y = generator.integers(-2, 3, l).astype(scalar)
        expected, textbook = pseudo_inverse.solve(S, z, y, plan)
        tau, info = twin(m, l, scalar, solver).solve(S, z, y)
        sigma = np.linalg.svd(S.astype(float), compute_uv=False)
        if _near_a_decision(S, plan):
            continue
        if solver.rtol is None and solver.damping is None:  # numpy's zeros lie near this rtol: let integers decide
            known = exact.rank(exact.rational(pseudo_inverse.counted_rows(S.astype(float), plan)))
            assert info.rank == known
            if textbook.rank != known:
                continue
        compared += 1
        kept = sigma[: textbook.rank]
        kappa = 1.0 if not kept.size or kept[-1] == 0 else sigma[0] / kept[-1]
        assert (info.status, info.rank) == (textbook.status, textbook.rank)  # the textbook knows no path but the SVD
        assert info.path in plan_solver(m, l, scalar, solver).ladder
        size = np.linalg.norm(expected) + np.linalg.norm(y) + np.linalg.norm(z) / max(kept[-1:], default=1.0)
        np.testing.assert_allclose(tau, expected, rtol=0, atol=40 * plan.epsilon * kappa * size)
        low = {Path.NORMAL: 0.1, Path.QR: 0.1, Path.SVD: share}.get(
            info.path, 1.0
        )  # of S in one unit the SVD's is exact
        if solver.method == "cod" and info.rank < min(m, l) > 1:  # the bound that needs no singular value
            assert info.sigma_min == 0
            low = 0.0
        noise = 20 * plan.epsilon * max(sigma[0], 1e-30)
        assert low * textbook.sigma_min - noise <= info.sigma_min <= textbook.sigma_min + noise
        assert info.residual == pytest.approx(textbook.residual, abs=40 * plan.epsilon * kappa * (size * sigma[0] + 1))
    assert compared > 60


def _near_a_decision(S, plan):
    """Whether a singular value lies within rounding of rtol or damping: then either answer is right."""
    rows = np.abs(S).max(axis=1).astype(float)
    kept = np.where((rows > np.array(plan.atol))[:, None], S.astype(float), 0.0)
    raw = np.linalg.svd(kept, compute_uv=False)
    length = np.linalg.norm(kept, axis=1)
    unit = np.ldexp(1.0, np.frexp(np.where(length > 0, length, 1.0))[1] - 1)
    scaled = np.linalg.svd(kept / unit[:, None], compute_uv=False)
    deciding = scaled if plan.rank == "scaled" else raw
    if deciding[0] > 0 and np.any(np.abs(deciding / deciding[0] / plan.rtol - 1) < 1e-3):
        return True
    return plan.damping is not None and bool(np.any(np.abs(raw / plan.damping - 1) < 1e-3))


@pytest.mark.parametrize("scalar", SCALARS)
def test_all_2x2_over_small_integers(scalar):
    for entries in itertools.product((-1.0, 0.0, 1.0), repeat=4):
        S = np.array(entries, scalar).reshape(2, 2)
        s = exact.rational(S)
        X, info = twin(2, 2, scalar).pinv(S)
        assert info.rank == exact.rank(s)
        np.testing.assert_allclose(X, exact.nearest(exact.pinv(s)), atol=2 * EPSILON[scalar])


# ---- rank, tolerances, damping ---------------------------------------------


def test_unit_of_a_constraint_does_not_matter():
    S = np.array([[1.0, 1.0], [1e-200, -1e-200]])
    tau, info = twin(2, 2).solve(S, np.array([2.0, 0.0]))
    assert (info.status, info.rank) == (Status.OK, 2)
    assert tau == pytest.approx([1, 1])
    assert twin(2, 2, solver=sg.Solver(rank="raw")).pinv(S)[1].rank == 1


def test_a_zero_row_leaves_the_others_their_units():
    S = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 1e-100, 0.0]])
    tau, info = twin(3, 3).solve(S, np.array([3.0, 0.0, 5e-100]))
    assert (info.status, info.rank, info.sigma_min) == (Status.RANK_DEFICIENT_CONSISTENT, 2, 0.0)
    assert tau == pytest.approx([3, 5, 0])


def test_inconsistent_is_least_squares_of_the_raw_rows():
    # the same constraint twice, in units 1 and 1024: the second weighs 2^20 times as much
    S, z = np.array([[1.0, 0.0], [1024.0, 0.0]]), np.array([0.0, 1024.0])
    tau, info = twin(2, 2).solve(S, z)
    assert info.status == Status.RANK_DEFICIENT_INCONSISTENT
    assert tau[0] == pytest.approx(2**20 / (2**20 + 1), rel=1e-15)


@pytest.mark.parametrize("sigma", [1.0, 0.1, 0.0999, 0.05, 1e-6])
@pytest.mark.parametrize("shape", [(1, 2), (2, 1), (2, 2), (2, 3)])
def test_damping_loses_what_it_should(shape, sigma):
    S = np.zeros(shape)
    S[0, 0] = sigma
    if min(shape) == 2:
        S[1, 1] = 3.0
    X, info = twin(*shape, solver=sg.Solver(damping=0.1)).pinv(S)
    lost = (1 - min(sigma / 0.1, 1.0) ** 2) ** 2
    assert sigma * X[0, 0] == pytest.approx(1 - lost, rel=1e-12)
    assert (info.status == Status.REGULARISED) is (sigma < 0.1)


def test_damping_changes_no_bit_where_it_is_not_needed():
    for seed in range(50):
        S, z, y = given_system((3, 7), "float64", seed)
        damped, info = twin(3, 7, solver=sg.Solver(damping=1e-3)).solve(S, z, y)
        assert info.status == Status.OK
        assert (damped == twin(3, 7).solve(S, z, y)[0]).all()


@pytest.mark.parametrize("shape", [(1, 2), (2, 2), (3, 1)])
def test_atol_cuts_rows_off(shape):
    S = np.full(shape, 1e-7)
    S[-1] = 1e-5
    tau, info = twin(*shape, solver=sg.Solver(atol=1e-6)).solve(S, np.full(shape[0], 1e-5))
    assert info.rank == 1
    S[-1] = 1e-6
    tau, info = twin(*shape, solver=sg.Solver(atol=1e-6)).solve(S, np.zeros(shape[0]), np.ones(shape[1]))
    assert info.rank == 0
    assert (tau == 1).all()


# ---- edges of the number range ---------------------------------------------


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (3, 1), (2, 2), (3, 7), (7, 3)])
@pytest.mark.parametrize("scalar", SCALARS)
@pytest.mark.parametrize("hidden", [True, False])
def test_nonfinite_leaves_outputs_alone(shape, scalar, bad, hidden):
    S, z, y = given_system(shape, scalar)
    if hidden:
        S[:, 0] = 0.0  # what multiplies an infinite y
    last = np.full(shape[1], 7.0, scalar)
    for target in (S, z, y):
        for i in range(target.size):
            before = target.flat[i]
            target.flat[i] = bad
            tau, info = twin(*shape, scalar).solve(S, z, y, last)
            assert (info.status, info.path, info.rank, info.sweeps) == (Status.NONFINITE, Path.NONE, 0, 0)
            assert (tau == last).all()
            target.flat[i] = before


@pytest.mark.parametrize("scalar", SCALARS)
@pytest.mark.parametrize("shape", [(1, 2), (3, 1), (2, 2), (3, 7)])
def test_overflow_leaves_outputs_alone(shape, scalar):
    tiny, large = np.finfo(scalar).tiny, np.finfo(scalar).max / 4
    S = (np.eye(*shape) * tiny).astype(scalar)
    last = np.full(shape[1], 7.0, scalar)
    tau, info = twin(*shape, scalar).solve(S, np.full(shape[0], large, scalar), None, last)
    assert info.status == Status.OVERFLOW
    assert (tau == last).all()
    X, info = twin(*shape, scalar).pinv((S / 2**20).astype(scalar), np.full(shape[::-1], 7.0, scalar))
    assert info.status == Status.OVERFLOW
    assert (X == 7).all()


@pytest.mark.parametrize("scalar", SCALARS)
@pytest.mark.parametrize("shape", [(1, 2), (1, 5), (2, 1), (2, 2), (3, 7), (7, 3)])
def test_huge_and_tiny_everything(shape, scalar):
    """S, z and y each at 2^+-k of their own: what fits the type is right."""
    reach = np.finfo(scalar).maxexp - 10
    eps = EPSILON[scalar]
    S, z, y = given_system(shape, scalar)
    kappa = np.linalg.cond(S.astype(float))
    fits = 0
    for kS, kz, ky in itertools.product((-reach, -reach // 2, 0, reach // 2, reach), repeat=3):
        A, b, c = np.ldexp(S, kS), np.ldexp(z, kz), np.ldexp(y, ky)
        s = exact.rational(A)
        right = exact.solution(s, exact.pinv_full(s), exact.rational(b), exact.rational(c))
        tau, info = twin(*shape, scalar).solve(A, b, c)
        truth = exact.nearest(right)[:, 0]
        if np.abs(truth).max() >= np.finfo(scalar).max:
            assert info.status == Status.OVERFLOW
            continue
        fits += 1
        assert info.status >= 0
        scale = 2.0 ** max(np.frexp(np.abs(truth).max())[1], ky) if np.abs(truth).max() > 0 else 1.0
        error = np.linalg.norm(exact.difference(tau, right)[:, 0] / scale)
        allowed = 8 * eps * kappa * (1 + np.linalg.norm(y))
        if shape[0] > shape[1]:  # least squares: kappa^2 on the residual, which is of the size of z and S y
            allowed *= 4 * kappa
        assert error <= allowed or np.abs(truth).max() < np.finfo(scalar).tiny / eps, (kS, kz, ky)
    assert fits > 40


# ---- bits ------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(SCALARS), st.sampled_from([(1, 1), (1, 3), (2, 2), (2, 3), (3, 7)]))
def test_powers_of_two_change_no_bit(seed, scalar, shape):
    S, z, y = given_system(shape, scalar, seed)
    reach = 400 if scalar == "float64" else 45
    k = np.random.default_rng(seed).integers(-reach, reach + 1, shape[0])
    tau, info = twin(*shape, scalar).solve(S, z, y)
    scaled, scaled_info = twin(*shape, scalar).solve(np.ldexp(S, k[:, None]), np.ldexp(z, k), y)
    assert (tau == scaled).all()
    assert (info.status, info.rank, info.sweeps) == (scaled_info.status, scaled_info.rank, scaled_info.sweeps)
    X, _ = twin(*shape, scalar).pinv(S)
    assert (twin(*shape, scalar).pinv(np.ldexp(S, k[:, None]))[0] == np.ldexp(X, -k[None, :])).all()
    # all of S, at any rank: y scaled the other way round
    S[-1] = S[0]
    tau, _ = twin(*shape, scalar).solve(S, z, y)
    assert (twin(*shape, scalar).solve(np.ldexp(S, k[0]), np.ldexp(z, k[0]), y)[0] == tau).all()


@pytest.mark.parametrize("scalar", SCALARS)
def test_same_bits_from_every_compiler_and_level(scalar, need_tool):
    need_tool("clang", "clang")
    others = [twin(3, 7, scalar, None, (level,), c) for c in ("gcc", "clang") for level in ("-O0", "-O3")]
    for seed in range(30):
        S, z, y = given_system((3, 7), scalar, seed)
        S[2] = S[0] + S[1] if seed % 3 == 0 else S[2]
        first, info = twin(3, 7, scalar).solve(S, z, y)
        for other in others:
            tau, again = other.solve(S, z, y)
            assert tau.tobytes() == first.tobytes()
            assert again == info


# ---- calling ---------------------------------------------------------------


def _at(array):
    return ctypes.c_void_p(None if array is None else array.ctypes.data)


@pytest.mark.parametrize("shape", [(1, 2), (1, 7), (2, 1), (3, 7), (7, 3)])
def test_tau_may_alias_y_and_pointers_may_be_null(shape):
    solve = getattr(twin(*shape)._library, f"pinv_{shape[0]}x{shape[1]}_solve")
    S, z, y = given_system(shape, "float64")
    for task in (z, z * 0):  # with and without cancellation
        expected, info = twin(*shape).solve(S, task, y)
        alias = y.copy()
        assert solve(_at(S), _at(task), _at(alias), _at(alias), None) == info.status
        assert (alias == expected).all()
        zero, without = np.zeros(shape[1]), np.full(shape[1], 7.0)
        solve(_at(S), _at(task), None, _at(without), None)
        assert (without == twin(*shape).solve(S, task, zero)[0]).all()


@pytest.mark.parametrize("scalar", SCALARS)
@pytest.mark.parametrize("shape", [(2, 2), (3, 3), (3, 7), (6, 6), (12, 12)])
def test_sweeps_stay_below_the_cap(shape, scalar):
    """Families on which a textbook loop does not end, and the worst of a random search: graded, parallel, integer."""
    generator = np.random.default_rng(3)
    m, l = shape
    cap = plan_solver(m, l, scalar, sg.Solver()).sweep_cap
    N, eps = 400, EPSILON[scalar]
    base = generator.standard_normal((N, m, l))
    families = [
        generator.integers(-1, 2, (N, m, l)),
        generator.integers(-3, 4, (N, m, 1)) * generator.integers(-3, 4, (N, 1, l)),
        base * 10.0 ** generator.uniform(-14, 0, (N, m, 1)) * 10.0 ** generator.uniform(-14, 0, (N, 1, l)),
        base[:, :1] * (1 + eps * generator.integers(-2, 3, (N, m, l))),
        np.cumprod(np.full((N, m, l), 1e-4), axis=2) * base,
    ]
    for S in families:
        _, info = twin(m, l, scalar).solve(S.astype(scalar), np.ones((N, m)))
        assert (np.asarray(info.status) >= 0).all()
        assert np.asarray(info.sweeps).max() < cap


def kahan(n: int, cosine: float) -> np.ndarray:
    """Kahan's triangle, its diagonal raised by a few eps so that rounding moves no pivot."""
    sine = np.sqrt(1 - cosine**2)
    rows = np.diag(sine ** np.arange(n)) @ (np.eye(n) - cosine * np.triu(np.ones((n, n)), 1))
    return rows + 1e3 * EPSILON["float64"] * np.diag(np.arange(n, 0, -1))


def test_cod_decides_the_rank_by_pivots_where_the_svd_decides_otherwise():
    """Kahan's matrix: its last pivot far exceeds the smallest singular value, which sigma_min tells all the same."""
    n = 12
    R = kahan(n, 0.8)
    sigma = np.linalg.svd(R, compute_uv=False)
    pivot = R[-1, -1] / R[0, 0]
    assert pivot > 100 * sigma[-1] / sigma[0]
    rtol = float(np.sqrt(pivot * sigma[-1] / sigma[0]))  # between the two
    S = R.T  # the pivots are those of the rows
    _, by_pivots = twin(n, n, solver=sg.Solver(method="cod", rank="raw", rtol=rtol)).solve(S, np.ones(n))
    _, by_values = twin(n, n, solver=sg.Solver(rank="raw", rtol=rtol)).solve(S, np.ones(n))
    assert (by_pivots.rank, by_values.rank) == (n, n - 1)
    assert 0.1 * sigma[-1] < by_pivots.sigma_min <= sigma[-1]
    assert exact.rank_by_pivots(exact.rational(S), rtol) == n


@pytest.mark.parametrize("scalar", SCALARS)
def test_cod_takes_the_same_path_whatever_the_unit(scalar):
    """Of the quick and of the scaled path: the same bits, but for the powers of two; no sweep anywhere."""
    generator = np.random.default_rng(5)
    solver = sg.Solver(method="cod")
    S = generator.standard_normal((200, 3, 7)).astype(scalar)
    S[::3, 2] = S[::3, 0]
    z = generator.standard_normal((200, 3)).astype(scalar)
    y = generator.standard_normal((200, 7)).astype(scalar)
    tau, info = twin(3, 7, scalar, solver).solve(S, z, y)
    reach = 500 if scalar == "float64" else 50
    lowered, told = twin(3, 7, scalar, solver).solve(np.ldexp(S, -reach), z, np.ldexp(y, reach))
    assert (np.ldexp(lowered, -reach) == tau).all()
    assert (told.rank == info.rank).all()
    assert (info.rank == np.where(np.arange(200) % 3, 3, 2)).all()
    assert (info.sweeps == 0).all()
    assert (info.path == Path.QR).all()
    assert (info.sigma_min[info.rank == 2] == 0).all()
