"""Solving with Q: the way that is chosen, its answer, and what happens where Q is singular."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.compiler import derived_scene
from servogen.derive.formulation import MassFindings
from servogen.derive.lower import lower_model
from servogen.derive.mass import solve_with_mass
from servogen.derive.plant import derive_plant
from servogen.ir.evaluate import evaluate
from servogen.ir.lower import lower_expressions
from servogen.ir.program import Input
from servogen.optimise.passes import optimise
from servogen.scene.samples import draw_samples
from servogen.survey.definiteness import survey_mass
from support.models import MASSES, random_model, random_scene

METHOD = {
    "identity": "identity",
    "diagonal": "diagonal",
    "spd": "LDL^T",
    "nonsymmetric": "pivoted LU",
    "indefinite": "pivoted LU",
    "exchange": "pivoted LU",
}

q, u, tau = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau", 2)
par = sg.Parameters(a=2.0, b=0.5)


def small(Q: Any, domain: Any = None, psi: Any = None) -> sg.Scene:
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=Q, P=ca.vertcat(-q[0], 0.3), G=ca.DM.eye(2))
    task = u[0] + 0.5 * u[1] if psi is None else psi
    return sg.Scene("small", mech, [sg.Nonholonomic("task", task, -1.0)], parameters=par, domain=domain)


def found(scene: sg.Scene) -> MassFindings:
    return survey_mass(draw_samples(scene), lower_model(scene))


def entries(a: Any, b: Any, c: Any, d: Any) -> Any:
    return ca.vertcat(ca.horzcat(a, b), ca.horzcat(c, d))


@pytest.mark.parametrize("mass", MASSES)
def test_the_way_that_is_chosen(mass: str) -> None:
    for seed in range(3):
        formulation = derived_scene(random_scene(seed, "nonholonomic", mass=mass))[0]
        assert formulation.mass.method == METHOD[mass]


@pytest.mark.parametrize(
    ("mass", "n"),
    [(mass, n) for mass in MASSES for n in (1, 2, 4) if n > 1 or mass not in ("exchange", "nonsymmetric")],
)
@pytest.mark.parametrize("transposed", [False, True])
def test_the_solution_solves(mass: str, n: int, transposed: bool) -> None:
    scene_model = random_model(5, n, n, mass)
    mech = scene_model.mechanism
    scene = sg.Scene(
        "solve", mech, [sg.Nonholonomic("all", mech.u, -1.0)], scene_model.parameters, scene_model.references
    )
    right = ca.SX.sym("b", n, 3)
    solution, _ = solve_with_mass(scene, found(scene), right, transposed)
    inputs = [(Input("q", mech.q.size1()), mech.q), (Input("t", 1), mech.t), (Input("b", 3 * n), ca.vec(right))]
    program = optimise(lower_expressions("solve", inputs, [("x", solution), ("Q", mech.Q)]))
    rng = np.random.default_rng(0)
    states = {
        "q": rng.uniform(-3, 3, (20, mech.q.size1())),
        "t": rng.uniform(0, 3, (20, 1)),
        "b": rng.normal(size=(20, 3 * n)),
    }
    values = evaluate(program, states)
    for k in range(20):
        Q = values["Q"][k].T if transposed else values["Q"][k]
        b = states["b"][k].reshape(3, n).T
        np.testing.assert_allclose(Q @ values["x"][k], b, atol=1e-9 * np.linalg.cond(Q))


def test_equal_numbers_are_no_proof() -> None:
    """Symmetric at every number one can draw, but not as written: the way that is right for both is taken."""
    Q = entries(4, q[0], ca.fabs(q[0]), 4)
    assert derived_scene(small(Q, {"q": (0.1, 1.0)}))[0].mass.method == "pivoted LU"
    assert derived_scene(small(entries(4, q[0], q[0], 4), {"q": (0.1, 1.0)}))[0].mass.method == "LDL^T"


def test_definiteness_is_judged_over_the_domain() -> None:
    Q = entries(q[0], 0.1, 0.1, 1)
    assert derived_scene(small(Q, {"q": (0.5, 1.0)}))[0].mass.method == "LDL^T"
    assert derived_scene(small(Q, {"q": (-1.0, 1.0)}))[0].mass.method == "pivoted LU"


def test_q_that_is_nan_somewhere_in_the_domain() -> None:
    Q = entries(2 + ca.sqrt(q[0]), 0.1, 0.1, 2)
    assert derived_scene(small(Q, {"q": (-1.0, 1.0)}))[0].mass.method == "pivoted LU"


def test_identity_and_diagonal_leave_no_solve() -> None:
    assert derived_scene(small(ca.DM.eye(2)))[0].mass.pivots == ()
    diagonal = derived_scene(small(ca.diag(ca.vertcat(par.a, 3.0))))[0]
    assert diagonal.mass.method == "diagonal"
    assert len(diagonal.mass.pivots) == 1  # the constant one is judged already
    assert derived_scene(small(ca.diag(ca.vertcat(-2.0, 3.0))))[0].mass.pivots == ()


def test_constant_mass_of_either_sign() -> None:
    for Q in ([[2.0, 1.0], [1.0, 2.0]], [[0.0, 1.0], [1.0, 0.0]], [[1.0, 2.0], [2.0, 1.0]], [[0.0, -2.0], [3.0, 0.0]]):
        wanted = np.linalg.solve(np.array(Q).T, [1.0, 0.5])
        rounding = 16 * 2.0**-52 * np.linalg.cond(Q) * np.abs(wanted).max()  # eliminations in unlike orders
        program_S = sg.reference(small(ca.DM(Q))).S(q=[0, 0], u=[0, 0])
        S = sg.build(small(ca.DM(Q))).load(flags=["-O0"]).S(q=[0, 0], u=[0, 0])
        np.testing.assert_allclose(S, program_S, rtol=0, atol=rounding)
        np.testing.assert_allclose(S.ravel(), wanted, rtol=0, atol=rounding)


# ---- singular at run time ----


def run(scene: sg.Scene) -> tuple[Any, Any]:
    return sg.build(scene).load(flags=["-O0"]), sg.reference(scene)


@pytest.mark.parametrize(
    ("Q", "bad", "good"),
    [
        (ca.diag(ca.vertcat(q[0], 1)), [0.0, 0.0], [0.5, 0.0]),
        (entries(1, q[0], q[0], 1), [1.0, 0.0], [0.5, 0.0]),
        (entries(1 + q[1], q[0], q[0], 1), [1.0, 0.0], [0.5, 0.0]),
        (entries(q[0], 1, 0, q[1]), [0.0, 1.0], [1.0, 1.0]),
        (entries(q[0], 1, 2, q[1]), [1.0, 2.0], [0.0, 0.0]),
        (entries(0, 1, q[0], 0), [0.0, 0.0], [-2.0, 0.0]),
    ],
)
def test_singular_mass_at_a_state(Q: Any, bad: list[float], good: list[float]) -> None:
    scene = small(Q, {"q": (-0.9, 0.9)})
    for twin in run(scene):
        answer = twin.control(q=bad, u=[1, 1], last=[7.0, 8.0])
        assert answer.info.status == sg.Status.SINGULAR_MASS
        assert answer.value.tolist() == [7.0, 8.0]
        assert np.isnan(twin.S(q=bad, u=[1, 1])).all()
        assert np.isnan(twin.z(q=bad, u=[1, 1])).all()
        assert np.isfinite(twin.psi(q=bad, u=[1, 1])).all()
        assert twin.control(q=good, u=[1, 1]).info.status == sg.Status.OK


@pytest.mark.parametrize("Q", [entries(q[0] ** 2, q[0], q[0], 2), entries(0, q[0], 1, 0)])
def test_singular_mass_at_the_first_pivot(Q: Any) -> None:
    """At q = 0 the status is SINGULAR_MASS, whichever pivot tells."""
    compiled, reference = run(small(Q))
    assert reference.control(q=[0.0, 0.0], u=[1, 1]).info.status == sg.Status.SINGULAR_MASS
    assert compiled.control(q=[0.0, 0.0], u=[1, 1]).info.status == sg.Status.SINGULAR_MASS


def test_nearly_singular_mass_is_singular_to_working_precision() -> None:
    scene = small(entries(1, q[0], q[0], 1), {"q": (-0.9, 0.9)})
    for scalar, gap in (("float64", 1e-17), ("float32", 1e-9)):
        twin = sg.build(scene, scalar=scalar).load(flags=["-O0"])  # type: ignore[arg-type]
        assert twin.control(q=[1.0 - gap, 0], u=[1, 1]).info.status == sg.Status.SINGULAR_MASS
        assert twin.control(q=[0.999, 0], u=[1, 1]).info.status == sg.Status.OK


def test_small_masses_are_not_singular() -> None:
    """Pivots are judged against their own scale: units do not matter."""
    for scale in (1e-30, 1e30):
        Q = entries(2 * par.a, q[0], q[0], 2) * scale
        compiled, reference = run(small(Q, {"q": (-1.0, 1.0)}))
        for twin in (compiled, reference):
            assert twin.control(q=[0.5, 0], u=[1, 1]).info.status == sg.Status.OK


@pytest.mark.parametrize(
    ("Q", "bad"),
    [
        (ca.diag(ca.vertcat(par.a, 1)), 0.0),
        (entries(1, par.a / 4, par.a / 4, 1), 4.0),
        (entries(par.a / 4 - 1, 1, 1, par.a / 4 - 1), 8.0),
    ],
)
def test_singular_mass_of_parameters_is_told_by_prepare(Q: Any, bad: float) -> None:
    scene = small(Q)
    state = {"q": [0.1, 0.2], "u": [1.0, -1.0]}
    answers = []
    for twin in run(scene):
        before = twin.control(**state).value
        assert twin.prepare(a=bad) == sg.Status.SINGULAR_MASS
        np.testing.assert_array_equal(twin.control(**state).value, before)  # the model is as it was
        assert twin.prepare(a=1.0) == sg.Status.OK
        answers.append(twin.control(**state).value)
        assert not np.array_equal(answers[-1], before)
    np.testing.assert_allclose(*answers, rtol=1e-13)


# ---- the plant ----


@pytest.mark.parametrize("mass", MASSES)
def test_plant_is_the_mechanism(mass: str) -> None:
    scene = random_scene(4, "nonholonomic", mass=mass)
    quantities, _ = derive_plant(scene, found(scene))
    assert [q.name for q in quantities] == ["q_dot", "u_dot"]
    mech = scene.mechanism
    symbols = [f.symbol for f in scene.input_fields()] + [mech.tau] + [f.symbol for f in scene.parameters or ()]
    parts = [q.expression for q in quantities] + [mech.q_dot, mech.Q, mech.P, mech.G]
    function = ca.Function("plant", symbols, [ca.densify(p) for p in parts])
    rng = np.random.default_rng(0)
    values = [rng.uniform(-1, 1, s.size1()) for s in symbols]
    q_dot, u_dot, given, Q, P, G = (v.full() for v in function.call([ca.DM(v) for v in values]))
    np.testing.assert_allclose(q_dot, given, rtol=1e-14)
    force = values[len(scene.input_fields())].reshape(-1, 1)
    np.testing.assert_allclose(Q @ u_dot, P + G @ force, rtol=1e-9, atol=1e-9)
