"""The cross-check passes good code and fails each kind of wrong code."""

from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.loading import load_scene
from servogen.verify import check as check_module
from servogen.verify.check import _reference_ulps, check
from servogen.verify.truth import Truth, states_to_check
from servogen.verify.vectors import EntryVectors, OutputVectors
from support.mutate import mutated

STATES = 40


@pytest.mark.parametrize("name", ["double_pendulum_energy", "spacecraft_smooth"])
def test_generated_code_passes(name):
    report = check([load_scene(name)], states=STATES)
    assert report.passed, report.problems
    assert {o.scalar for o in report.outputs} == {"float64", "float32"}
    assert all(o.compared >= STATES for o in report.outputs)
    assert all(o.max_ulps < 20 for o in report.outputs)
    assert all(s.passed and s.solved == STATES for s in report.solves)


@pytest.fixture
def gcc_alone(monkeypatch):
    """Of tests about the truth: test_generated_code_passes is about the compilers."""
    monkeypatch.setattr(check_module, "HOST_COMPILERS", ("gcc",))


def edited(monkeypatch, old, new):
    """Let check build packages whose C has each match of `old` replaced by `new`."""

    def build(scene, out, scalar, core):
        package = sg.build(scene, out, scalar, core=core)
        source = Path(package.path) / f"{package.prefix}.c"
        source.write_text(mutated(source.read_text(), old, new))
        return package

    monkeypatch.setattr(check_module, "build", build)
    monkeypatch.setattr(check_module, "EPSILON", {"float64": 2.0**-52})  # one scalar and one compiler are enough
    monkeypatch.setattr(check_module, "HOST_COMPILERS", ("gcc",))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (r"_cos\(in->q\[0\]\)", "_cos(in->q[0] + 0.25)"),
        (r" \+ (t\d+);", r" - \1;"),
        (r"_cos\(in->q\[1\]\)", "_cos(in->q[0])"),
        (r"in->u\[1\] - in->u\[0\];", "in->u[1] - in->u[0] * 1.0000000000000009;"),  # four ulps
    ],
    ids=["another angle", "flipped sign", "index off by one", "constant off by some ulps"],
)
def test_wrong_code_fails(monkeypatch, old, new):
    edited(monkeypatch, old, new)
    report = check([load_scene("double_pendulum_energy")], states=STATES)
    assert not report.passed
    assert report.problems


def test_an_inaccurate_solve_fails(monkeypatch):
    """tau off by a part in 1e14 is found by the exact solution of the code's own system."""
    edited(monkeypatch, r"scale = target / square;", "scale = target / square * 1.00000000000001;")
    report = check([load_scene("double_pendulum_energy")], states=STATES)
    assert any("the bar is 8" in p for p in report.problems)


@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_truth_compares_nearly_everything_in_the_domain(scalar):
    scene = load_scene("double_pendulum_energy")
    package = sg.build(scene, scalar=scalar)
    states, boundary = states_to_check(scene, STATES)
    vectors = Truth(scene, package.module, states, STATES).vector_set()
    for entry in vectors.entries:
        for output in entry.outputs:
            assert np.all(np.isfinite(output.tolerance[:STATES])), entry.name
            assert np.max(output.tolerance[:STATES]) < 1e6 * np.finfo(scalar).eps * max(output.scale, 1)
    control = next(e for e in vectors.entries if e.name == "control")
    rest = STATES + boundary.index("rest")
    assert control.status[rest] == sg.Status.RANK_DEFICIENT_INCONSISTENT
    assert control.rank[rest] == 0
    nan = STATES + boundary.index("u[1] = nan")
    assert control.status[nan] == sg.Status.NONFINITE


def test_truth_is_the_physics():
    """At 50 digits the pendulum's S and z are u^T G and Theta (E - E_0), which no formula of ours says."""
    scene = load_scene("double_pendulum_energy")
    package = sg.build(scene)
    truth = Truth(scene, package.module, states_to_check(scene, 5)[0], 5)
    for k in range(5):
        u = truth.inputs["u"][k]
        S = [float(v) for v in truth.points[k].values["S"]]
        np.testing.assert_allclose(S, [u[0], u[1] - u[0]], rtol=1e-15)
        psi, z = truth.points[k].values["psi"][0], truth.points[k].values["z"][0]
        assert abs(float(z + psi)) < 1e-40


def test_a_wrong_derivation_fails(monkeypatch):
    """Truth and C come of one derivation; the textbook reference tells when that is wrong."""
    from servogen.derive import servo

    rows = servo._rows

    def flipped(scene, constraint, gauge):
        psi, J, X, prescribed = rows(scene, constraint, gauge)
        return psi, J, -X, prescribed

    monkeypatch.setattr(servo, "_rows", flipped)
    monkeypatch.setattr(check_module, "HOST_COMPILERS", ("gcc",))
    report = check([pulled({"a": lambda q, u: u[0] ** 2 + q[0] * u[1]})], states=STATES)  # derived nowhere before
    assert any("z of the textbook formulas" in p for p in report.problems)


def pulled(rows, solver=None):
    """Two masses on a line, pulled by two forces; `rows` of Nonholonomic constraints on their speeds."""
    q, u, tau = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau", 2)
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=ca.diag(ca.DM([2, 3])), P=-q, G=ca.DM.eye(2))
    constraints = [sg.Nonholonomic(name, psi(q, u), -1.0) for name, psi in rows.items()]
    return sg.Scene("pulled", mech, constraints, solver=solver or sg.Solver(), domain={"q": (-1, 1), "u": (0.1, 1)})


def test_duplicate_rows_are_checked_against_the_truncated_solution(gcc_alone):
    scene = pulled({"a": lambda q, u: u[0] ** 2 + u[1], "b": lambda q, u: 3 * (u[0] ** 2 + u[1])})
    report = check([scene], states=STATES)
    assert report.passed, report.problems
    assert all(o.compared > STATES for o in report.outputs if o.output == "tau")


def test_a_damped_solver_is_checked_against_the_damped_solution(gcc_alone):
    rows = {"a": lambda q, u: u[0] ** 2, "b": lambda q, u: u[0] + 0.1 * u[1] ** 2}
    report = check([pulled(rows, sg.Solver(damping=0.05))], states=STATES)
    assert report.passed, report.problems
    assert all(o.compared > STATES for o in report.outputs if o.output == "tau")


def test_a_row_within_its_atol_is_zero_to_the_truth_as_well(gcc_alone):
    rows = {"a": lambda q, u: u[0] ** 2 + u[1], "b": lambda q, u: 1e-6 * (u[0] + u[1] ** 2)}
    report = check([pulled(rows, sg.Solver(atol=[0.0, 1e-5]))], states=STATES)
    assert report.passed, report.problems
    assert all(o.compared > STATES for o in report.outputs if o.output == "S_pinv")


@pytest.mark.parametrize("states", [30])
def test_same_vectors_on_the_emulated_cortex_m4(need_target, states):
    need_target("cortex-m4", "gcc")
    report = check([load_scene("spacecraft")], "cortex-m4", states=states)
    assert report.passed, report.problems
    assert {o.target for o in report.outputs} == {"gcc", "cortex-m4"}
    assert report.differences
    # no libm in this scene: every bit must agree
    assert all(d.different == 0 and d.statuses_differ == 0 for d in report.differences)


def test_a_tau_of_another_rank_says_nothing_of_the_formulas(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dependent rows (an overhead crane's) may become independent by the reference's own rounding: tau 1e17."""
    taus = [(np.array([1.0, 2.0]), 1), (np.array([-3e17, 2.0]), 2)]
    calls = iter(taus)
    twin = SimpleNamespace(
        dtype=np.dtype(float),
        system=lambda inputs: (0, {}),
        control=lambda q: SimpleNamespace(value=(pair := next(calls))[0], info=SimpleNamespace(rank=pair[1])),
    )
    monkeypatch.setattr("servogen.verify.check.reference", lambda scene, scalar: twin)
    answer = OutputVectors.of("tau", np.array([[1.0, 2.0]] * 2), 1e-9, 2.0, "float64")
    entry = EntryVectors("control", "control", (answer,), np.array([2, 2]), np.array([1, 1]), domain=2)
    system = SimpleNamespace(constraint="psi", matrix="S", right="z", answer="tau")
    case = SimpleNamespace(
        scene=SimpleNamespace(system=system),
        scalar="float64",
        truth=SimpleNamespace(drawn=2, inputs={"q": np.zeros((2, 1))}),
        vectors=SimpleNamespace(entries=(entry,)),
    )
    assert _reference_ulps(case) == {"tau": 0.0}  # type: ignore[arg-type]
