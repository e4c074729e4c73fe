"""What the README and the docs show works as it stands."""

import json
import math
import re
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from servogen.cli.main import cli

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text()
PYTHON = (ROOT / "codegen" / "docs" / "python.md").read_text()

DEGREES = (ROOT / "codegen" / "docs" / "relative_degree.md").read_text()

BATCHES = (ROOT / "codegen" / "docs" / "batches.md").read_text()


def block(language: str, text: str = README) -> str:
    return re.search(rf"```{language}\n(.*?)```", text, re.DOTALL).group(1)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "crane.py").write_text(block("python"))
    return tmp_path


def servogen(folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "servogen.cli.main", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


def test_the_scene_generates_and_the_c_compiles(folder, need_tool):
    assert len(block("python").splitlines()) <= 30
    done = servogen(folder, "generate", "crane.py")
    assert done.returncode == 0, done.stderr
    (folder / "main.c").write_text(block("c") + MAIN)
    strict = "-std=c99 -Wall -Wextra -Wpedantic -Wconversion -Wdouble-promotion -Wshadow -Werror".split()
    named = re.search(r"^    (gcc .*?)(?: *#.*)?$", README, re.MULTILINE).group(1).split()
    command = [need_tool("gcc", "gcc"), *strict, *named[1:], "-o", "main"]
    subprocess.run(command, cwd=folder, check=True)
    assert subprocess.run([folder / "main"], capture_output=True, text=True).returncode == 0


MAIN = """
#include <math.h>
void start(void);
void tick(const double q[2], const double u[2], double tau[2]);
int main(void)
{
    const double q[2] = {0.1, 0.5}, u[2] = {0.2, -0.1}, bad[2] = {NAN, 0.0};
    double tau[2] = {7.0, 7.0};
    start();
    tick(bad, u, tau);
    if (tau[0] != 7.0) return 1;
    tick(q, u, tau);
    return !(tau[0] != 7.0 && isfinite(tau[0]) && isfinite(tau[1]));
}
"""


def test_the_scene_passes_its_check(folder):
    done = servogen(folder, "check", "crane.py", "--states", "50")
    assert done.returncode == 0, done.stderr + done.stdout


def test_the_simulation_of_the_docs_runs_as_they_say(tmp_path):
    (tmp_path / "cart.py").write_text(block("python", PYTHON))
    done = servogen(tmp_path, "simulate", "cart.py", "--no-plots", "--json")
    assert done.returncode == 1, done.stderr + done.stdout  # it ends before its time
    told = json.loads(done.stdout)
    assert told["verdict"]["word"] == "stopped: end of the track"
    assert told["stop"]["event"] == "end of the track"
    assert told["constraint_error"] < 1e-9
    assert told["decay_error"]["lag"] < 1e-9


def test_the_cars_of_the_docs_are_as_they_say(capsys):
    exec(block("python", DEGREES), {})
    said = capsys.readouterr().out
    assert "relative degree: 'first' 4\n" in said
    assert "psi is a flat output" in said


def test_the_batches_of_the_docs_run_as_they_say(tmp_path, monkeypatch, capsys):
    """A map of the workspace is drawn, and training makes the arm's spare motion smaller."""
    monkeypatch.chdir(tmp_path)
    for code in re.findall(r"```python\n(.*?)```", BATCHES, re.DOTALL):
        exec(compile(code, "batches.md", "exec"), {})  # here, where the searches of both scenes may be at hand
    assert (tmp_path / "workspace.png").stat().st_size > 10_000
    unrest = [float(x) for x in re.findall(r"unrest (\S+)", capsys.readouterr().out)]
    assert len(unrest) == 5
    assert unrest[-1] < 0.95 * unrest[0]


def test_the_units_of_the_docs_run_as_they_say(tmp_path):
    """v' = -2 (v - 1.5) from 0.2: 1.0218 m/s after half a second, up to what the hold of 1 ms leaves."""
    for name, text in zip(
        ("cart", "cart_units"), re.findall(r"```python\n(.*?)```", PYTHON, re.DOTALL)[:2], strict=True
    ):
        (tmp_path / f"{name}.py").write_text(text)
    done = subprocess.run([sys.executable, "cart_units.py"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout.split()[0]) == pytest.approx(1.5 - 1.3 * math.exp(-1.0), abs=1e-3)


def test_the_controller_in_mujoco_runs_as_the_docs_say(tmp_path, need_module):
    """v' = -2 (v - 1.5) from rest: 1.4963 m/s after three seconds, up to what the hold of 2 ms leaves."""
    need_module("mujoco", "mujoco")
    cart, _, in_mujoco = re.findall(r"```python\n(.*?)```", PYTHON, re.DOTALL)
    (tmp_path / "cart.py").write_text(cart)
    (tmp_path / "cart_in_mujoco.py").write_text(in_mujoco)
    done = subprocess.run([sys.executable, "cart_in_mujoco.py"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout.split()[0]) == pytest.approx(1.5 * (1 - math.exp(-6)), abs=1e-3)


def test_the_commands_it_names_exist():
    names = set(re.findall(r"^    servogen (\w+)", README, re.MULTILINE))
    assert len(names) > 5
    for name in names:
        assert CliRunner().invoke(cli, [name, "--help"]).exit_code == 0, name
