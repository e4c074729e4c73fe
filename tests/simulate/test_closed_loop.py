"""Closed loops whose solution is known in closed form; how runs start and end."""

import math
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.simulate.closed_loop import METHODS, ClosedLoop, simulate
from servogen.simulate.plots import write_plots
from servogen.simulate.simulation import Simulation, run_takes, start_values
from servogen.simulate.sources import host_sources, write_loop
from servogen.simulate.wanted import load_simulation
from servogen.tools import firmware_sim

STRICT = (
    "-std=c99 -O2 -ffp-contract=off -Wall -Wextra -Wpedantic -Wconversion -Wdouble-promotion "
    "-Wmissing-prototypes -Wshadow -Werror"
).split()


def place(t: np.ndarray, r: float) -> np.ndarray:
    return r * (1 - 2 * np.exp(-t) + np.exp(-2 * t))


def test_a_holonomic_scene_follows_the_closed_form(rail_loop):
    run = rail_loop.run(references={"r": -4.0}, parameters={"m": 5.0}, duration=1.0)
    assert run.stop.reason == "event"  # 0.5 r - x <= 0 from the start: a stop expression is read as it is
    run = ClosedLoop(rail_loop.scene, Simulation(start={"q": 0, "u": 0})).run(
        references={"r": -4.0}, parameters={"m": 5.0}, duration=3.0
    )
    assert len(run.t) == 3001
    assert np.allclose(run.q[:, 0], place(run.t, -4.0), rtol=0, atol=1e-11)
    acceleration = -4.0 * (-2 * np.exp(-run.t) + 4 * np.exp(-2 * run.t))
    assert np.allclose(run.tau[:, 0], 5.0 * acceleration, rtol=0, atol=1e-9)
    assert np.allclose(run.psi[:, 0], run.q[:, 0] + 4.0, rtol=0, atol=1e-15)
    assert np.allclose(run.ideal, run.psi, rtol=0, atol=1e-10)
    assert set(run.rank) == {1}
    assert np.allclose(run.sigma_min, 1 / 5.0)


def test_an_event_stops_at_the_first_row_beyond(rail_loop):
    exact = math.log(2 + math.sqrt(2))  # x(t) = r / 2
    run = rail_loop.run()
    assert run.stop.event == "half way"
    assert run.stop.reason == "event"
    assert run.stop.status >= 0
    assert run.stop.t == run.t[-1]
    assert exact <= run.stop.t < exact + run.step
    assert run.q[-2, 0] < 0.5 <= run.q[-1, 0]


def test_an_event_at_the_start_leaves_one_row(rail_loop):
    run = rail_loop.run(start={"q": 5.0})
    assert (len(run.t), run.stop.event, run.stop.t) == (1, "beyond", 0.0)


def test_a_stop_expression_that_is_no_number_is_a_failure(rail_loop):
    loop = ClosedLoop(rail_loop.scene, Simulation(stop={"log": ca.log(rail_loop.scene.mechanism.q) + 9}))
    run = loop.run(start={"q": -1.0})
    assert (run.stop.reason, run.stop.status, len(run.t)) == ("stop expression", sg.Status.OVERFLOW, 1)
    assert run.stop.status < 0


def test_a_plant_that_escapes_ends_the_run(escape_loop):
    run = escape_loop.run()
    assert run.stop.reason == "plant"
    assert run.stop.status < 0
    assert run.stop.t == run.t[-1]
    assert 0.5 <= run.stop.t < 0.52
    early = run.t < 0.4
    assert np.allclose(run.u[early, 1], 1 / np.sqrt(1 - 2 * run.t[early]), rtol=1e-9)
    assert np.all(np.isfinite(run.u))


def test_what_prepare_refuses_leaves_no_row(rail_loop):
    run = rail_loop.run(parameters={"m": -1.0})
    assert (run.stop.reason, run.stop.status, len(run.t)) == ("controller", sg.Status.SINGULAR_MASS, 0)
    assert run.stop.t == 0


def test_the_step_is_shortened_to_divide_the_duration(escape_loop):
    run = escape_loop.run(duration=0.1, step=0.03)
    assert run.step == pytest.approx(0.025)
    assert np.allclose(run.t, [0, 0.025, 0.05, 0.075, 0.1])
    assert len(escape_loop.run(duration=0.3, step=0.1).t) == 4


def test_held_controls_are_constant_between_ticks(rail_loop):
    """One tick a row: a mass under a constant force moves on a parabola."""
    run = rail_loop.run(duration=0.5, step=0.05, hold=True)
    a = run.tau[:-1, 0] / 2.0
    assert np.allclose(np.diff(run.u[:, 0]), a * 0.05, rtol=0, atol=1e-15)
    assert np.allclose(np.diff(run.q[:, 0]), run.u[:-1, 0] * 0.05 + a * 0.05**2 / 2, rtol=0, atol=1e-15)


def test_chunks_and_progress_do_not_change_a_run(escape_loop):
    seen: list[tuple[int, int]] = []
    run = escape_loop.run(duration=0.45, step=1e-5, progress=lambda done, total: seen.append((done, total)))
    assert seen[0] == (4096, 45000)
    assert seen[-1] == (45000, 45000)
    assert np.array_equal(run.u[::100], escape_loop.run(duration=0.45, step=1e-5).u[::100])


def test_time_dependent_scenes_see_the_time_of_the_stage():
    """psi = u - sin t with psi(0) = 0: u = sin t, which needs t + h/2 in the middle stages."""
    q, u, tau, t = (ca.SX.sym(n) for n in ("q", "u", "tau", "t"))
    scene = sg.Scene(
        "clock",
        sg.Mechanism(q=q, u=u, tau=tau, Q=1, P=-q, G=1, t=t),
        [sg.Nonholonomic("swing", u - ca.sin(t), Theta=-2.0)],
    )
    run = simulate(scene, Simulation(start={"q": 0, "u": 0}, outputs={"t": t}), duration=5.0, step=0.01)
    assert np.allclose(run.u[:, 0], np.sin(run.t), rtol=0, atol=1e-9)
    assert np.allclose(run.q[:, 0], 1 - np.cos(run.t), rtol=0, atol=1e-9)
    assert np.array_equal(run.outputs["t"], run.t)


@pytest.mark.parametrize("hold", [False, True])
def test_references_that_move_come_with_their_rates(tracker_loop, hold):
    """q starts on r = (sin 2t, t^2) with its rate, and must stay there; without r_ddot it would lag."""
    run = tracker_loop.run(hold=hold)
    exact = np.column_stack([np.sin(2 * run.t), run.t**2])
    assert run.stop.reason == "finished"
    assert np.abs(run.q - exact).max() < (6e-3 if hold else 1e-10)
    assert np.allclose(run.outputs["r"], exact[:, 0], rtol=0, atol=1e-15)
    assert np.abs(run.ideal).max() < 1e-15


def test_only_references_move(tracker_loop):
    with pytest.raises(sg.SceneError, match="is no reference"):
        ClosedLoop(tracker_loop.scene, Simulation(references={"s": lambda t: t}))


def test_a_reference_of_numbers_is_that_constant(tracker_loop):
    simulation = replace(tracker_loop.simulation, start={"q": [3, 4], "u": [0, 0]}, references={"r": [3.0, 4.0]})
    run = simulate(tracker_loop.scene, simulation, duration=0.1)
    assert np.all(run.q == [3, 4])
    assert np.all(run.psi == 0)


def test_a_run_goes_before_the_references_of_the_simulation(tracker_loop):
    run = simulate(tracker_loop.scene, tracker_loop.simulation, references={"r": [3, 4]}, duration=0.1)
    assert np.all(run.outputs["r"] == 3)
    resting = ClosedLoop(tracker_loop.scene, replace(tracker_loop.simulation, references={"r": [1, 2]}))
    assert np.all(resting.run(references={"r": [3, 4]}, duration=0.1).outputs["r"] == 3)
    with pytest.raises(sg.SceneError, match=r"'r_dot' moves.*holding"):
        tracker_loop.run(references={"r_dot": [3, 4]})


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (1.0, "1 entries; it must have 2"),
        ("12", "give 2 numbers, or a function of time"),
        ([1.0, math.nan], "not finite"),
        (ca.SX.sym("t", 2), "give 2 numbers, or a function of time"),
        (lambda: 0, "TypeError.*lambda t"),
        (lambda t, more: t, "TypeError.*lambda t"),
        (lambda t: t, "shape 1x1.*column of 2"),
        (lambda t: "x", "cannot read str"),
        (lambda t: [t, t], "vertcat"),
        (lambda t: [math.sin(t), 0], "ca.sin.*not math.sin"),
        (lambda t: ca.vertcat(t + math.sin(t), 0), "ca.sin.*not math.sin"),
        (lambda t: ca.vertcat(t, ca.SX.sym("stranger")), "stranger"),
    ],
)
def test_a_reference_that_is_no_course_is_named(tracker_loop, given, words):
    with pytest.raises(sg.SceneError, match=rf"references\['r'\].*{words}"):
        ClosedLoop(tracker_loop.scene, Simulation(references={"r": given}))


def test_y_as_an_input_is_constant_over_the_run():
    q, u, tau = (ca.SX.sym(n, 2) for n in ("q", "u", "tau"))
    scene = sg.Scene(
        "pair",
        sg.Mechanism(q=q, u=u, tau=tau, Q=ca.SX.eye(2), P=ca.SX.zeros(2), G=ca.SX.eye(2)),
        [sg.Nonholonomic("sum", u[0] + u[1], Theta=-1.0)],
        y="input",
    )
    simulation = Simulation(start={"q": [0, 0], "u": [1, 0]}, duration=1.0, step=0.01)
    run = simulate(scene, simulation, references={"y": [3, 0]})
    # the null space of [1 1] keeps (y_0 - y_1) / 2 of y
    assert np.allclose(run.u[:, 0] - run.u[:, 1], 1 + 3 * run.t, rtol=1e-12)
    assert np.allclose(run.psi[:, 0], np.exp(-run.t), rtol=1e-9)


def test_defaults_draw_the_start_from_the_domain():
    scene, _ = load_simulation("spacecraft_smooth")
    loop = ClosedLoop(scene)
    assert (loop.simulation.duration, loop.simulation.step) == (10.0, 1e-3)
    run = loop.run(duration=0.01)
    assert len(run.t) == 11
    assert np.all(np.abs(run.u[0]) <= 0.5)
    assert np.array_equal(run.u, loop.run(duration=0.01).u)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"start": {"w": 1}}, "'w'"),
        ({"start": {"u": [1, 2, 3]}}, "u has 3 entries"),
        ({"start": {"t": 1}}, "'t'"),
        ({"references": {"r": 1}}, "'r'"),
        ({"parameters": {"m": 1}}, "parameters: 'm'"),
        ({"start": {"u": [math.nan, 1]}}, "start: u.*finite"),
        ({"duration": -1.0}, "duration"),
        ({"duration": 1.0, "step": 5.0}, "step 5 s.*duration 1 s"),
        ({"step": 0.0}, "step"),
        ({"step": 1e-9}, "at most"),
    ],
)
def test_wrong_input_is_named(escape_loop, options, words):
    with pytest.raises(sg.SceneError, match=words):
        escape_loop.run(**options)


def test_wrong_simulations_are_named(rail_loop):
    stranger = ca.SX.sym("stranger")
    for simulation, words in (
        (Simulation(outputs={"a": stranger}), "stranger"),
        (Simulation(stop={"a": stranger}), "stop"),
        (Simulation(units={"E": "J"}), "units"),
    ):
        with pytest.raises(sg.SceneError, match=words):
            ClosedLoop(rail_loop.scene, simulation)
    with pytest.raises(sg.SceneError, match="no output"):
        Simulation(decay={"E": (-1, 0)})
    with pytest.raises(sg.SceneError, match="scalar"):
        Simulation(outputs={"E": ca.SX.sym("x", 2)})


def test_limits_that_are_inputs_belong_to_the_start():
    x, v, force = ca.SX.sym("x"), ca.SX.sym("v"), ca.SX.sym("F")
    mech = sg.Mechanism(q=x, u=v, tau=force, Q=1, P=0, G=1)
    scene = sg.Scene("pushed", mech, [sg.Nonholonomic("pace", v, Theta=-1.0)], limits=sg.Limits("input", "input"))
    assert run_takes(scene)["start"] == {"q": 1, "u": 1, "tau": 1, "tau_min": 1, "tau_max": 1}
    assert run_takes(scene)["references"] == {}
    start = {"tau_min": -np.inf, "tau_max": 2.0}
    assert start_values(scene, sg.Simulation(start=start))["tau_min"] == -np.inf
    for wrong, words in (({"tau_max": 2.0}, "start has no tau_min"), (start | {"tau_min": np.nan}, "not finite")):
        with pytest.raises(sg.SceneError, match=words):
            start_values(scene, sg.Simulation(start=wrong))


def test_a_servo_scene_has_no_phi(escape_loop):
    run = escape_loop.run(duration=0.01)
    assert np.array_equal(run.psi, run.constraint)
    with pytest.raises(AttributeError, match="servo"):
        _ = run.phi


@pytest.mark.parametrize(
    ("name", "compiler", "scalar"),
    [
        ("spacecraft_smooth", "gcc", "float64"),
        ("spacecraft_smooth", "clang", "float32"),
        ("double_pendulum_energy", "gcc", "float32"),
        ("double_pendulum_energy", "clang", "float64"),
        ("tracker", "gcc", "float32"),
        ("tracker", "clang", "float64"),
        ("escape", "gcc", "float64"),
    ],
)
def test_the_loop_is_clean_c99(tmp_path: Path, need_tool, own_scenes, name, compiler, scalar):
    compile_with = need_tool(compiler, compiler)
    scene, simulation = own_scenes[name]() if name in own_scenes else load_simulation(name)
    sources = write_loop(scene, simulation, tmp_path, scalar)
    include = [f"-I{folder}" for folder in (sources.controller.path, *sources.include_folders)]
    bits = f"-DSERVOGEN_SCALAR_BITS={scalar.removeprefix('float')}"
    subprocess.run([compile_with, *STRICT, bits, *include, "-c", *host_sources(sources)], check=True, cwd=tmp_path)


def test_the_generated_loop_has_the_same_bytes_every_time(tmp_path: Path):
    texts = []
    for k in range(2):
        sources = write_loop(*load_simulation("double_pendulum_energy"), tmp_path / str(k), "float64")
        texts.append([f.read_bytes() for f in sorted(sources.folder.iterdir())])
        assert str(tmp_path).encode() not in b"".join(texts[-1])
    assert texts[0] == texts[1]


def test_the_method_table_is_that_of_the_c():
    header = (firmware_sim() / "simulate" / "loop.h").read_text()
    assert f"SIM_METHODS = {len(METHODS)} " in header
    for k, name in enumerate(METHODS):
        assert f"SIM_{name.upper()} = {k}," in header


def test_undefined_behaviour_and_overruns_are_absent(tmp_path: Path, need_tool):
    """A whole run of the loop in C under the sanitizers, from a main of its own."""
    gcc = need_tool("gcc", "gcc")
    sources = write_loop(*load_simulation("spacecraft_smooth"), tmp_path, "float64")
    main = tmp_path / "main.c"
    main.write_text(_MAIN)
    include = [f"-I{folder}" for folder in (sources.controller.path, *sources.include_folders)]
    files = [main, sources.controller.path / "spacecraft_smooth.c", *sources.sources]
    flags = ["-std=c99", "-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    program = tmp_path / "run"
    subprocess.run([gcc, *flags, "-DSERVOGEN_SCALAR_BITS=64", *include, *files, "-o", program, "-lm"], check=True)
    assert shutil.which(str(program))
    for hold in ("0", "1"):
        done = subprocess.run([program, hold], env={"ASAN_OPTIONS": "detect_leaks=0"}, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        rows, reason = done.stdout.split()
        assert (rows, reason) == ("101", "1")


_MAIN = """
#include <stdio.h>
#include "spacecraft_smooth_loop.h"
static int rows;
static void count(void *user, const sim_row *row) { (void)user; (void)row; ++rows; }
int main(int argc, char **argv)
{
    const double parameters[] = {10, 6.3, 8.5, 1}, q[3] = {0}, u[] = {0.1, 0.1, 0.1}, tau[] = {0.1, 0.1, -0.3376};
    const double limit[] = {0.2, 0.2, -1}, none[] = {-1, -1, -1}, noise[] = {0, 0, 0, 1e-3, 1e-3, 1e-3}, step[6] = {0};
    spacecraft_smooth_setup setup = {
        parameters, parameters, q, u, tau, NULL, limit, none, none, none, noise, step,
        0.01, 0.01, 4, 100, 1, 1, 127, 7, SIM_RK4, 0, 0, 1
    };
    static spacecraft_smooth_run run;
    sim_stop stop;
    setup.hold = argc > 1 && argv[1][0] == '1';
    if (spacecraft_smooth_begin(&run, &setup, count, NULL) == SIM_RUNNING) {
        while (spacecraft_smooth_advance(&run, 7, count, NULL, &stop) == SIM_RUNNING) { }
    }
    printf("%d %d\\n", rows, run.loop.stop.reason);
    return 0;
}
"""


def test_margins_are_drawn_where_there_are_any(tmp_path):
    scene, simulation = load_simulation("double_pendulum_energy_and_path")
    run = ClosedLoop(scene, simulation).run(step=1e-3)
    drawn = {file.name for file in write_plots(scene, simulation, run, tmp_path)}
    assert {"margins.png", "margins.svg"} <= drawn
    assert "margins.png" not in {p.name for p in write_plots(scene, sg.Simulation(), run, tmp_path)}
