"""How the command ends: one line or one object, and an exit code, whatever happens."""

import errno
import inspect
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import casadi as ca
import click
import pytest
import servogen as sg
from servogen.cli import main
from servogen.compiler import build
from servogen.tools import CompilerRefused, c_compiler, compile_c


@pytest.fixture
def ends(monkeypatch, capsys):
    """ends(*arguments): (exit code, standard output, standard error) of the command."""

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["servogen", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main.main()
        return (end.value.code, *capsys.readouterr())

    return call


def crane(name):
    q, u, tau = ca.SX.sym("q"), ca.SX.sym("u"), ca.SX.sym("tau")
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=1.0, P=-ca.sign(u), G=1.0)
    return sg.Scene(name, mech, [sg.Nonholonomic("speed", u, -1.0)])


def breaks(error):
    def load_scene(spec):
        raise error

    return load_scene


def test_an_unforeseen_error_is_one_line_and_a_code_of_its_own(ends, monkeypatch):
    monkeypatch.setattr("servogen.cli.generate.load_simulation", breaks(IndexError("list index\nout of range")))
    code, out, err = ends("generate", "spacecraft")
    assert (code, out) == (3, "")
    assert err.startswith("internal error: IndexError: list index out of range; please report it with")
    assert len(err.splitlines()) == 1
    code, out, err = ends("generate", "spacecraft", "--json")
    assert (code, err) == (3, "")
    assert json.loads(out)["error"].startswith("internal error: IndexError: list index out of range")


def test_its_traceback_is_shown_on_demand(ends, monkeypatch):
    monkeypatch.setattr("servogen.cli.generate.load_simulation", breaks(KeyError("tau")))
    monkeypatch.setenv("SERVOGEN_TRACEBACK", "1")
    code, out, err = ends("generate", "spacecraft", "--json")
    assert code == 3
    assert "Traceback" in err
    assert "KeyError" in json.loads(out)["error"]


def test_an_interrupt_is_no_error(ends, monkeypatch):
    monkeypatch.setattr("servogen.cli.generate.load_simulation", breaks(KeyboardInterrupt()))
    code, out, err = ends("generate", "spacecraft")
    assert (code, out, err.strip()) == (130, "", "servogen: interrupted")


def test_where_nothing_may_be_written_the_option_is_named(ends, monkeypatch):
    refusal = PermissionError(13, "Permission denied", "/locked")
    monkeypatch.setattr("servogen.cli.generate.build", lambda *given, **more: breaks(refusal)(""))
    code, out, err = ends("generate", "spacecraft", "--out", "/locked")
    assert (code, out) == (2, "")
    assert err == "error: /locked: Permission denied; name a folder that you may write to with --out\n"


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("double_pendulm_energy", "did you mean double_pendulum_energy?"),
        (".", ". is a folder"),
        ("carne.py", "no file carne.py; did you mean crane.py?"),
        ("nowhere/crane.py", "no file nowhere/crane.py: there is no folder nowhere"),
        ("crane.py", "crane.py defines several scenes: fast, slow; name one, as in crane.py:fast"),
        ("crane.py:solw", "crane.py defines no scene 'solw'; did you mean slow? It has fast, slow"),
        ("cases.txt", "cases.txt is no .py file"),
        ("cases.txt:scene", "cases.txt is no .py file"),
    ],
)
def test_wrong_names_of_scenes(ends, monkeypatch, tmp_path, spec, words):
    (tmp_path / "cases.txt").write_text("1 2 3\n")
    text = inspect.getsource(crane) + "fast, slow = crane('fast'), crane('slow')\n"
    (tmp_path / "crane.py").write_text("import casadi as ca\nimport servogen as sg\n\n\n" + text)
    monkeypatch.chdir(tmp_path)
    code, _, err = ends("generate", spec)
    assert code == 2
    assert words in err


def test_wrong_names_of_commands(ends):
    for name, hint in (("genrate", "did you mean generate?"), ("xyz", "there are list, generate, solver")):
        code, _, err = ends(name)
        assert code == 2
        assert f"no command {name!r}; {hint}" in err


@pytest.mark.parametrize(
    ("compiler", "told"),
    [
        ("nonsense", "no C compiler 'nonsense' on this machine"),
        ("cc '", "is no command"),
        ("cc --nonsense", "cc --nonsense -std=c99 -ffp-contract=off -O2 compiles not even an empty function"),
        ("false", "it printed nothing, exit code 1"),
    ],
)
def test_a_wrong_compiler_is_wrong_input(ends, monkeypatch, tmp_path, compiler, told):
    monkeypatch.setenv("CC", compiler)
    monkeypatch.setattr("servogen.cli.simulate.load_simulation", lambda spec: (crane("crane"), sg.Simulation()))
    code, _, err = ends("simulate", "crane", "--no-plots", "--out", tmp_path)
    assert code == 2
    assert told in err


def test_an_empty_CC_is_none(monkeypatch):
    monkeypatch.setenv("CC", " ")
    assert c_compiler() == ["cc"]
    assert c_compiler("cc -m64 '-DA=B C'") == ["cc", "-m64", "-DA=B C"]


def test_what_a_good_compiler_refuses_is_the_codes_fault(tmp_path):
    file = tmp_path / "wrong.c"
    file.write_text("int f(void) { return }\n")
    with pytest.raises(CompilerRefused, match=r"cc refused wrong\.c:\n(.|\n)*error: expected"):
        compile_c(["cc"], ["-O0"], ["-c", str(file), "-o", str(tmp_path / "wrong.o")], "wrong.c")


def test_wrong_flags_of_a_bench_are_wrong_input(ends, tmp_path):
    code, _, err = ends("bench", "spacecraft", "--flags=--nonsense", "--rounds", "1", "--out", tmp_path)
    assert code == 2
    assert "cc --nonsense compiles not even an empty function; check CC and the flags: cc: error:" in err


def test_a_full_disk_is_told_with_the_path(ends, monkeypatch, tmp_path):
    def full(self, *given, **more):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("servogen.cli.generate.load_simulation", lambda spec: (crane("crane"), sg.Simulation()))
    monkeypatch.setattr(Path, "write_text", full)
    code, _, err = ends("generate", "crane", "--out", tmp_path)
    assert code == 2
    assert err.splitlines()[-1].startswith(f"error: {tmp_path}/crane.h: No space left on device; make room there")


def test_a_full_standard_output_is_no_full_folder(tmp_path):
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "servogen.cli.main", "list"]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    assert done.returncode == 2
    assert "standard output: No space left on device; make room where it goes" in done.stderr


def test_a_compiler_without_room_is_no_wrong_compiler(ends, monkeypatch, tmp_path):
    script = tmp_path / "full"
    script.write_text("#!/bin/sh\necho 'x.c: fatal error: x.s: No space left on device' >&2\nexit 1\n")
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))
    monkeypatch.setattr("servogen.cli.simulate.load_simulation", lambda spec: (crane("crane"), sg.Simulation()))
    code, _, err = ends("simulate", "crane", "--no-plots", "--out", tmp_path)
    assert code == 2
    assert f"error: {tempfile.gettempdir()}: No space left on device; make room there" in err


@pytest.mark.filterwarnings("always:scene '")
def test_remarks_are_printed_once(ends, monkeypatch, tmp_path):
    """Whoever builds the scene, and however often."""

    def twice(*given, **more):
        build(*given, **more)
        return build(*given, **more)

    monkeypatch.setattr("servogen.cli.generate.load_simulation", lambda spec: (crane("crane"), sg.Simulation()))
    monkeypatch.setattr("servogen.cli.generate.build", twice)
    for out in ("a", "b"):  # and by the next command again
        code, _, err = ends("generate", "crane", "--out", tmp_path / out)
        assert code == 0
        assert len(err.splitlines()) == 1
        assert err.startswith("warning: scene 'crane': P holds sign, which may jump")


def test_a_solver_with_limits_by_the_command(ends, tmp_path):
    code, out, _ = ends("solver", 1, 2, "--limits", "--out", tmp_path, "--json")
    assert code == 0
    assert json.loads(out)["path"] == str(tmp_path)
    header = (tmp_path / "pinv_1x2.h").read_text()
    assert "const double *lower, const double *upper" in header
    assert "PINV_1X2_LIMIT_CAP" in header


def test_the_table_names_every_command() -> None:
    context = click.Context(main.cli)
    found = [main.cli.get_command(context, name) for name in main.COMMANDS]
    assert [command and command.name for command in found] == list(main.COMMANDS)


def test_who_generates_does_not_wait_for_plots() -> None:
    """scipy and matplotlib took two of the three seconds before any command began."""
    code = "import sys, servogen.cli.main, servogen.cli.generate; print(*{'scipy', 'matplotlib'} & set(sys.modules))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said.split() == []


def test_several_scenes_share_a_core_in_one_folder(ends, tmp_path):
    names = ("skewed_thrusters", "unicycle_path")
    code, out, _ = ends("generate", *names, "--core", "--out", tmp_path, "--json")
    told = json.loads(out)
    assert code == 0
    assert [entry["path"] for entry in told] == [str(tmp_path / name) for name in names]
    assert {entry["core"] for entry in told} == {str(tmp_path / "servogen_core")}
    assert {entry["manifest"]["core"] for entry in told} == {"servogen_core"}
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted([*names, "servogen_core"])
    code, _, err = ends("generate", *names, "--prefix", "p", "--out", tmp_path)
    assert code == 2
    assert "one prefix cannot name 2 packages" in err
