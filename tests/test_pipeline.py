"""The whole pipeline: the committed C is what the scenes give today, and the command builds a user's own file."""

import json
import os
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
import servogen as sg
from servogen.cli.main import main
from servogen.loading import builtin_names, load_scene
from servogen.verify.generated import committed_folder, compare, regenerate

# ---- generated/ ----


@pytest.fixture(scope="module")
def fresh(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("generated")
    packages = regenerate(folder)
    assert [p.relative_to(folder).as_posix() for p in packages] == [
        f"{n}/{s}" for n in builtin_names() for s in ("f64", "f32")
    ]
    return folder


@pytest.mark.xdist_group("all scenes")  # one process optimises them, and makes the fixture
def test_generated_is_up_to_date(fresh: Path) -> None:
    """Another process, on another day, made the same bytes."""
    changes = compare(committed_folder(), fresh)
    assert not changes, "generated/ is stale; run ./dev generate:\n" + "\n".join(changes)


@pytest.mark.xdist_group("all scenes")
def test_the_comparison_can_fail(fresh: Path, tmp_path: Path) -> None:
    """A changed byte, a file too many, one too few and another line end are each told."""
    changed = tmp_path / "changed"
    shutil.copytree(fresh, changed)
    assert compare(changed, fresh) == []
    source = changed / "spacecraft" / "f64" / "spacecraft.c"
    good = source.read_bytes()
    source.write_bytes(good.replace(b"#include <math.h>", b"#include <tgmath.h>"))
    line = good.splitlines().index(b"#include <math.h>") + 1
    what = f"line {line} is '#include <tgmath.h>', now '#include <math.h>'"
    assert compare(changed, fresh) == [f"spacecraft/f64/spacecraft.c: {what}"]
    ends = "spacecraft/f64/spacecraft.c: one is longer than the other, or its line ends differ"
    for bad in (good.replace(b"\n", b"\r\n"), good + b"\n"):
        source.write_bytes(bad)
        assert compare(changed, fresh) == [ends]
    source.unlink()
    (changed / "old_scene").mkdir()
    (changed / "old_scene" / "old.c").write_text("int x;\n")
    assert compare(changed, fresh) == ["old_scene/old.c: no scene makes it", "spacecraft/f64/spacecraft.c: missing"]


# ---- the command ----

SCENE = '''"""A cart on a rail that keeps its speed."""
import casadi as ca
import servogen as sg
from neighbour import MASS

par = sg.Parameters(m=MASS)
ref = sg.References(v=1.0)
q, u, tau = ca.SX.sym("x"), ca.SX.sym("v"), ca.SX.sym("f")
mech = sg.Mechanism(q=q, u=u, tau=tau, Q=par.m, P=-0.1 * u, G=1.0)
slow = sg.Scene("slow_cart", mech, [sg.Nonholonomic("speed", u - ref.v, -1.0)], parameters=par, references=ref)
scene = sg.Scene("cart", mech, [sg.Nonholonomic("speed", u - ref.v, -5.0)], parameters=par, references=ref)
'''


Done = subprocess.CompletedProcess[str]


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    """The command in this process, which is quicker: here("list", cwd=folder)."""
    monkeypatch.setenv("NO_COLOR", "1")

    def call(*arguments: object, cwd: Path) -> Done:
        argv = ["servogen", *(str(a) for a in arguments)]
        monkeypatch.chdir(cwd)
        monkeypatch.setattr(sys, "argv", argv)
        code: object = 0
        try:
            with warnings.catch_warnings():
                main()
        except SystemExit as stop:
            code = stop.code
        said = capsys.readouterr()
        return Done(argv, int(str(code or 0)), said.out, said.err)

    return call


def command(*arguments: object, cwd: Path) -> Done:
    """The command in a process of its own."""
    argv = [sys.executable, "-m", "servogen.cli.main", *(str(a) for a in arguments)]
    environment = {**os.environ, "COLUMNS": "200", "NO_COLOR": "1"}
    return subprocess.run(argv, cwd=cwd, capture_output=True, text=True, env=environment, stdin=subprocess.DEVNULL)


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    folder = tmp_path / "my scenes"
    folder.mkdir()
    (folder / "neighbour.py").write_text("MASS = 2.5\n")
    file = folder / "cart_model.py"
    file.write_text(SCENE)
    return file


def test_a_users_own_scene(scene_file: Path, tmp_path: Path) -> None:
    done = command("generate", scene_file, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    files = sorted(p.name for p in (tmp_path / "cart").iterdir())
    assert files == ["CMakeLists.txt", "cart.c", "cart.h", "manifest.json"]
    assert "cart_control" in done.stdout
    assert not done.stderr


def test_a_variable_of_the_file_with_every_option(here: Callable[..., Done], scene_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "folder"
    arguments = ("--scalar", "float32", "--prefix", "mine", "--out", out, "--json")
    done = here("generate", f"{scene_file}:slow", *arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["path"] == str(out)
    assert answer["manifest"]["prefix"] == "mine"
    assert answer["manifest"]["scene"] == "slow_cart"
    assert (out / "mine.h").is_file()
    assert json.loads((out / "manifest.json").read_text()) == answer["manifest"]


def test_a_built_in_scene_is_what_the_library_gives(here: Callable[..., Done], tmp_path: Path) -> None:
    done = here("generate", "spacecraft", "--scalar", "float32", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    package = sg.build(load_scene("spacecraft"), scalar="float32")
    for file in package.path.iterdir():
        assert (tmp_path / "spacecraft_f32" / file.name).read_bytes() == file.read_bytes()


def fails(done: Done, *words: str) -> None:
    """Exit code 2, one line on standard error with the words, nothing on standard output."""
    assert done.returncode == 2, (done.stdout, done.stderr)
    assert done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert "Traceback" not in done.stderr
    for word in words:
        assert word in done.stderr, done.stderr


def test_failure_no_such_scene(tmp_path: Path) -> None:
    fails(
        command("generate", "triple_pendulum", cwd=tmp_path),
        "error:",
        "triple_pendulum",
        "did you mean double_pendulum_ideal?",
        ".py",
    )


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("x = 1\ny = 1 / 0\n", 2, ("ZeroDivisionError",)),
        ("x = (\n", 1, ("SyntaxError",)),
        ("\n\nimport no_such_module\n", 3, ("no_such_module",)),
        ("import servogen as sg\npar = sg.Parameters(I=1.0)\n", 2, ("parameter 'I' is a standard macro",)),
        ("raise SystemExit('stopped')\n", 1, ("stopped",)),
    ],
)
def test_failure_in_the_file(
    here: Callable[..., Done], tmp_path: Path, text: str, line: int, words: tuple[str, ...]
) -> None:
    (tmp_path / "broken.py").write_text(text)
    fails(here("generate", "broken.py", cwd=tmp_path), f"broken.py:{line}", *words)


def test_failure_no_scene_in_the_file(here: Callable[..., Done], tmp_path: Path, scene_file: Path) -> None:
    (tmp_path / "empty.py").write_text("x = 1\n")
    fails(here("generate", "empty.py", cwd=tmp_path), "empty.py", "no scene", "variable named scene")
    fails(here("generate", f"{scene_file}:fast", cwd=tmp_path), "no scene 'fast'", "slow")


def test_failure_when_the_scene_is_built(tmp_path: Path, scene_file: Path) -> None:
    """Wrong only in derivation: the constraint is on the position, which the force does not reach."""
    scene_file.write_text(SCENE.replace("u - ref.v, -5.0", "q - ref.v, -5.0"))
    fails(command("generate", scene_file, cwd=tmp_path), "error:", "constraint 'speed' does not reach the controls")


@pytest.mark.parametrize("text", ["list has no [bold] entry", "cannot read a[/b]", "give q[i], not q[/i]"])
def test_failure_with_square_brackets(here: Callable[..., Done], tmp_path: Path, text: str) -> None:
    (tmp_path / "broken.py").write_text(f"raise ValueError({text!r})\n")
    fails(here("generate", "broken.py", cwd=tmp_path), text)


def test_failure_of_options(here: Callable[..., Done], tmp_path: Path) -> None:
    for arguments in (
        ("generate", "spacecraft", "--scalar", "float16"),
        ("generate",),
        ("solver", "0", "3"),
        ("compile",),
    ):
        done = here(*arguments, cwd=tmp_path)
        assert done.returncode == 2, arguments
        assert "Traceback" not in done.stderr


def test_a_scene_file_may_define_dataclasses(here: Callable[..., Done], tmp_path: Path, scene_file: Path) -> None:
    head = "from __future__ import annotations\nfrom dataclasses import dataclass\n"
    scene_file.write_text(head + SCENE + "\n@dataclass\nclass Bar:\n    length: float = 1.0\n")
    assert here("generate", scene_file, cwd=tmp_path).returncode == 0
