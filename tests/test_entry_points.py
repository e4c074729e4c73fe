"""Packages of a few entry points: those alone, prepare, what they call, and the same bits."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
import servogen as sg
from click.testing import CliRunner
from servogen.cli.main import cli
from servogen.compiler import optimised_scene
from servogen.law.law import offered
from servogen.render.unused import without_unused
from support.c import STRICT, compiler, run
from support.models import awkward_scenes, random_scene

SCENES = {n: awkward_scenes()[n] for n in ("plain", "constant_of_parameters", "one_cubic")}
_MIXED = random_scene(8, "nonholonomic", m=1)
SCENES["ideal"] = sg.Scene(
    "ideal", _MIXED.mechanism, _MIXED.constraints, _MIXED.parameters, _MIXED.references, mode="ideal"
)


def functions(package: sg.Package, folder: Path) -> list[str]:
    """The functions with external linkage, of an object that strict compilers take without a word."""
    source, object_file = package.path / f"{package.prefix}.c", folder / "package.o"
    run([compiler("gcc"), *STRICT, "-O1", "-c", source, "-o", object_file])
    named = subprocess.run(["nm", "-g", object_file], capture_output=True, text=True, check=True).stdout
    found = [line.split()[2] for line in named.splitlines() if " T " in line]
    return sorted(name.removeprefix(f"{package.prefix}_") for name in found)


@pytest.mark.parametrize("name", SCENES)
def test_each_alone_compiles_without_a_word(name: str, tmp_path: Path) -> None:
    scene = SCENES[name]
    for entry in offered(optimised_scene(scene)[0].law):
        package = sg.build(scene, tmp_path / entry, entry_points=[entry])
        called = {"step": ["control", "project"]}.get(entry, [])
        extra = ["sqrt"] if "sqrt" in functions(package, tmp_path) else []
        assert functions(package, tmp_path) == sorted({entry, "prepare", *called, *extra}), entry
        assert set(package.manifest["entry_points"]) == {entry, *called}


def test_the_same_bits_and_a_clear_word_for_the_rest(tmp_path: Path) -> None:
    scene = random_scene(3, "mixed", y="input")
    whole, part = sg.build(scene, tmp_path / "whole"), sg.build(scene, tmp_path / "part", entry_points=("control",))
    generator = np.random.default_rng(0)
    fields = {f.name: f.size for f in scene.input_fields()}
    one, other = whole.load(), part.load()
    for _ in range(20):
        state = {name: generator.uniform(-1, 1, size) for name, size in fields.items()}
        a, b = one.control(**state), other.control(**state)
        assert a.value.tobytes() == b.value.tobytes()
        assert a.info == b.info
    sizes = [len((p.path / f"{p.prefix}.c").read_text().splitlines()) for p in (whole, part)]
    assert sizes[1] < 0.8 * sizes[0]
    with pytest.raises(AttributeError, match="built without S; ask for it in entry_points"):
        other.S(**state)


def test_wrong_names_are_told(tmp_path: Path) -> None:
    scene = awkward_scenes()["plain"]
    with pytest.raises(sg.SceneError, match="'tau' is no function of this scene; there are psi, S, z, S_z, pinv"):
        sg.build(scene, tmp_path, entry_points=["tau"])
    with pytest.raises(sg.SceneError, match="none given"):
        sg.build(scene, tmp_path, entry_points=[])
    with pytest.raises(sg.SceneError, match="casadi_abi: the shim calls control"):
        sg.build(scene, tmp_path, entry_points=["S"], casadi_abi=True)


def test_the_command(tmp_path: Path) -> None:
    arguments = ["generate", "double_pendulum_energy", "--out", str(tmp_path), "--entry-points"]
    done = CliRunner().invoke(cli, [*arguments, "S, z"])
    assert done.exit_code == 0, done.output
    text = (tmp_path / "double_pendulum_energy.h").read_text()
    assert "double_pendulum_energy_S(" in text
    assert "double_pendulum_energy_control(" not in text
    refused = CliRunner().invoke(cli, [*arguments, "S,tau"]).exception
    assert isinstance(refused, sg.SceneError)
    assert "'tau' is no function of this scene" in str(refused)


def test_only_what_nothing_names_is_left_out() -> None:
    text = """/* Used. */
static int used(int x)
{
    return x;
}

/* Called by nothing but the next. */
static int inner(int x)
{
    return x;
}

static inline int outer(int x)
{
    return inner(x);
}

int shown(int x)
{
    return used(x);
}
"""
    kept = without_unused(text)
    assert "inner" not in kept
    assert "outer" not in kept
    assert kept == text[: text.index("/* Called")] + text[text.index("int shown") :]
    assert without_unused(kept) == kept
