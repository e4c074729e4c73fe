"""What a run leaves on disk, and the command."""

import csv
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from servogen.cli import main, simulate
from servogen.errors import SceneError
from servogen.loading import builtin_names
from servogen.simulate.export import write_csv
from servogen.simulate.plots import write_plots
from servogen.simulate.simulation import check_simulation
from servogen.simulate.trajectory import with_unit
from servogen.simulate.wanted import load_simulation

SCENE = """
import casadi as ca
import servogen as sg
q, u, tau = (ca.SX.sym(n) for n in ("q", "u", "tau"))
par, ref = sg.Parameters(M=1.0, k=[1.0, 2.0]), sg.References(r=1.0)
scene = sg.Scene(
    "falls",
    sg.Mechanism(q=q, u=u, tau=tau, Q=par.M, P={P}, G={G}),
    [sg.Nonholonomic("n", u - ref.r, Theta=-1.0)],
    parameters=par,
    references=ref,
)
simulation = {simulation}
"""


def scene_file(folder: Path, simulation: str, P: str = "0", G: str = "1") -> Path:
    file = folder / "falls.py"
    file.write_text(SCENE.format(simulation=simulation, P=P, G=G))
    return file


def command(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["servogen", "simulate", *map(str, arguments)])
    with pytest.raises(SystemExit) as end:
        main.main()
    return int(end.value.code or 0)


@pytest.fixture(scope="module")
def some_run(rail_loop):
    return rail_loop.run(duration=0.2, step=0.01)


def test_csv_reads_back_as_the_same_numbers(rail_loop, some_run, tmp_path):
    file = write_csv(some_run, tmp_path / "run.csv")
    with file.open() as text:
        rows = list(csv.DictReader(text))
    assert len(rows) == 21
    for name, values in (
        ("t", some_run.t),
        ("q_0", some_run.q[:, 0]),
        ("tau_0", some_run.tau[:, 0]),
        ("psi_0", some_run.psi[:, 0]),
        ("power, mechanical", some_run.outputs["power, mechanical"]),
        ("status", some_run.status),
    ):
        assert np.array_equal([float(row[name]) for row in rows], values)


def test_figures_are_the_same_bytes_every_time(rail_loop, some_run, tmp_path):
    bytes_of = []
    for k in "ab":
        (tmp_path / k).mkdir()
        files = write_plots(rail_loop.scene, rail_loop.simulation, some_run, tmp_path / k)
        bytes_of.append({f.name: f.read_bytes() for f in files})
    assert sorted(bytes_of[0]) == [f"{n}.{e}" for n in ("controls", "outputs", "psi", "states") for e in ("png", "svg")]
    assert bytes_of[0] == bytes_of[1]
    assert b"<dc:date>" not in bytes_of[0]["states.svg"]
    assert len(bytes_of[0]["states.png"]) > 10_000


@pytest.mark.parametrize("name", builtin_names())
def test_built_in_scenes_have_a_simulation_that_fits(name):
    check_simulation(*load_simulation(name))


def test_a_run_that_is_held_is_good(monkeypatch, tmp_path, capsys):
    file = scene_file(
        tmp_path, 'sg.Simulation(start={"q": 0, "u": 3}, duration=0.5, domain={"u": (0, 3)}, outputs={"K": u**2 / 2})'
    )
    assert command(monkeypatch, file, "--json", "--out", tmp_path / "out", "--start", "u=2", "--step", "0.01") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["stop"]["reason"] == "finished"
    assert told["verdict"]["word"] == "held"
    assert told["rows"] == 51
    assert told["start"]["u"] == [2.0]
    assert told["end"]["u"][0] == pytest.approx(1 + np.exp(-0.5), rel=1e-9)
    assert told["constraint_error"] < 1e-9
    assert sorted(f.name for f in (tmp_path / "out").iterdir()) == sorted(Path(f).name for f in told["files"])
    assert len(told["files"]) == 9  # the CSV, and four figures twice


def test_tables_are_for_people(monkeypatch, tmp_path, capsys):
    units = '{"u": "rad/s", "tau": "N m", "psi": "1/s"}'
    file = scene_file(tmp_path, f'sg.Simulation(duration=0.1, stop={{"late": 0.05 - q}}, units={units})')
    folder = tmp_path / "out"
    assert command(monkeypatch, file, "--no-plots", "--out", folder, "--start", "q=0", "--start", "u=1") == 1
    printed = " ".join(capsys.readouterr().out.split())
    assert "stopped by 'late' at t = 0.05" in printed
    told = (
        "stopped: late: At t = 0.05 s the run's own stop 'late' ended it; constraint 'n' was off its prescribed decay "
    )
    for words in ("u [rad/s]", "tau [N m]", "largest |tau| 0 N m,", f"{told}by at most 0 1/s, at t = 0 s"):
        assert words in printed
    assert [f.name for f in folder.iterdir()] == ["falls.csv"]


def test_entries_of_several_units_have_one_each():
    row = simulate._row
    assert row("q", [0, 1], [2, 3], "m") == ("q \\[m]", "0, 1", "2, 3")
    assert row("q", [0, 1, 5], [2, 3, 4], "m, m, rad") == ("q", "0, 1 m, 5 rad", "2, 3 m, 4 rad")
    assert row("y", 1.5, 2.5, None) == ("y", "1.5", "2.5")


@pytest.mark.parametrize(("unit", "told"), [("N m", "1.23 N m"), ("N, N m", "1.23"), ("", "1.23"), (None, "1.23")])
def test_a_unit_stands_where_it_is_one(unit, told):
    assert with_unit(1.2345, unit) == told


def test_a_negative_status_is_a_failure(monkeypatch, tmp_path, capsys):
    file = scene_file(tmp_path, 'sg.Simulation(start={"q": 1, "u": 1})', P="0 * u", G="1 / (q - 1)")
    assert command(monkeypatch, file, "--json", "--no-plots", "--out", tmp_path / "out") == 1
    told = json.loads(capsys.readouterr().out)
    assert told["stop"]["status"] == "OVERFLOW"
    assert told["verdict"]["word"] == "refused: OVERFLOW"
    assert told["rows"] == 0
    for name in ("largest_tau", "smallest_sigma_min", "constraint_error", "constraint_error_t"):
        assert told[name] is None


def test_a_refusal_tells_what_was_changed_and_no_figures(monkeypatch, tmp_path, capsys):
    file = scene_file(tmp_path, "sg.Simulation()")
    assert command(monkeypatch, file, "--no-plots", "--out", tmp_path / "out", "--parameter", "M=-1") == 1
    printed = capsys.readouterr().out
    assert "SINGULAR_MASS" in printed
    assert "parameters changed: M = -1" in printed
    assert not re.search("largest|sigma_min|at most|quantity", printed)


@pytest.mark.parametrize("moving", ["1.0", "[1.0]", "ca.sin"])
def test_a_reference_of_the_command_goes_before_the_files(monkeypatch, tmp_path, capsys, moving):
    start = '"start": {"q": 0, "u": 2}, "duration": 0.1, "outputs": {"r": ref.r}'
    file = scene_file(tmp_path, f'sg.Simulation(references={{"r": {moving}}}, **{{{start}}})')
    where = ("--json", "--no-plots", "--out", tmp_path / "out")
    assert command(monkeypatch, file, *where, "--reference", "r=2") == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["end"]["r"], told["end"]["psi"]) == (2.0, [0.0])


@pytest.mark.parametrize(
    ("option", "given", "words"),
    [
        ("--reference", "heigth=1", "'heigth' is unknown; there are r"),
        ("--start", "r=1", "'r' is unknown; there are q, u, tau"),
        ("--parameter", "m=1", "'m' is unknown; there are M, k"),
        ("--parameter", "M", "as in M=0.1"),
        ("--parameter", "k=1,x", "as in k=0.1,0.1"),
        ("--parameter", "k=1", "k has 1 entries; it must have 2"),
        ("--parameter", "M=nan", "M = [nan] is not finite"),
        ("--reference", "r=inf", "r = [inf] is not finite"),
        ("--start", "u=-inf", "u = [-inf] is not finite"),
    ],
)
def test_wrong_assignments_name_their_option(monkeypatch, tmp_path, capsys, option, given, words):
    file = scene_file(tmp_path, "sg.Simulation()")
    assert command(monkeypatch, file, "--json", "--out", tmp_path / "out", option, given) == 2
    told = json.loads(capsys.readouterr().out)["error"]
    assert told.startswith(option)
    assert words in told


@pytest.mark.parametrize(
    "arguments",
    [
        ("nothing",),
        ("spacecraft", "--start", "u=1,2"),
        ("spacecraft", "--start", "u"),
        ("spacecraft", "--parameter", "I_1=x"),
        ("spacecraft", "--scalar", "float16"),
        ("spacecraft", "--step", "-1"),
        ("spacecraft", "--step", "5", "--duration", "1"),
    ],
)
def test_wrong_input_is_exit_code_two(monkeypatch, tmp_path, arguments):
    assert command(monkeypatch, *arguments, "--out", tmp_path) == 2


def test_simulation_of_another_type_is_named(tmp_path):
    with pytest.raises(SceneError, match="make it an sg"):
        load_simulation(str(scene_file(tmp_path, "3")))


def test_each_scene_of_a_file_has_its_own(tmp_path):
    file = tmp_path / "two.py"
    file.write_text(
        "from servogen.scenes.spacecraft import stabilisation\nimport servogen as sg\n"
        "scene, other, third = (stabilisation(n, True) for n in 'abc')\n"
        "simulation = sg.Simulation(duration=1.0)\nother_simulation = sg.Simulation(duration=2.0)\n"
    )
    assert load_simulation(f"{file}")[1].duration == 1.0
    assert load_simulation(f"{file}:other")[1].duration == 2.0
    assert load_simulation(f"{file}:third")[1].duration == 10.0
