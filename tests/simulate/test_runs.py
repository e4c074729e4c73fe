"""Runs by the thousand: the same as so many single runs, by any executor; what they tell."""

import csv
import json
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest
import servogen as sg
from scipy.stats import spearmanr
from servogen.bench.plain_loop import compare
from servogen.cli import main
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.robustness import write_robustness
from servogen.simulate.runs import QUANTILES
from servogen.simulate.wanted import load_simulation

COUNT = 24
MACHINES = {
    "perfect": {},
    "flawed": {
        "noise": {"q": 1e-3, "u": 1e-2},
        "delay": 2e-3,
        "actuators": sg.Actuators(limit=3.0, lag=2e-3),
        "step": 4e-3,
        "hold": 2e-3,
    },
    "coarse": {"duration": 0.4, "step": 0.05, "hold": True},
}


@pytest.fixture(scope="module")
def rail(rail_loop) -> ClosedLoop:
    """The mass on rails; it may go further than a domain that nobody stated."""
    simulation = replace(rail_loop.simulation, domain={"u": (-1, 1)}, spread={"m": 0.5, "q": 0.9, "u": 0.4})
    return ClosedLoop(rail_loop.scene, simulation)


@pytest.mark.parametrize("machine", list(MACHINES))
def test_they_are_what_single_runs_are(rail, machine):
    """To the last bit: errors, torques, statuses; and verdicts, whose facts are found by another hand."""
    options = MACHINES[machine]
    many = rail.runs(COUNT, seed=5, **options)
    singles = [rail.run(replay=seed, **options) for seed in range(5, 5 + COUNT)]
    assert list(many.words) == [run.verdict.word for run in singles]
    assert len(many.verdicts) > 1
    for name, values in {
        "error": [np.max(np.abs(run.constraint - run.ideal), axis=0) for run in singles],
        "end": [np.abs(run.constraint[-1]) for run in singles],
        "tau": [np.max(np.abs(run.tau), axis=0) for run in singles],
        "share": [run.shares.max() for run in singles],
        "t": [run.stop.t for run in singles],
        "rows_limited": [np.count_nonzero(run.limited) for run in singles],
    }.items():
        assert np.array_equal(getattr(many, name), values), name
    assert many.statuses == {"OK": sum(len(run.t) for run in singles)}
    plain = np.quantile([np.max(np.abs(run.tau)) for run in singles], QUANTILES)
    assert np.array_equal(many.quantiles()["largest |tau[0]|"], plain)


def test_quantiles_are_those_of_a_plain_loop_in_python(rail):
    """The textbook's controller, this file's own Runge-Kutta and the decay in closed form, on 200 runs."""
    hold, ticks, count = 0.05, 8, 200
    options = {"hold": hold, "step": hold, "duration": hold * ticks}
    many = rail.runs(count, spread={"m": 0.5, "u": 0.4}, seed=3, **options)
    controller = sg.reference(rail.scene)
    error, end, force = np.zeros(count), np.zeros(count), np.zeros(count)
    for k, (m, u) in enumerate(many.draws):
        state, tau = np.array([0.0, u]), 0.0
        for tick in range(ticks + 1):
            t = tick * hold
            decay = (u - 2) * np.exp(-t) + (1 - u) * np.exp(-2 * t)  # psi'' = -3 psi' - 2 psi from psi = -1, psi' = u
            tau = controller.control(q=state[:1], u=state[1:], r=1.0).value[0]
            error[k] = max(error[k], abs(state[0] - 1 - decay))
            force[k] = max(force[k], abs(tau))
            end[k] = abs(state[0] - 1)
            state = _runge_kutta(lambda x, tau=tau, m=m: np.array([x[1], tau / m]), state, hold)
    found = list(many.quantiles().values())
    for mine, theirs in zip((error, end, force), found, strict=True):
        np.testing.assert_allclose(theirs, np.quantile(mine, QUANTILES), rtol=1e-9)
    assert np.ptp(error) > 0.01


def test_an_arm_that_tracks_a_circle_beside_one_in_numpy():
    """Drawn masses and starts, references that move, the controller inside the right-hand side; 200 runs of 6 s
    agree as closely (python -m servogen.bench.plain_loop)."""
    done = compare(ClosedLoop(*load_simulation("planar_arm_3r")), count=12, duration=0.2)
    assert done.runs < 1e-11
    assert done.quantiles < 1e-11
    assert all(np.ptp(values) > 1e-2 * np.max(values) for values in done.plain.values())


def _runge_kutta(rate, x, h):
    a = rate(x)
    b = rate(x + h / 2 * a)
    c = rate(x + h / 2 * b)
    return x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c))


def test_every_word_is_found_without_rows():
    """Scenes that tip over, lose rank, are refused or stopped: the summary's word is the verdict's."""
    scene, simulation = load_simulation("double_pendulum_energy_and_path")
    spread = {"q": 0.8, "u": 2.0, "m_B": 0.2}
    loop = ClosedLoop(scene, replace(simulation, spread=spread, step=2e-3, duration=2.0, domain={"u": (-3.5, 3.5)}))
    many = loop.runs(COUNT, noise={"u": 1e-3})
    singles = [loop.run(replay=seed, noise={"u": 1e-3}).verdict.word for seed in range(COUNT)]
    assert list(many.words) == singles
    assert len(set(singles)) > 2


def test_any_executor_gives_the_same(rail):
    runs = [rail.runs(9, executor=pool) for pool in (None, ThreadPoolExecutor(1))]
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        runs.append(rail.runs(9, executor=pool))
    for run in runs[1:]:
        assert run.words == runs[0].words
        assert np.array_equal(run.error, runs[0].error)
        assert np.array_equal(run.draws, runs[0].draws)


def test_a_draw_follows_from_its_seed_alone(rail):
    many, later = rail.runs(6, seed=10), rail.runs(3, seed=13)
    assert np.array_equal(many.draws[3:], later.draws)
    assert np.array_equal(many.error[3:], later.error)
    assert many.names == ("m", "q", "u")
    assert np.all(np.abs(many.draws - [2.0, 0.0, 0.0]) <= [1.0, 0.9, 0.4])
    assert rail.run(replay=13).plant["m"] == later.draws[0, 0]
    assert rail.run().plant["m"] == 2.0  # a single run draws nothing


def test_what_hurts_most_and_the_worst_come_first(rail, tmp_path):
    many = rail.runs(200, spread={"m": 0.4, "u": 1e-3}, step=5e-3)
    assert next(iter(many.correlation)) == "m"
    assert abs(many.correlation["m"]) > 0.9
    assert abs(many.correlation["u"]) < 0.3
    off = np.abs(many.draws[:, 0] - (many.draws[:, 0].max() + many.draws[:, 0].min()) / 2)
    ranked = max((spearmanr(v, many.share).statistic for v in (many.draws[:, 0], off)), key=abs)
    assert many.correlation["m"] == pytest.approx(ranked, rel=1e-12)
    worst = many.worst(3)
    assert many.share[worst[0]] == max(many.share)
    assert list(many.share[worst]) == sorted(many.share[worst], reverse=True)
    drawn = [write_robustness(many, tmp_path)[0].read_bytes() for _ in range(2)]
    assert drawn[0] == drawn[1]
    assert len(drawn[0]) > 10_000


def test_starts_that_are_refused_are_counted(rail):
    many = rail.runs(20, spread={"m": 3.0})
    assert "stopped: plant SINGULAR_MASS" in many.verdicts
    assert np.isnan(many.share).sum() == many.verdicts["stopped: plant SINGULAR_MASS"]
    assert np.all(np.isfinite(many.quantiles()["largest |tau[0]|"]))


def test_a_run_that_is_refused_on_its_way_is_no_good_run(escape_loop):
    """Its deviation until then is none; it comes first among the worst, and is in no quantile."""
    many = escape_loop.runs(12, spread={"u": [0.0, 0.9]}, duration=0.4)  # infinite at 1 / (2 u_1^2)
    ended = many.t < 0.4 - 1e-9
    assert 0 < ended.sum() == many.refused < 12
    assert np.array_equal(np.isnan(many.share), ended)
    assert set(many.worst(many.refused)) == set(np.flatnonzero(ended))
    assert np.all(np.isfinite(many.quantiles()["largest |tau[0]|"]))
    assert many.correlation["u[1]"] > 0.5


def test_progress_comes_to_its_end(rail):
    seen: list[tuple[int, int]] = []
    rail.runs(30, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (30, 30)
    assert len(seen) > 4


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"count": 0}, "runs = 0"),
        ({"count": 10**11}, "at most 10,000,000 in one call"),
        ({"count": 2, "seed": 2**32 - 1}, "seed 4294967295 for 2 runs"),
        ({"count": 2, "spread": {"load": 0.1}}, "no such parameter; there are m, q, u"),
        ({"count": 2, "spread": {"m": -0.1}}, "not negative"),
        ({"count": 2, "spread": {"m": "x"}}, "give a number, or 1"),
        ({"count": 2, "spread": {"q": [1, 2]}}, "2 entries"),
    ],
)
def test_wrong_input_is_named(rail, options, words):
    with pytest.raises(sg.SceneError, match=words):
        rail.runs(**options)


def test_the_command_tells_quantiles_and_replays(monkeypatch, tmp_path, capsys):
    file = tmp_path / "cart.py"
    file.write_text(
        "import casadi as ca\nimport servogen as sg\nx, v, f = (ca.SX.sym(n) for n in 'xvf')\n"
        "par = sg.Parameters(m=2.0)\nmech = sg.Mechanism(q=x, u=v, tau=f, Q=par.m, P=-0.5 * v, G=1)\n"
        "scene = sg.Scene('cart', mech, [sg.Holonomic('x', x, Theta1=-2.0, Theta2=-1.0)], parameters=par)\n"
        "simulation = sg.Simulation(start={'q': 1, 'u': 0}, duration=1.0, spread={'m': 0.3})\n"
    )

    def command(*options: str) -> tuple[int, str]:
        where = ("--no-plots", "--out", str(tmp_path / "out"))
        monkeypatch.setattr(sys, "argv", ["servogen", "simulate", str(file), *where, *options])
        with pytest.raises(SystemExit) as end:
            main.main()
        return int(end.value.code or 0), capsys.readouterr().out

    flaws = ("--noise", "q=1e-4", "--spread", "q=0.2", "--seed", "40")
    code, printed = command("--runs", "50", "--json", *flaws)
    told = json.loads(printed)
    assert code == 1
    assert sum(told["verdicts"].values()) == told["runs"] == 50
    assert next(iter(told["correlation"])) == "m"
    worst = told["worst"][0]
    assert 40 <= worst["seed"] < 90
    with open(told["files"][0]) as rows:
        listed = list(csv.DictReader(rows))
    assert len(listed) == 50
    assert float(max(listed, key=lambda row: float(row["share_of_tolerance"]))["seed"]) == worst["seed"]
    _, printed = command("--replay", str(worst["seed"]), "--json", *flaws[:4])
    again = json.loads(printed)
    assert again["plant"]["m"] == [worst["drawn"]["m"]]
    assert again["start"]["q"] == [worst["drawn"]["q"]]
    assert again["verdict"]["word"] == worst["verdict"]
    code, printed = command("--runs", "5", "--spread", "m=0")
    assert code == 0
    assert "held: 5 runs, 100 %" in printed
    assert command("--runs", "5", "--target", "cortex-m4")[0] == 2
