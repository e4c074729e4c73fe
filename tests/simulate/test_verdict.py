"""Every verdict, by a scene that earns it; and that a loop which tips over is never held."""

import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.simulate.claim import claim_of
from servogen.simulate.closed_loop import ClosedLoop, simulate
from servogen.simulate.simulation import check_simulation, units_of_entries, with_units_of_rates
from servogen.simulate.trajectory import Stop
from servogen.simulate.verdict import judge
from servogen.simulate.wanted import load_simulation


def inverted(domain: object = None) -> sg.Scene:
    """A wheeled pendulum whose wheel is held in its place: psi decays to the last bit while the body tips over."""
    par = sg.Parameters(M=1.0, m=5.0, L=0.4, r=0.1, g=9.81, J=0.3)
    q, u, tau = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau")
    pull = par.m * par.L
    Q = ca.vertcat(
        ca.horzcat(1.5 * par.M + par.m, pull * ca.cos(q[1])), ca.horzcat(pull * ca.cos(q[1]), pull * par.L + par.J)
    )
    P = ca.vertcat(pull * u[1] ** 2 * ca.sin(q[1]), pull * par.g * ca.sin(q[1]))
    return sg.Scene(
        "inverted",
        sg.Mechanism(q=q, u=u, tau=tau, Q=Q, P=P, G=ca.vertcat(1 / par.r, -1)),
        [sg.Holonomic("where", q[0], Theta1=-2.0, Theta2=-1.0)],
        parameters=par,
        domain=domain,
    )


def box(generator: np.random.Generator) -> dict[str, np.ndarray]:
    return {"q": generator.uniform([-1, -0.5], [1, 0.5]), "u": generator.uniform(-1, 1, 2)}


FALLS = sg.Simulation(start={"q": [0.3, 0.02], "u": [0, 0]}, duration=5.0)


@pytest.fixture(scope="module")
def falls() -> ClosedLoop:
    return ClosedLoop(inverted({"q": ([-1, -0.5], [1, 0.5]), "u": (-1, 1)}), FALLS)


@pytest.fixture(scope="module")
def fallen(falls):
    """The run of a body that tips over, with its rows."""
    return falls.run()


def test_a_loop_that_tips_over_is_never_held(fallen):
    assert fallen.stop.reason == "finished"
    assert fallen.constraint_error[0] < 1e-12
    assert set(fallen.status) == {0}
    assert fallen.verdict.word == "left the domain"
    assert not fallen.verdict.held
    assert "u[1] left the range -1.5 to 1.5 (the scene's domain" in fallen.verdict.reason
    assert "motion that they leave free" in fallen.verdict.advice


@pytest.mark.parametrize(
    "domain",
    [
        None,
        box,
        {"q": ([-1, -0.5], [1, 0.5])},
        {"u": (-1, 1)},
        {"q": (-2.5, 2.5), "u": (-30, 30)},  # generous, but no body stands on its head
    ],
    ids=["no domain", "callable", "q alone", "u alone", "wide"],
)
@pytest.mark.parametrize("lean", [0.02, -1e-6, 1.0])
def test_nor_however_its_domain_is_stated(falls, domain, lean):
    """From a lean that takes long to fall, and from one beyond saving."""
    run = falls.run(start={"q": [0, lean]})
    claim = claim_of(inverted(domain), FALLS, run.parameters)
    assert judge(replace(run, claim=claim)).word == "left the domain"


def test_nor_where_it_is_cut_short_or_stopped(fallen):
    """Cut anywhere after it left, or with the end called by another name, the word stays."""
    left = int(np.argmax(np.abs(fallen.u[:, 1]) > 1.5))
    for end in (left + 1, left + 100, len(fallen.t)):
        for stop in (Stop("finished", fallen.t[end - 1]), Stop("event", fallen.t[end - 1], "by hand")):
            assert _cut(fallen, end, stop).verdict.word == "left the domain"
    assert _cut(fallen, left, Stop("finished", fallen.t[left - 1])).verdict.held  # it has not, yet


def _cut(run, end, stop):
    rows = ("t", "q", "u", "tau", "constraint", "ideal", "status", "rank", "sigma_min")
    return replace(run, stop=stop, **{name: getattr(run, name)[:end] for name in rows})


def oscillator(Theta: float = -1.0, domain: object = None, **options: object) -> sg.Scene:
    """One mass, one force: u decays as Theta says."""
    q, u, tau = ca.SX.sym("q"), ca.SX.sym("u"), ca.SX.sym("tau")
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=1, P=-4 * q, G=1)
    return sg.Scene("oscillator", mech, [sg.Nonholonomic("rest", u, Theta=Theta)], domain=domain, **options)


def test_held_says_how_well():
    verdict = simulate(oscillator(), sg.Simulation(start={"q": 0, "u": 1}, duration=3.0, units={"psi": "m/s"})).verdict
    assert verdict.held
    assert str(verdict) == "held"
    assert "constraint 'rest' was off its prescribed decay by at most" in verdict.reason.lower()
    assert " m/s, at t = " in verdict.reason
    assert "no domain of q" in verdict.reason


def test_the_tolerance_is_the_users():
    scene = oscillator()
    run = {"start": {"q": 0, "u": 1}, "duration": 1.0, "step": 0.25}
    error = simulate(scene, sg.Simulation(**run)).constraint_error[0]
    for tolerance, word in (({"rest": 1.01 * error}, "held"), ({"rest": 0.99 * error}, "not held"), (1, "held")):
        assert simulate(scene, sg.Simulation(**run, tolerance=tolerance)).verdict.word == word
    for wrong in (0, -1.0, math.nan, "small", True, {"rest": 0}):
        with pytest.raises(sg.SceneError, match="tolerance"):
            sg.Simulation(tolerance=wrong)
    with pytest.raises(sg.SceneError, match=r"'path'. belongs to no constraint; there are rest"):
        simulate(scene, sg.Simulation(tolerance={"path": 1.0}))


def test_a_sampled_loop_is_allowed_what_a_tick_costs():
    """By default a hundredth of psi's size and omega hold; the same loop at a tick of 0.2 s is not held."""
    loop = ClosedLoop(oscillator(), sg.Simulation(start={"q": 0, "u": 1}, duration=2.0))
    runs = {step: loop.run(step=step, hold=True) for step in (1e-3, 1e-2, 0.2)}
    assert [run.verdict.word for run in runs.values()] == ["held", "held", "not held"]
    assert [run.claim.relative[0] for run in runs.values()] == pytest.approx([0.011, 0.02, 0.21])
    assert "Sample faster" in runs[0.2].verdict.advice


def test_what_grows_at_the_end_is_not_held():
    """A deviation within its tolerance that is multiplied by ten in every quarter is on its way out."""
    run = simulate(oscillator(), sg.Simulation(start={"q": 0, "u": 1}, duration=1.0))
    e = run.claim.tolerance * np.exp(14 * (run.t - 1))[:, None]
    assert "growing" in judge(replace(run, constraint=run.ideal + 0.5 * e)).reason
    assert judge(replace(run, constraint=run.ideal + 0.5 * run.claim.tolerance)).held
    verdict = judge(replace(run, constraint=run.ideal + 2 * e))
    assert verdict.word == "not held"
    assert f"beyond its tolerance since t = {1 - math.log(2) / 14:.3g}" in verdict.reason


def test_damping_that_costs_the_decay_is_told():
    scene, _ = load_simulation("double_pendulum_energy")
    damped = replace(scene, name="damped", solver=sg.Solver(damping=5.0))
    run = simulate(damped, sg.Simulation(start={"q": [1.6, -1.8], "u": [-0.3, 0.2]}, duration=0.5))
    assert run.verdict.word == "not held"
    assert "Damping changed the answer at" in run.verdict.advice


def test_inconsistent_constraints():
    q, u, tau = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau", 2)
    mech = sg.Mechanism(
        q=q, u=u, tau=tau, Q=ca.DM.eye(2), P=ca.SX.zeros(2), G=ca.vertcat(ca.horzcat(1, 0), ca.horzcat(0, q[0]))
    )
    scene = sg.Scene("twin", mech, [sg.Nonholonomic("both", u - ca.vertcat(0, 1), Theta=-1.0)])
    verdict = simulate(scene, sg.Simulation(start={"q": [0, 0], "u": [0, 0]}, duration=0.5)).verdict
    assert verdict.word == "inconsistent"
    assert "At t = 0 s the constraints could not all be met (rank 1 of 2); so at 501 of 501 rows" in verdict.reason


def test_stopped_and_refused(rail_loop, escape_loop):
    assert rail_loop.run().verdict.word == "stopped: half way"
    verdict = rail_loop.run(parameters={"m": -1.0}).verdict
    assert verdict.word == "refused: SINGULAR_MASS"
    assert verdict.reason.startswith("The controller refused the start: Q is singular")
    verdict = escape_loop.run().verdict  # it left what checks draw before the plant met infinity
    assert verdict.word == "left the domain"
    assert "the plant could not be computed" in verdict.reason
    wide = replace(escape_loop.simulation, domain={"q": (-math.inf, math.inf), "u": (-math.inf, math.inf)})
    assert simulate(escape_loop.scene, wide).verdict.word.startswith("stopped: plant ")


def test_angles_turn_and_lengths_do_not():
    """In fall and in P only the sine of the angle counts; a range of most of a turn means any angle."""
    scene = inverted({"q": ([-1, -3], [1, 3]), "u": (-50, 50)})
    claim = claim_of(scene, FALLS, {f.name: np.array(f.default) for f in scene.parameters})
    assert list(claim.angle) == [False, False, False, False]
    assert list(np.isinf(claim.high)) == [False, True, False, False]
    narrow = replace(FALLS, domain={"q": ([-1, 0.5], [1, 1.5])})
    claim = claim_of(scene, narrow, {f.name: np.array(f.default) for f in scene.parameters})
    assert list(claim.angle) == [False, True, False, False]
    turned = claim.folded(np.array([[7.0, 1.0 + 4 * math.pi, 0.0, 9.0]]))
    assert np.allclose(turned, [[7.0, 1.0, 0.0, 9.0]])


@pytest.mark.parametrize(
    ("domain", "words"),
    [
        ({"tau": (0, 1)}, "neither q nor u"),
        ({"q": (0, [1, 2, 3])}, "a list of 1"),
        ({"u": 3}, "give .lo, hi."),
        ({"u": (1, -1)}, "give lo < hi"),
        ({"u": (math.nan, 1)}, "give lo < hi"),
    ],
)
def test_a_domain_that_does_not_fit_is_named(domain, words):
    with pytest.raises(sg.SceneError, match=words):
        ClosedLoop(oscillator(), sg.Simulation(domain=domain))


def test_units_by_entry():
    assert units_of_entries("rad", 2) == ("rad", "rad")
    assert units_of_entries("m, rad", 2) == ("m", "rad")
    assert units_of_entries(None, 3) == ("", "", "")
    assert units_of_entries("N, N m", 3) == ("N, N m",) * 3
    with pytest.warns(sg.Remark, match=r"units\['psi'\] = 'm, rad' tells 2 units of 1 entries"):
        check_simulation(oscillator(), sg.Simulation(units={"psi": "m, rad"}))


def test_limits_of_a_scene_count_from_the_first_row_on_and_between_ticks():
    """First one control is held back, later the other: the word is that of many runs, and rows between ticks count."""
    q, u, tau = (ca.SX.sym(n, 2) for n in ("q", "u", "tau"))
    ref = sg.References(r=sg.Ref([0.0, 0.0], order=2))
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=ca.SX.eye(2), P=ca.SX.zeros(2), G=ca.SX.eye(2))
    scene = sg.Scene(
        "held_back",
        mech,
        [sg.Holonomic("track", q - ref.r, Theta1=-3.0, Theta2=-2.0)],
        references=ref,
        limits=sg.Limits(-1.0, 1.0),
    )
    course = {"r": lambda t: ca.vertcat(0, t**3)}
    loop = ClosedLoop(
        scene, sg.Simulation(start={"q": [1, 0], "u": [0, 0]}, duration=1.0, step=0.01, references=course)
    )
    for options in ({}, {"hold": 0.05}):
        run = loop.run(**options)
        assert run.limited[0] == 1
        assert run.limited.max() >= 2
        assert np.array_equal(
            run.limited != 0, np.isin(run.status, (sg.Status.LIMITED, sg.Status.LIMITED_INCONSISTENT))
        )
        assert run.verdict.word == loop.runs(1, **options).words[0] == "limited"


def test_units_of_u_are_those_of_q_per_second(rail_loop):
    simulation = sg.Simulation(start=rail_loop.simulation.start, duration=0.01, units={"q": "m"})
    assert with_units_of_rates(rail_loop.scene, simulation).units == {"q": "m", "u": "m/s"}
    assert with_units_of_rates(rail_loop.scene, replace(simulation, units={"u": "ft/s", "q": "m"})).units["u"] == "ft/s"
    assert "u" not in with_units_of_rates(load_simulation("unicycle_path")[0], simulation).units  # q' is not u
