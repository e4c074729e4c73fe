"""How the command ends: one line or one object, and an exit code, whatever happens."""

import json
import subprocess
import sys

import click
import pytest
from servogen.cli import main


@pytest.fixture
def ends(monkeypatch, capsys):
    """ends(*arguments): (exit code, standard output, standard error) of the command."""

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["servogen", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main.main()
        return (end.value.code, *capsys.readouterr())

    return call


def breaks(error):
    def load_scene(spec):
        raise error

    return load_scene


def test_an_unforeseen_error_is_one_line_and_a_code_of_its_own(ends, monkeypatch):
    monkeypatch.setattr("servogen.cli.generate.load_scene", breaks(IndexError("list index\nout of range")))
    code, out, err = ends("generate", "spacecraft")
    assert (code, out) == (3, "")
    assert err.startswith("internal error: IndexError: list index out of range; please report it with")
    assert len(err.splitlines()) == 1
    code, out, err = ends("generate", "spacecraft", "--json")
    assert (code, err) == (3, "")
    assert json.loads(out)["error"].startswith("internal error: IndexError: list index out of range")


def test_its_traceback_is_shown_on_demand(ends, monkeypatch):
    monkeypatch.setattr("servogen.cli.generate.load_scene", breaks(KeyError("tau")))
    monkeypatch.setenv("SERVOGEN_TRACEBACK", "1")
    code, out, err = ends("generate", "spacecraft", "--json")
    assert code == 3
    assert "Traceback" in err
    assert "KeyError" in json.loads(out)["error"]


def test_an_interrupt_is_no_error(ends, monkeypatch):
    monkeypatch.setattr("servogen.cli.generate.load_scene", breaks(KeyboardInterrupt()))
    code, out, err = ends("generate", "spacecraft")
    assert (code, out, err.strip()) == (130, "", "")


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
        ("cases.txt", "cases.txt is no .py file"),
        ("cases.txt:scene", "cases.txt is no .py file"),
    ],
)
def test_wrong_names_of_scenes(ends, monkeypatch, tmp_path, spec, words):
    (tmp_path / "cases.txt").write_text("1 2 3\n")
    monkeypatch.chdir(tmp_path)
    code, _, err = ends("generate", spec)
    assert code == 2
    assert words in err


def test_the_table_names_every_command() -> None:
    context = click.Context(main.cli)
    found = [main.cli.get_command(context, name) for name in main.COMMANDS]
    assert [command and command.name for command in found] == list(main.COMMANDS)


def test_who_generates_does_not_wait_for_plots() -> None:
    """scipy and matplotlib took two of the three seconds before any command began."""
    code = "import sys, servogen.cli.main, servogen.cli.generate; print(*{'scipy', 'matplotlib'} & set(sys.modules))"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said.split() == []
