"""The solver within limits against exact rationals: the optimum of every level, its status, never a bit beyond."""

import ctypes as ct
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import product

import flint
import numpy as np
import pytest
import servogen as sg
from servogen import exact
from servogen.compiler import target_for
from servogen.exact_bounds import Optimum, best_within
from servogen.law.steps import SYSTEM, Limit, Solve
from servogen.package import write
from servogen.plan.bounds import plan_bounds
from servogen.plan.planner import plan_solver_only
from servogen.render.render import render
from servogen.scalars import EPSILON
from servogen.textbook.limits import solve_within
from servogen.textbook.policy import policy_for
from servogen.twins.compiled import compile_library

System = tuple[np.ndarray, ...]
"""S, z, y, lower, upper."""

OPTIMUM_BAR, TAU_BAR = 4.0, 8.0
"""Of |S tau - z| above the least, and of tau off the truth, over u kappa and the sizes in play."""


def plain(r: np.random.Generator, m: int, l: int) -> System:
    size = r.choice([0.1, 1, 10])
    return (
        r.standard_normal((m, l)),
        size * r.standard_normal(m),
        r.standard_normal(l),
        -2 * r.random(l),
        2 * r.random(l),
    )


def ties(r: np.random.Generator, m: int, l: int) -> System:
    """Small integers: ranks that drop, equal pulls, limits of no width."""
    limits = -r.integers(0, 2, l), r.integers(0, 2, l)
    return r.integers(-2, 3, (m, l)), r.integers(-4, 5, m), r.integers(-2, 3, l), *limits


def deficient(r: np.random.Generator, m: int, l: int) -> System:
    k = max(1, min(m, l) - 1)
    S = r.integers(-3, 4, (m, k)) @ r.integers(-3, 4, (k, l))
    z = S @ r.integers(-2, 3, l) if r.random() < 0.5 else r.standard_normal(m)
    return S, z, *plain(r, m, l)[2:]


def one_sided(r: np.random.Generator, m: int, l: int) -> System:
    S, z, y, lower, upper = plain(r, m, l)
    return S, z, y, np.where(r.random(l) < 0.5, -np.inf, lower), np.where(r.random(l) < 0.5, np.inf, upper)


def thrusters(r: np.random.Generator, m: int, l: int) -> System:
    S, z, *_ = plain(r, m, l)
    return S, z, np.zeros(l), np.zeros(l), np.full(l, np.inf)


def standstill(r: np.random.Generator, m: int, l: int) -> System:
    """Nothing is asked of thrusters: often tau = 0 alone, where all numbers in play vanish but y."""
    S = r.integers(-2, 3, (m, l)) if r.random() < 0.5 else r.standard_normal((m, l))
    return S, np.zeros(m), np.full(l, 0.5), np.zeros(l), np.full(l, 3.0)


def vertex(r: np.random.Generator, m: int, l: int) -> System:
    """All constraints can be met, at a corner of the box."""
    S, lower, upper = r.integers(-3, 4, (m, l)), -r.integers(1, 9, l) / 4, r.integers(1, 9, l) / 4
    return S, S @ np.where(r.random(l) < 0.5, lower, upper), r.standard_normal(l), lower, upper


def beside_a_vertex(r: np.random.Generator, m: int, l: int) -> System:
    """The same but for the last bit of z."""
    S, z, y, lower, upper = vertex(r, m, l)
    return S, np.nextafter(z, r.choice([-9.0, 9.0], m)), y, lower, upper


def face(r: np.random.Generator, m: int, l: int) -> System:
    S, _, y, lower, upper = plain(r, m, l)
    x = np.where(r.random(l) < 0.5, np.where(r.random(l) < 0.5, lower, upper), r.uniform(lower, upper))
    return S, S @ x, y, lower, upper


def no_width(r: np.random.Generator, m: int, l: int) -> System:
    S, z, y, lower, upper = plain(r, m, l)
    return S, z, y, lower, np.where(r.random(l) < 0.4, lower, upper)


def rows_apart(r: np.random.Generator, m: int, l: int) -> System:
    S, _, *rest = plain(r, m, l)
    S = S * 2.0 ** r.integers(-8, 9, (m, 1))
    return S, S @ r.standard_normal(l), *rest


def far_wish(r: np.random.Generator, m: int, l: int) -> System:
    S, z, y, lower, upper = plain(r, m, l)
    return S, z, y * 10.0 ** r.integers(0, 9), lower, upper


FAMILIES: dict[str, Callable[[np.random.Generator, int, int], System]] = {
    f.__name__: f
    for f in (
        plain,
        ties,
        deficient,
        one_sided,
        thrusters,
        standstill,
        vertex,
        beside_a_vertex,
        face,
        no_width,
        rows_apart,
        far_wish,
    )
}
SHAPES = ((1, 3), (3, 2), (3, 4), (4, 6))


@pytest.fixture(scope="module")
def solvers():
    built: dict[tuple[int, int, str], object] = {}

    def solver(m: int, l: int, scalar: str):
        if (m, l, scalar) not in built:
            built[m, l, scalar] = sg.build_solver(m, l, scalar=scalar, limits=True).load()
        return built[m, l, scalar]

    return solver


def systems(name: str, m: int, l: int, count: int, scalar: str, seed: int) -> list[np.ndarray]:
    """A stack of each of S, z, y, lower, upper, as numbers of the scalar."""
    rng = np.random.default_rng(seed)
    drawn = [FAMILIES[name](rng, m, l) for _ in range(count)]
    return [np.stack([np.asarray(d[k], dtype=float) for d in drawn]).astype(scalar) for k in range(5)]


def truth_of(S: np.ndarray, z: np.ndarray, y: np.ndarray, lower: np.ndarray, upper: np.ndarray, metric=None) -> Optimum:
    sides = [[None if np.isinf(v) else exact.rational(np.array([v]))[0, 0] for v in side] for side in (lower, upper)]
    return best_within(*(exact.rational(a.astype(float)) for a in (S, z, y)), *sides, metric)


def norm(column: exact.Matrix) -> float:
    return float(np.linalg.norm(exact.nearest(column)))


def condition(S: np.ndarray, place: tuple[int, ...]) -> float:
    """Of the free columns, rows of one size."""
    size = np.abs(S).max(axis=1, keepdims=True)
    free = (S / np.where(size > 0, size, 1))[:, [p == 0 for p in place]]
    sigma = np.linalg.svd(free, compute_uv=False) if free.size else np.ones(1)
    sigma = sigma[sigma > 1e-12 * sigma[0]] if sigma[0] > 0 else np.ones(1)
    return float(sigma[0] / sigma[-1])


@pytest.mark.parametrize("scalar", ["float64", "float32"])
@pytest.mark.parametrize("name", FAMILIES)
def test_every_level_is_the_best(name: str, scalar: str, solvers) -> None:
    u = EPSILON[scalar]
    for shape, (m, l) in enumerate(SHAPES):
        given = systems(name, m, l, 6, scalar, shape)
        tau, info = solvers(m, l, scalar).solve(*given)
        assert np.all((given[3] <= tau) & (tau <= given[4])), "beyond a limit"
        assert np.all(
            info.active
            == [sum(1 << j for j in range(l) if t[j] in (a[j], b[j])) for t, a, b in zip(tau, *given[3:], strict=True)]
        )
        for k in range(len(tau)):
            S, z, y, lower, upper = (a[k].astype(float) for a in given)
            best = truth_of(S, z, y, lower, upper)
            status, rows = sg.Status(int(info.status[k])), np.linalg.norm(S, axis=1)
            x = exact.nearest(best.x)[:, 0]
            reach = np.linalg.norm(x) + np.linalg.norm(y) + np.max(np.abs(z) / np.where(rows > 0, rows, np.inf))
            size = np.linalg.norm(S) * (np.linalg.norm(x) + np.linalg.norm(y)) + np.linalg.norm(z)
            missed = norm(exact.rational(S) * exact.rational(tau[k].astype(float)) - exact.rational(z))
            assert missed - norm(best.rest) <= OPTIMUM_BAR * u * size, (m, l, k)
            off = np.linalg.norm(exact.difference(tau[k].astype(float), best.x))
            assert off <= TAU_BAR * u * condition(S, best.place) * reach, (m, l, k, off)
            limited = any(best.place)
            if norm(best.rest) > 100 * u * size and np.max(
                np.abs(exact.nearest(best.pull))
            ) > 100 * u * size * np.linalg.norm(S):
                assert status == sg.Status.LIMITED_INCONSISTENT
            elif best.met and limited and status >= sg.Status.LIMITED:
                assert status == sg.Status.LIMITED
            elif not limited and np.all((x > lower + 100 * u * reach) & (x < upper - 100 * u * reach)):
                assert status < sg.Status.LIMITED


def test_the_truth_is_the_best_of_all_active_sets() -> None:
    """The least misses, then the shortest way from y, of all 3^l ways to put controls at limits."""
    rng = np.random.default_rng(4)
    for name, (m, l) in product(("plain", "ties", "vertex", "one_sided"), ((1, 2), (2, 3), (3, 2))):
        S, z, y, lower, upper = (np.asarray(a, dtype=float) for a in FAMILIES[name](rng, m, l))
        found = truth_of(S, z, y, lower, upper)
        best = None
        for place in product((-1, 0, 1), repeat=l):
            at = np.where(np.array(place) < 0, lower, np.where(np.array(place) > 0, upper, 0.0))
            if not np.isfinite(at).all():
                continue
            free = [j for j in range(l) if place[j] == 0]
            x, exact_S, wish = exact.rational(at), exact.rational(S), exact.rational(y)
            if free:
                part, own = exact.rational(S[:, free]), exact.rational(y[free])
                moved = own + exact.pinv(part) * (exact.rational(z) - exact_S * x - part * own)
                for k, j in enumerate(free):
                    x[j, 0] = moved[k, 0]
            inside = all(
                (np.isinf(a) or x[j, 0] >= exact.rational(np.array([a]))[0, 0])
                and (np.isinf(b) or x[j, 0] <= exact.rational(np.array([b]))[0, 0])
                for j, (a, b) in enumerate(zip(lower, upper, strict=True))
            )
            rest, way = exact_S * x - exact.rational(z), x - wish
            costs = (rest.transpose() * rest)[0, 0], (way.transpose() * way)[0, 0]
            if inside and (best is None or costs < best[0]):
                best = costs, x
        assert best is not None
        assert best[1] == found.x, name


@pytest.mark.parametrize(
    "name", sorted(FAMILIES.keys() - {"far_wish"})
)  # which scipy's methods, of 1e-12, cannot tell from none
def test_the_textbook_agrees(name: str) -> None:
    m, l = 3, 5
    policy = policy_for(m, l, "float64", sg.Solver())
    for S, z, y, lower, upper in zip(*systems(name, m, l, 8, "float64", 7), strict=True):
        tau, info = solve_within(S, z, y, lower, upper, policy)
        best = truth_of(S, z, y, lower, upper)
        assert np.allclose(tau, exact.nearest(best.x)[:, 0], atol=1e-7 * (1 + np.linalg.norm(y)))
        assert np.all((lower <= tau) & (tau <= upper))
        if best.met and info.status >= sg.Status.LIMITED:
            assert info.status == sg.Status.LIMITED


@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_limits_that_are_not_met_change_no_bit(scalar: str, solvers) -> None:
    for m, l in ((1, 3), (3, 2), (3, 4)):
        without = sg.build_solver(m, l, scalar=scalar).load()
        for name in ("plain", "deficient"):
            S, z, y, *_ = systems(name, m, l, 40, scalar, 3)
            expected, told = without.solve(S, z, y)
            tau, info = solvers(m, l, scalar).solve(S, z, y, lower=expected, upper=np.inf)
            assert tau.tobytes() == expected.tobytes()
            assert np.array_equal(info.status, told.status)
            assert np.array_equal(info.residual, told.residual)
            assert np.all(info.scale == 1)
            assert np.all(info.active == 2**l - 1)


def test_crossed_limits_and_nan_leave_tau_alone(solvers) -> None:
    solve, last = solvers(2, 2, "float64").solve, np.array([7.0, 8.0])
    S, z = np.eye(2), np.ones(2)
    for lower, upper in (([2, 0], [1, 3]), ([np.nan, 0], [3, 3]), ([0, 0], [3, np.nan]), ([np.inf, 0], [np.inf, 3])):
        tau, info = solve(S, z, last=last, lower=lower, upper=upper)
        assert info.status == sg.Status.LIMITS_CROSSED
        assert np.array_equal(tau, last)
        policy = policy_for(2, 2, "float64", sg.Solver())
        told = info, solve([S], [z], None, [lower], [upper])[1], solve_within(S, z, None, lower, upper, policy)[1]
        assert all(np.all(np.array([i.scale, i.active]) == 0) for i in told)
    tau, info = solve([[np.nan, 0], [0, 1]], z, last=last, lower=0, upper=1)
    assert info.status == sg.Status.NONFINITE
    assert np.array_equal(tau, last)
    policy = policy_for(2, 2, "float64", sg.Solver())
    assert info.scale == solve_within(np.eye(2), [np.nan, 0], None, np.zeros(2), np.ones(2), policy)[1].scale == 0
    with pytest.raises(sg.SceneError, match="leave out damping"):
        sg.build_solver(2, 3, solver=sg.Solver(damping=0.1), limits=True)


@pytest.mark.parametrize("m", [1, 2])
def test_a_row_within_its_tolerance_asks_for_nothing(m: int) -> None:
    solve = sg.build_solver(m, 3, solver=sg.Solver(atol=1e-6), limits=True).load().solve
    S = np.array([[0, 1e-9, 0], [1, 0, 0]][:m], dtype=float)
    tau, info = solve(S, [1.0, 2.0][:m], [0.0, 0.0, 5.0], lower=-1, upper=1)
    assert np.array_equal(tau, [0, 0, 1] if m == 1 else [1, 0, 1])
    assert info.status == (sg.Status.RANK_DEFICIENT_INCONSISTENT if m == 1 else sg.Status.LIMITED_INCONSISTENT)


@pytest.mark.parametrize(("scalar", "huge"), [("float64", 1e300), ("float32", 1e37)])
def test_numbers_near_the_ends_of_the_range(scalar: str, huge: float, solvers) -> None:
    """Powers of two change no bit; an answer that would overflow without limits is found within them."""
    solve = solvers(3, 4, scalar).solve
    S, z, y, lower, upper = systems("plain", 3, 4, 30, scalar, 9)
    tau, info = solve(S, z, y, lower=lower, upper=upper)
    for power in (2.0**-60, 2.0**60):
        scaled, _ = solve(S, z * power, y * power, lower=lower * power, upper=upper * power)
        assert np.array_equal(scaled, tau * np.float64(power))
        weighed, again = solve(S * power, z * power, y, lower=lower, upper=upper)
        assert np.array_equal(weighed, tau)
        assert np.array_equal(again.status, info.status)
    tau, info = solve(S[0] / huge, z[0], y[0], lower=lower[0], upper=upper[0])
    assert info.status == sg.Status.LIMITED_INCONSISTENT
    assert np.all((lower[0] <= tau) & (tau <= upper[0]))
    tau, info = solve(np.eye(3, 4), np.full(3, huge), lower=-huge / 2, upper=huge / 2)
    assert np.array_equal(tau, np.array([huge / 2] * 3 + [0]).astype(scalar))
    assert info.active == 0b111
    tau, info = solve(np.eye(3, 4), np.ones(3), lower=np.full(4, huge), upper=np.inf)
    assert np.array_equal(tau, np.full(4, huge, scalar))
    assert info.status == sg.Status.LIMITED_INCONSISTENT


@pytest.mark.parametrize("name", ["plain", "vertex", "beside_a_vertex", "ties", "standstill"])
def test_the_search_ends(name: str, solvers) -> None:
    for m, l in ((3, 7), (6, 12)):
        given = systems(name, m, l, 300, "float64", 11)
        _, info = solvers(m, l, "float64").solve(*given[:3], lower=given[3], upper=given[4])
        assert np.all(info.status >= 0)


def test_same_bits_from_every_optimisation_level() -> None:
    package = sg.build_solver(4, 6, scalar="float32", limits=True)
    given = systems("plain", 4, 6, 300, "float32", 5)
    compilers = [c for c in ("gcc", "clang") if shutil.which(c)]
    answers = {
        package.load(compiler, flags=(level,)).solve(*given[:3], lower=given[3], upper=given[4])[0].tobytes()
        for compiler in compilers
        for level in ("-O0", "-O3")
    }
    assert len(answers) == 1


_WARNINGS = "-Wall -Wextra -Wpedantic -Wconversion -Wdouble-promotion -Wmissing-prototypes -Wshadow -Werror"


def _with_more(m: int, l: int, slowed: bool, metric: bool, folder):
    """A solver whose limits also take a slowing or a metric, which only the law of a scene would ask for."""
    module = plan_solver_only(m, l, target_for("more", "float64", None), sg.Solver(), limits=True)
    routine = module.law.routine("solve")
    limit = Limit(
        "tau", SYSTEM, "start", "S", "z", "lower", "upper", "y", "slow" if slowed else "", "metric" if metric else ""
    )
    more = (("slow", (m, 1)),) if slowed else (("metric", (l, l)),)
    changed = replace(
        routine, steps=(Solve("start", SYSTEM, "S", "z", "y"), limit), arguments=(*routine.arguments, *more)
    )
    law = replace(module.law, routines=(changed, *module.law.routines[1:]))
    module = replace(module, law=law, limits=plan_bounds(law, module.solvers))
    package = write(render(module), folder, module, None)
    library = compile_library(package, None, tuple(_WARNINGS.split()))
    library.more_solve.restype = ct.c_int

    def solve(*arrays: np.ndarray) -> tuple[int, np.ndarray, float]:
        tau, info = np.full(l, np.nan), (ct.c_double * 8)()
        status = library.more_solve(
            *(ct.c_void_p(np.ascontiguousarray(a, dtype=float).ctypes.data) for a in arrays),
            ct.c_void_p(tau.ctypes.data),
            info,
        )
        return status, tau, info[4]  # behind four integers, sigma_min and residual

    return solve


def test_the_distance_may_be_weighed(tmp_path) -> None:
    solve, rng = _with_more(2, 4, False, True, tmp_path), np.random.default_rng(2)
    limited = 0
    for _ in range(20):
        S, z, y, lower, upper = plain(rng, 2, 4)
        T = np.triu(rng.integers(-2, 3, (4, 4))) + 3 * np.eye(4)
        weight = T.T @ T
        inverse = np.linalg.inv(weight) @ S.T
        start = y + inverse @ np.linalg.solve(S @ inverse, z - S @ y)
        best = truth_of(S, z, y, lower, upper, exact.rational(T))
        if any(best.place):
            status, tau, _ = solve(S, z, y, lower, upper, T)
            plainly = np.linalg.norm(start - tau) > 0
            limited += status >= sg.Status.LIMITED
            if status >= sg.Status.LIMITED and plainly:
                assert np.allclose(tau, exact.nearest(best.x)[:, 0], atol=1e-12)
    assert limited > 5


def test_the_error_dynamics_slow_down_no_more_than_they_must(tmp_path) -> None:
    """S tau = z - (1 - s) z_1 with the largest s, by bisection in rationals; nearest to y there."""
    solve, rng = _with_more(2, 4, True, False, tmp_path), np.random.default_rng(6)
    slowed = stuck = 0
    for _ in range(24):
        S, z, y, lower, upper = plain(rng, 2, 4)
        slow = z * rng.uniform(0.2, 1.0)
        status, tau, scale = solve(S, z, y, lower, upper, slow)
        if status < sg.Status.LIMITED:
            continue
        standstill = truth_of(S, z - slow, y, lower, upper)
        if not standstill.met:
            stuck += 1
            assert scale == 0
            assert status == sg.Status.LIMITED_INCONSISTENT
            assert np.allclose(tau, exact.nearest(standstill.x)[:, 0], atol=1e-12)
            continue
        low, high = flint.fmpq(0), flint.fmpq(1)
        exact_z, exact_slow = exact.rational(z), exact.rational(slow)
        if truth_of(S, z, y, lower, upper).met:
            low = high
        for _ in range(24):
            middle = (low + high) / 2
            sides = [[exact.rational(np.array([v]))[0, 0] for v in side] for side in (lower, upper)]
            met = best_within(exact.rational(S), exact_z - exact_slow * (1 - middle), exact.rational(y), *sides).met
            low, high = (middle, high) if met else (low, middle)
        slowed += scale < 1
        assert status == sg.Status.LIMITED
        assert abs(scale - float(low.p) / float(low.q)) < 2.0**-23
        assert np.allclose(S @ tau, z - (1 - scale) * slow, atol=1e-12)
    assert slowed > 2
    assert stuck > 2


def test_a_row_that_no_control_reaches_may_slow_down(tmp_path) -> None:
    """What it asks for is met at a standstill where it is z_1 alone, and by nothing where it is not."""
    solve, S = _with_more(2, 2, True, False, tmp_path), np.array([[-1.0, 1.0], [0.0, 0.0]])
    low, y = np.ones(2), np.zeros(2)
    status, tau, scale = solve(S, np.array([0.0, -1.0]), y, low, np.array([2.0, 3.0]), np.array([0.0, -1.0]))
    assert (status, scale) == (sg.Status.LIMITED, 0)
    assert np.array_equal(tau, [1, 1])
    S, z, slow = np.array([[-3.0, -1.0], [0.0, 0.0]]), np.array([3.0, 3.0]), np.array([3.0, 0.0])
    status, tau, scale = solve(S, z, np.array([1.0, -1.0]), np.array([-2.0, 0.0]), np.array([-1.0, 2.0]), slow)
    assert (status, scale) == (sg.Status.LIMITED_INCONSISTENT, 0)
    assert np.array_equal(tau, [-1, 2])
