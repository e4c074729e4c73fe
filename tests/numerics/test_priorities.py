"""Priorities against exact rationals: the optimum of every level, ranks, and what a scene of one level keeps."""

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen import exact
from servogen.exact_levels import lexicographic, switched
from servogen.loading import load_scene
from servogen.scalars import EPSILON
from servogen.scene.domain import draw_states
from servogen.simulate.claim import claim_of
from servogen.simulate.simulation import moving_references, start_values
from servogen.twins.compiled import CompiledTwin
from servogen.verify.answers import amplification
from servogen.verify.check import check

TAU_BAR, OPTIMUM_BAR = 8.0, 4.0
"""Of tau off the truth, and of the first level's |S tau - z| above the least, over eps, what levels make of kappa and
the sizes in play."""


def given(levels: tuple[int, ...], l: int, switched: tuple[int, ...] = (), **more) -> sg.Scene:
    """A scene whose S and z are its inputs A and b: psi = A u - b with Theta = -1, at u = 0. switched: these levels."""
    m = sum(levels)
    ref = sg.References(A=[0.0] * (m * l), b=[0.0] * m)
    u = ca.SX.sym("u", l)
    rows = ca.reshape(ref.A, l, m).T @ u - ref.b
    ends = np.cumsum((0, *levels))
    constraints = [
        sg.Nonholonomic(f"l{k}", rows[a:b], Theta=-1.0, priority=3 * k - 5, active="input" if k in switched else None)
        for k, (a, b) in enumerate(pairwise(ends))
    ]
    body = sg.Mechanism(
        q=ca.SX.sym("q", l), u=u, tau=ca.SX.sym("tau", l), Q=ca.SX.eye(l), P=ca.SX.zeros(l), G=ca.SX.eye(l)
    )
    return sg.Scene("given", body, constraints, references=ref, y="input", domain={"A": (-1, 1), "b": (-1, 1)}, **more)


@lru_cache
def twin(levels: tuple[int, ...], l: int, scalar: str, switched: tuple[int, ...] = ()) -> CompiledTwin:
    return sg.build(given(levels, l, switched), scalar=scalar).load()


def asked(A: np.ndarray, b: np.ndarray, y: np.ndarray) -> dict[str, np.ndarray]:
    nothing = np.zeros(A.shape[1])
    return {"q": nothing, "u": nothing, "A": A.ravel(), "b": b, "y": y}


def system(r: np.random.Generator, levels: tuple[int, ...], l: int, close: float) -> tuple[np.ndarray, ...]:
    """A, b, y: random, small integers, of low rank, in unlike units, later levels near the first, y far away."""
    m, first, kind = sum(levels), levels[0], r.integers(7)
    A, b, y = r.standard_normal((m, l)), r.standard_normal(m), r.standard_normal(l)
    if kind == 1:  # ties, dependent and contradicting rows
        A, b = r.integers(-2, 3, (m, l)), r.integers(-3, 4, m)
    elif kind == 2:
        A = r.integers(-3, 4, (m, 2)) @ r.integers(-3, 4, (2, l))
    elif kind == 3:
        A = A * 10.0 ** r.uniform(-8, 8, (m, 1))
        b = b * np.linalg.norm(A, axis=1)
    elif kind == 4:
        A[first:] = r.integers(-2, 3, (m - first, first)) @ A[:first] + 10.0 ** r.uniform(close, 0) * A[first:]
    elif kind == 5:
        y = y * 1e6
    elif kind == 6:
        A = np.where(r.random((m, l)) < 0.5, 0.0, A)
    return A, b, y


@pytest.mark.parametrize("scalar", ["float64", "float32"])
@pytest.mark.parametrize(("levels", "l"), [((2, 2, 2), 5), ((3, 4), 4)])
def test_the_lexicographic_optimum(levels: tuple[int, ...], l: int, scalar: str) -> None:
    """Of random systems, rank-deficient and conflicting ones among them, with the exact ranks of all levels."""
    r, real, eps = np.random.default_rng(11), np.dtype(scalar).type, EPSILON[scalar]
    ends = np.cumsum((0, *levels))
    rows = [list(range(a, b)) for a, b in pairwise(ends)]
    kept = set()
    for _ in range(120):
        A, b, y = (v.astype(real).astype(float) for v in system(r, levels, l, -9 if scalar == "float64" else -3))
        answer = twin(levels, l, scalar).control(**asked(A, b, y))
        best = lexicographic(exact.rational(A), exact.rational(b), exact.rational(y), rows)
        info, truth = answer.info, exact.nearest(best.x)[:, 0]
        assert info.level_rank == list(best.ranks)
        assert info.rank == sum(best.ranks)
        kept.add(best.ranks)
        length = np.where(np.linalg.norm(A, axis=1) > 0, np.linalg.norm(A, axis=1), 1.0)
        factor = amplification(A, rows, best.ranks)
        missed = (b - A @ truth) / length
        size = np.linalg.norm(truth) + np.linalg.norm(y) + np.max(np.abs(b) / length)
        error = np.linalg.norm(exact.difference(answer.value, best.x))
        assert error <= TAU_BAR * eps * factor * (size + factor * np.max(np.abs(missed)))
        for k, own in enumerate(rows):
            left = float(np.linalg.norm(b[own] - A[own] @ answer.value.astype(float)))
            assert np.isclose(info.level_residual[k], left, rtol=1e-3, atol=8 * eps * np.max(length[own]) * size)
        own = rows[0]
        least = np.linalg.norm(b[own] - A[own] @ truth)
        above = np.linalg.norm(b[own] - A[own] @ answer.value.astype(float)) - least
        assert above <= OPTIMUM_BAR * eps * np.linalg.norm(A[own]) * (size + factor * np.max(np.abs(missed)))
        met = np.max(np.abs(missed[own])) == 0 or least <= 1e-9 * np.linalg.norm(A[own]) * size
        deficient = sg.Status.RANK_DEFICIENT_CONSISTENT if met else sg.Status.RANK_DEFICIENT_INCONSISTENT
        assert info.status == (sg.Status.OK if best.ranks[0] == len(own) else deficient)
    assert len(kept) >= 3


VARIANTS = {
    "weight": {"weight": np.diag([1.0, 2.0, 3.0]) + 0.3},
    "damped": {"solver": sg.Solver(damping=0.7)},
    "raw": {"solver": sg.Solver(rank="raw", method="svd")},
}


@pytest.mark.parametrize("name", VARIANTS)
def test_weights_damping_and_raw_ranks_are_the_textbooks(name: str) -> None:
    """At each level: W's metric, singular values below eps_d damped, the rank by S as it is."""
    scene = given((2, 2), 3, **VARIANTS[name])
    code, reference = sg.build(scene).load(), sg.reference(scene)
    r, said = np.random.default_rng(2), set()
    for _ in range(60):
        A, b, y = r.integers(-2, 3, (4, 3)) / 2, r.standard_normal(4), r.standard_normal(3)
        a, c = code.control(**asked(A, b, y)), reference.control(**asked(A, b, y))
        assert a.info.status == c.info.status
        assert a.info.level_rank == c.info.level_rank
        assert np.allclose(a.info.level_residual, c.info.level_residual, atol=1e-12)
        assert np.allclose(a.value, c.value, rtol=0, atol=1e-12 * (1 + np.max(np.abs(c.value))))
        assert 0.7 * c.info.sigma_min * (1 - 1e-9) <= a.info.sigma_min <= c.info.sigma_min * (1 + 1e-12) + 1e-15
        said.add(a.info.status)
    assert {sg.Status.OK, sg.Status.REGULARISED if name == "damped" else sg.Status.RANK_DEFICIENT_INCONSISTENT} <= said


@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_a_cascade_of_projections_on_the_iiwa(scalar: str) -> None:
    """Its end over six wishes for its joints, by Siciliano and Slotine's recursion with numpy's pseudo-inverses."""
    code, wishes = twin((3, 6), 7, scalar), np.linalg.qr(np.random.default_rng(0).standard_normal((7, 6)))[0].T
    for S, z in iiwa():
        A = np.vstack([S, wishes]).astype(scalar).astype(float)
        b = np.concatenate([z, np.sin(np.arange(6))]).astype(scalar).astype(float)
        tau, projector = np.zeros(7), np.eye(7)
        for own in (slice(0, 3), slice(3, 9)):
            inverse = np.linalg.pinv(A[own] @ projector, rcond=1e-10)
            tau = tau + inverse @ (b[own] - A[own] @ tau)
            projector = projector - inverse @ A[own] @ projector
        answer = code.control(**asked(A, b, np.zeros(7)))
        assert answer.info.level_rank == [3, 4]
        factor = amplification(A, [range(3), range(3, 9)], [3, 4])
        assert np.linalg.norm(answer.value - tau) <= TAU_BAR * EPSILON[scalar] * factor**2 * np.linalg.norm(tau)


@lru_cache
def iiwa() -> list[tuple[np.ndarray, np.ndarray]]:
    robot = load_scene("iiwa_position")
    states, code = draw_states(robot, 10), sg.reference(robot)
    each = [{n: v[k] for n, v in states.items()} for k in range(10)]
    return [(code.S(**state), code.z(**state)) for state in each]


@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_out_at_0_and_in_at_1_to_the_last_bit(scalar: str) -> None:
    """Without its constraint, or as if it could not go; beyond 0 and 1 as at them."""
    r, nothing = np.random.default_rng(4), np.zeros(5)
    whole, coming = twin((2, 2, 2), 5, scalar), twin((2, 2, 2), 5, scalar, (0, 1))
    fewer = sg.build(given((2, 2), 5), scalar=scalar).load()
    for _ in range(20):
        A, b, y = r.standard_normal((6, 5)), r.standard_normal(6), r.standard_normal(5)
        plain = whole.control(**asked(A, b, y))
        for a in (1.0, 1.5, 1e30):
            same = coming.control(**asked(A, b, y), l0_active=a, l1_active=1.0)
            assert same.value.tobytes() == plain.value.tobytes()
            assert same.info == plain.info
        for gone, kept in ((0, slice(2, 6)), (1, [0, 1, 4, 5])):
            without = fewer.control(**asked(A[kept], b[kept], y))
            for a in (0.0, -0.5):
                same = coming.control(**asked(A, b, y), **{f"l{gone}_active": a})
                assert same.value.tobytes() == without.value.tobytes()
                assert (same.info.status, same.info.rank) == (without.info.status, without.info.rank)
                assert same.info.level_rank == [*without.info.level_rank[:gone], 0, *without.info.level_rank[gone:]]
                assert same.info.residual == without.info.residual
    refused = coming.control(q=nothing, u=nothing, l1_active=np.nan)
    assert refused.info.status == sg.Status.NONFINITE


def test_in_between_and_on_the_way() -> None:
    """The exact answer for three constraints that move at once, and no jump on a path through 0 and 1."""
    r, levels = np.random.default_rng(8), ((0, 1), (2, 3), (4, 5))
    code = twin((2, 2, 2), 5, "float64", (0, 1, 2))
    A, b, y = r.standard_normal((6, 5)), r.standard_normal(6), r.standard_normal(5)

    def at(t: float) -> np.ndarray:
        return np.clip(0.5 + 0.8 * np.sin([5 * t, 7 * t + 1, 3 * t + 2]), 0.0, 1.0)

    for t in np.linspace(0, 2, 15):
        part = at(t)
        answer = code.control(**asked(A, b, y), **{f"l{k}_active": a for k, a in enumerate(part)})
        best = switched(
            *(exact.rational(v) for v in (A, b, y)), levels, [(own, a) for own, a in zip(levels, part, strict=True)]
        )
        assert np.allclose(answer.value, exact.nearest(best.x)[:, 0], rtol=0, atol=1e-12)
    steps = []
    for count in (500, 5000):
        active = np.array([at(t) for t in np.linspace(0, 2, count)])
        path = code.control_batch(
            **{n: v if n in ("A", "b", "y") else np.zeros((count, 5)) for n, v in asked(A, b, y).items()},
            **{f"l{k}_active": active[:, k] for k in range(3)},
        )
        steps.append(np.max(np.abs(np.diff(path.value, axis=0))))
    assert {0.0, 1.0} <= set(active[:, 0])
    assert steps[1] < 0.12 * steps[0], "the largest step of tau does not shrink with the path's"


def test_one_priority_is_none(tmp_path) -> None:
    """The same bytes, whatever its number."""
    plain = load_scene("double_pendulum_energy")
    (held,) = plain.constraints
    numbered = replace(plain, constraints=[replace(held, priority=7)])
    assert plain.levels == numbered.levels == ((0,),)
    folders = [sg.build(s, tmp_path / str(k)).path for k, s in enumerate((plain, numbered))]
    one, other = ({f.name: f.read_bytes() for f in folder.iterdir()} for folder in folders)
    assert one == other


def small(**more) -> sg.Scene:
    """Two rows, then one, then two, for three controls; written in another order."""
    q, u, tau = ca.SX.sym("q", 3), ca.SX.sym("u", 3), ca.SX.sym("tau", 3)
    body = sg.Mechanism(
        q=q,
        u=u,
        tau=tau,
        Q=ca.diag([1, 2, 3]),
        P=ca.vertcat(0, ca.sin(q[1]), 0),
        G=[[1, 0, 0.5], [0, 1, 0], [0.2, 1, 1]],
    )
    constraints = [
        sg.Nonholonomic("still", u[1:], Theta=-2.0, priority=9),
        sg.Holonomic("end", ca.vertcat(q[0] + ca.cos(q[1]), q[2] - q[0]), Theta1=-4.0, Theta2=-4.0, active="input"),
        sg.Nonholonomic("speed", u[0] * u[1] + u[0] - 0.3, Theta=-1.0, priority=1, active="input"),
    ]
    return sg.Scene("small", body, constraints, domain={"q": (-1, 1), "u": (-1, 1)}, **more)


def test_a_scene_with_priorities_passes_its_check() -> None:
    """Boundary states, both scalars and compilers, in the metric of a weight; constraints that come and go."""
    report = check([small(weight=np.diag([1.0, 2.0, 3.0]) + 0.3, y="input")], states=6)
    assert report.passed, report.problems
    assert all(s.solved for s in report.solves)


def test_a_batch_and_a_refusal_tell_of_levels() -> None:
    scene = small()
    assert scene.levels == ((2, 3), (4,), (0, 1))
    states = {n: v[:5] for n, v in draw_states(scene, 5).items()}
    for code in (sg.build(scene).load(), sg.reference(scene)):
        batch = code.control_batch(**states)
        assert batch.level_rank.shape == batch.level_residual.shape == (5, 3)
        states |= {"end_active": [1.0], "speed_active": [1.0]}
        batch = code.control_batch(**states)
        one = code.control(**{n: v[2] for n, v in states.items() if n[-6:] != "active"})  # 1 is the default
        assert batch[2].info == one.info
        assert one.info.level_rank == [2, 1, 0]
        assert one.info.status == sg.Status.OK
        assert max(one.info.level_residual[:2]) < 1e-13 < one.info.level_residual[2]
        refused = code.control(q=[0, 0, 0], u=[0, 0, np.nan])
        assert refused.info.level_rank == refused.info.level_residual == [0, 0, 0]


def test_a_simulation_moves_an_activation_and_claims_the_first_level() -> None:
    scene = small()
    run = sg.Simulation(references={"end_active": lambda t: ca.tanh(t), "speed_active": 0.5})
    assert start_values(scene, run)["speed_active"] == 0.5
    t = ca.SX.sym("t")
    assert ca.depends_on(moving_references(scene, run, t)["end_active"], t)
    still = replace(scene, constraints=[replace(c, active=None) for c in scene.constraints])
    assert np.isfinite(claim_of(still, sg.Simulation(), {}).tolerance).tolist() == [False, False, True, True, False]
    assert not np.isfinite(claim_of(scene, sg.Simulation(), {}).tolerance).any()


def test_priorities_that_make_no_sense() -> None:
    u, tau = ca.SX.sym("u", 2), ca.SX.sym("tau", 2)
    body = sg.Mechanism(q=ca.SX.sym("q", 2), u=u, tau=tau, Q=ca.SX.eye(2), P=ca.SX.zeros(2), G=ca.SX.eye(2))
    for wrong in (1.5, True, "high", None):
        with pytest.raises(sg.SceneError, match=r"'a': priority=.*; give an integer, the lower the more important"):
            sg.Nonholonomic("a", u[0], Theta=-1, priority=wrong)
    two = [sg.Nonholonomic("a", u[0], Theta=-1), sg.Nonholonomic("b", u[1], Theta=-1, priority=1)]
    with pytest.raises(sg.SceneError, match="mode='ideal' takes all constraints alike"):
        sg.Scene("s", body, two, mode="ideal")
    with pytest.raises(sg.SceneError, match=r"Solver\(method='cod'\) and priorities"):
        sg.Scene("s", body, two, solver=sg.Solver(method="cod"))
    with pytest.raises(sg.SceneError, match="with priorities or with active='input' is not built; leave out sigma_min"):
        sg.Scene("s", body, two, solver=sg.Solver(sigma_min="exact"))
    with pytest.raises(sg.SceneError, match="limits with priorities or with active='input' are not built"):
        sg.Scene("s", body, two, limits=sg.Limits(-1, 1))
    with pytest.raises(sg.SceneError, match="with priorities or active='input' is not built; leave out core"):
        sg.build(sg.Scene("s", body, two), core="servogen_core")


def test_activations_that_make_no_sense() -> None:
    u, tau = ca.SX.sym("u", 2), ca.SX.sym("tau", 2)
    body = sg.Mechanism(q=ca.SX.sym("q", 2), u=u, tau=tau, Q=ca.SX.eye(2), P=ca.SX.zeros(2), G=ca.SX.eye(2))
    with pytest.raises(sg.SceneError, match=r"active=0\.5; give 'input' for the input a_active"):
        sg.Nonholonomic("a", u[0], Theta=-1, active=0.5)
    with pytest.raises(sg.SceneError, match="'the end': the input 'the end_active' is not a C identifier"):
        sg.Nonholonomic("the end", u[0], Theta=-1, active="input")
    coming = [sg.Nonholonomic(f"c{k}", u[k % 2], Theta=-1, active="input") for k in range(5)]
    with pytest.raises(sg.SceneError, match="5 constraints with active='input'; there may be 4"):
        sg.Scene("s", body, coming)
    with pytest.raises(sg.SceneError, match="brings the input c0_active, but a parameter or reference has that name"):
        sg.Scene("s", body, coming[:1], parameters=sg.Parameters(c0_active=1.0))
    with pytest.raises(sg.SceneError, match="mode='ideal' takes all constraints alike"):
        sg.Scene("s", body, coming[:1], mode="ideal")
