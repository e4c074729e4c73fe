"""A machine unlike the controller's model: each flaw against what it must do, in closed form or by another hand."""

import ctypes as ct
import json
import sys
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from scipy.linalg import expm
from servogen.cli import main
from servogen.simulate.closed_loop import ClosedLoop, simulate
from servogen.simulate.export import write_csv
from servogen.simulate.machine import MOST_DELAY, Grid, grid_of, machine_in_words
from servogen.simulate.trajectory import Stop, rows_that_differ
from servogen.simulate.wanted import load_simulation
from servogen.tools import firmware_sim

FREE = {"duration": 0.5, "step": 0.05, "hold": True}


@pytest.fixture(scope="module")
def rail(rail_loop) -> ClosedLoop:
    """The mass on rails without its stops: command = 2 (-3 v - 2 (x - 1))."""
    return ClosedLoop(rail_loop.scene, sg.Simulation(start={"q": 0.0, "u": 0.0}))


def command(run) -> np.ndarray:
    return 2.0 * (-3 * run.u[:, 0] - 2 * (run.q[:, 0] - 1))


def test_the_plant_has_its_own_parameters(rail):
    """Twice the mass that the controller takes: x'' is half of what it asks for."""
    run = rail.run(plant={"m": 4.0}, duration=2.0)
    A = np.array([[0, 1, 0], [-1, -1.5, 1], [0, 0, 0]])
    exact = np.array([expm(A * t)[:2, 2] for t in run.t[::100]])
    assert np.allclose(run.q[::100, 0], exact[:, 0], atol=1e-11)
    assert np.allclose(run.u[::100, 0], exact[:, 1], atol=1e-11)
    assert run.plant["m"] == 4.0
    assert run.parameters["m"] == 2.0
    assert run.verdict.word == "not held"
    assert run.verdict.advice.startswith("The plant has m = 4 where the controller takes 2:")


def test_psi_is_where_the_plant_is():
    """The energy of the pendulum that is there, not of the one that the controller takes it for."""
    scene, simulation = load_simulation("double_pendulum_energy")
    run = simulate(scene, replace(simulation, plant={"m_B": 1.5}), duration=0.01)
    heavy = ClosedLoop(scene, simulation).run(parameters={"m_B": 1.5}, duration=0.01)
    assert run.psi[0] == heavy.psi[0]
    assert run.outputs["E"][0] == heavy.outputs["E"][0]
    assert np.any(run.psi[-1] != heavy.psi[-1])


def test_the_plant_may_be_another_mechanism(rail):
    x, v, f = ca.SX.sym("a"), ca.SX.sym("b"), ca.SX.sym("c")
    other = sg.Mechanism(q=x, u=v, tau=f, Q=4.0, P=-0.5 * v, G=1)
    run = simulate(rail.scene, replace(rail.simulation, plant=other), duration=1.0)
    A = np.array([[0, 1, 0], [-1, -1.625, 1], [0, 0, 0]])
    assert np.allclose(run.q[-1, 0], expm(A)[0, 2], atol=1e-11)
    for wrong, words in (
        (
            sg.Mechanism(q=ca.SX.sym("q", 2), u=ca.SX.sym("u", 2), tau=f, Q=ca.DM.eye(2), P=[0, 0], G=[1, 0]),
            "2 entries of q",
        ),
        (sg.Mechanism(q=x, u=v, tau=f, Q=ca.SX.sym("load"), P=0, G=1), "'load'"),
        ("heavy", "sg.Mechanism"),
        ({"load": 2}, "'load' is unknown; there are m"),
    ):
        with pytest.raises(sg.SceneError, match=words):
            ClosedLoop(rail.scene, replace(rail.simulation, plant=wrong))


def test_the_plant_keeps_its_passive_constraints(tmp_path):
    """Two masses of 1 that the controller takes for free are joined by a rod: its push moves both."""
    q, u, f = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("f")
    a, b, c = ca.SX.sym("a", 2), ca.SX.sym("b", 2), ca.SX.sym("c")
    par = sg.Parameters(rod=sg.Parameter(1.0, "m", "length"))
    bodies = {"Q": ca.DM.eye(2), "P": [0, 0], "G": [1, 0]}
    scene = sg.Scene(
        "pushed", sg.Mechanism(q=q, u=u, tau=f, **bodies), [sg.Nonholonomic("v", u[0] - 1, Theta=-2.0)], parameters=par
    )
    joined = [sg.PassiveHolonomic("rod", a[1] - a[0] - par.rod, stabilise=par.rod)]
    simulation = sg.Simulation(
        start={"q": [0, 2], "u": [0, 0]}, plant=sg.Mechanism(q=a, u=b, tau=c, passive=joined, **bodies), duration=1.0
    )
    run = ClosedLoop(scene, simulation).run(plant={"rod": 3.0})
    assert np.allclose(run.q[0], [-0.5, 2.5])
    assert np.allclose(run.u, 1 - np.exp(-run.t)[:, None], atol=1e-11)  # tau = 2 (1 - u), and 2 u' = tau
    assert len(run.drift) == len(run.t)
    assert np.max(run.drift) < 1e-12
    header = write_csv(run, tmp_path / "run.csv").read_text().splitlines()[0]
    assert header.endswith("sigma_min,drift")
    stop = Stop("controller", 1.0, "", sg.Status.DEAD_CENTRE)
    assert "the passive constraints lose rank" in replace(run, stop=stop).verdict.reason
    assert "dead centres" in replace(run, stop=stop).verdict.advice
    strange = sg.PassiveHolonomic("rod", a[1] - a[0] - ca.SX.sym("load"))
    wrong = sg.Mechanism(q=a, u=b, tau=c, passive=[strange], **bodies)
    with pytest.raises(sg.SceneError, match="passive constraint 'rod': chi holds the symbol 'load'"):
        ClosedLoop(scene, replace(simulation, plant=wrong))


def test_disturbances_push_beside_p_and_beside_tau(rail):
    """A constant force of 1 N beside P and a ramp of t N beside tau: x'' = the law + (1 + t) / 2."""
    pushed = {"P": 1.0, "tau": lambda t: t}
    run = simulate(rail.scene, replace(rail.simulation, disturbance=pushed), duration=2.0)
    A = np.array([[0, 1, 0, 0], [-2, -3, 2.5, 0.5], [0, 0, 0, 0], [0, 0, 1, 0]])
    assert np.allclose(run.q[-1, 0], expm(A * 2)[0, 2], atol=1e-11)
    assert run.verdict.word == "not held"
    for wrong, words in (({"u": 1}, "name P"), ({"P": [1, 2]}, "P.*2x1|P.*shape"), ({"P": ca.SX.sym("z")}, "'z'")):
        with pytest.raises(sg.SceneError, match=words):
            ClosedLoop(rail.scene, replace(rail.simulation, disturbance=wrong))


@pytest.mark.parametrize("delay", [0.02, 0.05, 0.13])
def test_a_command_acts_after_its_delay(rail, delay):
    """A tick of 0.05 s: so long the commands before act, the first one from the beginning."""
    run = rail.run(**FREE, delay=delay)
    wanted = command(run)
    acting = np.array(
        [
            [wanted[max(0, int((t - delay) / 0.05 + 1e-9 + 1) - 1)] for t in k * 0.05 + np.arange(100) * 5e-4 + 2e-4]
            for k in range(10)
        ]
    )
    assert np.allclose(np.diff(run.u[:, 0]), acting.mean(axis=1) * 0.05 / 2, rtol=0, atol=1e-12)


def test_a_rate_and_a_limit(rail):
    run = rail.run(**FREE, actuators=sg.Actuators(limit=3.0, rate=20.0))
    wanted = np.clip(command(run), -3.0, 3.0)
    tau, step = wanted[0], 20 * 0.05 / 4
    for k in range(10):
        held = []
        for _ in range(4):
            tau += np.clip(wanted[k] - tau, -step, step)
            held.append(tau)
        assert run.tau[k, 0] == pytest.approx(held[0], abs=1e-12)
        assert np.diff(run.u[:, 0])[k] == pytest.approx(np.mean(held) * 0.05 / 2, abs=1e-12)
    assert run.limited[0] == 1  # 4 N are asked for
    weak = rail.run(duration=2.0, actuators=sg.Actuators(limit=0.5))
    assert weak.verdict.word == "limited"
    assert "At t = 0 s actuators held tau[0] back" in weak.verdict.reason
    assert rail.run(**FREE, actuators=sg.Actuators(limit=100.0)).limited.max() == 0


def test_a_lag_is_of_first_order(rail):
    """The state (x, v, a) with a' = (command - a) / T, solved exactly from tick to tick."""
    T, h = 0.03, 0.05
    run = rail.run(**FREE, actuators=sg.Actuators(lag=T))
    A = expm(np.array([[0, 1, 0, 0], [0, 0, 0.5, 0], [0, 0, -1 / T, 1 / T], [0, 0, 0, 0]]) * h)
    state = np.array([0.0, 0.0, 4.0])
    for k in range(11):
        assert np.allclose([run.q[k, 0], run.u[k, 0], run.tau[k, 0]], state, atol=2e-4)
        state = (A @ [*state, 2.0 * (-3 * state[1] - 2 * (state[0] - 1))])[:3]


def words(seed: int, count: int) -> np.ndarray:
    """splitmix64 in numpy: three words a deviate."""

    def mixed(z: np.ndarray) -> np.ndarray:
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return z ^ (z >> np.uint64(31))

    golden = np.uint64(0x9E3779B97F4A7C15)
    key = mixed(np.array([seed], np.uint64) + golden)
    return mixed(key + np.arange(1, 3 * count + 1, dtype=np.uint64) * golden).reshape(count, 3)


def normals(seed: int, count: int) -> np.ndarray:
    parts = [(words(seed, count) >> np.uint64(16 * k) & np.uint64(0xFFFF)).astype(float) for k in range(4)]
    return (sum(parts).sum(axis=1) - 12 * 32767.5) / 65536


def test_deviates_are_normal_and_the_same_everywhere(rail):
    draw = rail._library.sim_normal
    draw.restype, draw.argtypes = ct.c_double, [ct.c_uint32, ct.c_uint64]
    for seed in (0, 1, 2**32 - 1):
        ours = normals(seed, 500)
        assert np.array_equal([draw(seed, n) for n in range(500)], ours)
    many = np.concatenate([normals(seed, 20_000) for seed in range(10)])
    assert abs(many.mean()) < 4 / np.sqrt(len(many))
    assert abs(many.var() - 1) < 4 * np.sqrt(2 / len(many))
    for bound, share in ((1.0, 0.3173), (2.0, 0.0455), (3.0, 0.0027)):  # twelve terms: lighter tails by a little
        assert np.mean(np.abs(many) > bound) == pytest.approx(share, rel=0.2)
    assert abs(np.corrcoef(many[:-1], many[1:])[0, 1]) < 4 / np.sqrt(len(many))
    assert abs(np.corrcoef(normals(0, 20_000), normals(1, 20_000))[0, 1]) < 4 / np.sqrt(20_000)


def test_the_controller_sees_noise_and_steps_and_the_rows_the_truth(rail):
    run = rail.run(**FREE, noise={"q": 1e-2, "u": 3e-2}, quantise={"q": 0.005}, seed=7)
    drawn = normals(7, 22).reshape(11, 2) * [1e-2, 3e-2]
    seen = np.round((run.q[:, 0] + drawn[:, 0]) / 0.005) * 0.005, run.u[:, 0] + drawn[:, 1]
    assert np.allclose(run.tau[:, 0], 2.0 * (-3 * seen[1] - 2 * (seen[0] - 1)), atol=1e-12)
    assert np.allclose(run.psi[:, 0], run.q[:, 0] - 1, atol=1e-15)
    assert rows_that_differ(run, rail.run(**FREE, noise={"q": 1e-2, "u": 3e-2}, quantise={"q": 0.005}, seed=7)) == 0
    assert rows_that_differ(run, rail.run(**FREE, noise={"q": 1e-2, "u": 3e-2}, quantise={"q": 0.005}, seed=8)) > 9


def test_a_machine_without_flaws_keeps_the_bits(rail):
    perfect = {"actuators": sg.Actuators(limit=1e9, rate=np.inf, lag=0), "noise": {"q": 0}, "delay": 0.0, "seed": 9}
    assert rows_that_differ(rail.run(**FREE), rail.run(**FREE, **perfect)) == 0


def test_flaws_of_no_size_are_none(rail):
    """inf, 0: no flaw, so no sampling controller, and nothing to tell of."""
    nothing = {
        "actuators": sg.Actuators(limit=np.inf, rate=np.inf, lag=0.0),
        "noise": {"q": 0.0},
        "quantise": {"u": 0.0},
        "delay": 0.0,
    }
    run = rail.run(**nothing)
    assert run.hold is None
    assert np.array_equal(run.q, rail.run().q)
    assert machine_in_words(replace(rail.simulation, **nothing)) == ""


def test_rows_and_ticks_need_not_be_one(rail):
    ticks = rail.run(duration=1.0, step=0.01, hold=0.01)
    assert rows_that_differ(ticks, rail.run(duration=1.0, step=0.01, hold=True)) == 0
    rare = rail.run(duration=1.0, step=0.05, hold=0.01)
    assert np.array_equal(rare.u, ticks.u[::5])
    often = rail.run(duration=1.0, step=0.0025, hold=0.01)
    assert np.allclose(often.u[::4], ticks.u, atol=1e-13)
    assert np.all(often.tau[1:4] == often.tau[0])
    assert (rare.hold, rare.step, len(rare.t)) == (0.01, pytest.approx(0.05), 21)


def test_the_grid():
    plain = sg.Simulation()
    assert grid_of(plain, 1.0, 0.3, None) == Grid(0.25, 4, 1)
    assert grid_of(replace(plain, delay=0.0003), 1.0, 1e-3, None).delay == 3
    assert grid_of(replace(plain, delay=0.0003), 1.0, 1e-3, None).substeps == 10
    for simulation, step, hold, words in (
        (plain, 0.01, 0.003, "hold = 0.003 s and step = 0.01 s.*try hold = 0.00333"),
        (replace(plain, delay=1.0), 0.01, None, f"more than {MOST_DELAY} ticks"),
        (replace(plain, delay=0.01 / 127), 0.01, None, "no simple fraction.*try 0"),
        (replace(plain, delay=0.01), 0.01, False, "samples"),
    ):
        with pytest.raises(sg.SceneError, match=words):
            grid_of(simulation, 1.0, step, hold)
    header = (firmware_sim() / "simulate" / "machine.h").read_text()
    assert f"#define SIM_QUEUE {MOST_DELAY + 1} " in header


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"noise": {"tau": 1}}, "neither q nor u"),
        ({"noise": {"q": -1}}, "noise.'q'. = -1"),
        ({"noise": {"q": [1, 2]}}, "2 entries; give a number, or 1"),
        ({"quantise": {"u": np.inf}}, "finite"),
        ({"noise": 3}, "noise = 3"),
        ({"delay": -1.0}, "delay = -1.0"),
        ({"hold": 0}, "hold = 0"),
        ({"seed": 1.5}, "seed = 1.5"),
        ({"actuators": 20}, "sg.Actuators"),
        ({"plant": 20}, "plant is a int"),
    ],
)
def test_a_machine_that_cannot_be_is_named(rail_loop, given, words):
    with pytest.raises(sg.SceneError, match=words):
        ClosedLoop(rail_loop.scene, sg.Simulation(**given))


@pytest.mark.parametrize("given", [{"limit": -1}, {"rate": "fast"}, {"lag": np.inf}, {"limit": []}])
def test_actuators_that_cannot_be_are_named(given):
    with pytest.raises(sg.SceneError, match=f"actuators: {next(iter(given))} = "):
        sg.Actuators(**given)


def test_the_command_takes_a_machine(monkeypatch, tmp_path, capsys):
    def command(*options: str) -> tuple[int, dict]:
        monkeypatch.setattr(
            sys, "argv", ["servogen", "simulate", "planar_arm_3r_damped", "--duration", "0.3", *options]
        )
        with pytest.raises(SystemExit) as end:
            main.main()
        return int(end.value.code or 0), json.loads(capsys.readouterr().out)

    where = ("--json", "--no-plots", "--out", str(tmp_path))
    flaws = "--plant m=3,2,1.5 --limit 20 --rate 1e4 --lag 1e-3 --noise q=1e-4 --quantise u=1e-3 --delay 2e-3 --seed 3"
    code, told = command(*where, *flaws.split(), "--hold", "1e-3")
    assert code == 1
    assert told["hold"] == 1e-3
    assert told["plant"] == {"m": [3, 2, 1.5]}
    assert told["rows_limited"] > 0
    assert told["largest_tau"] == pytest.approx(20)
    expected = "|tau| at most 20; |tau'| at most 10000 per second; tau lags by 0.001 s; noise of q 0.0001; "
    assert told["machine"] == expected + "u read in steps of 0.001; delay 0.002 s; seed 3"
    for option, words in (
        ("--limit x", "--limit 'x'; write a number, or 3"),
        ("--noise tau=1", "'tau' is unknown; there are q, u"),
        ("--limit 1,2", "--limit has 2 entries"),
    ):
        code, told = command(*where, *option.split())
        assert (code, words in told["error"]) == (2, True)
