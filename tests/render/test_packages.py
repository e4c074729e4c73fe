"""The files of a package: valid C99 and C++, quiet under strict flags, no hidden doubles, the same bytes always."""

import dataclasses
import hashlib
import json
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import casadi as ca
import pytest
import servogen as sg
from servogen.loading import builtin_names, load_scene
from support.c import STRICT, compiler, run
from support.missing import skip_or_fail
from support.models import awkward_scenes

pytestmark = pytest.mark.xdist_group("all scenes")  # one process optimises them, and makes the fixture

SCALARS = ("float64", "float32")


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> list[sg.Package]:
    """Every built-in scene, every awkward one and two solvers, for both scalars, side by side in one folder."""
    folder = tmp_path_factory.mktemp("packages")
    scenes = [load_scene(n) for n in builtin_names()] + list(awkward_scenes().values())
    built = [sg.build(s, folder / f"{s.name}_{x}", x) for s in scenes for x in SCALARS]  # type: ignore[arg-type]
    for x in SCALARS:
        built += [sg.build_solver(m, l, folder / f"pinv_{m}{l}_{x}", x) for m, l in ((1, 3), (3, 2))]  # type: ignore[arg-type]
    return built


def sources(packages: list[sg.Package]) -> list[Path]:
    return [p.path / f"{p.prefix}.c" for p in packages]


def include(packages: list[sg.Package]) -> list[str]:
    return [f"-I{p.path}" for p in packages]


ROUGHEST = {
    "double_pendulum_energy",
    "spacecraft_smooth",
    "everything",
    "everything_tau",
    "one_cubic",
    "every_operation",
}


def compile_all(command: list[str], files: list[Path], folder: Path) -> None:
    """One call of the compiler, its objects in a folder."""
    done = subprocess.run([*command, *map(str, files)], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("command", ["gcc", "clang"])
def test_strict_flags(packages: list[sg.Package], command: str, tmp_path: Path) -> None:
    """All of them under the design's flags; the roughest also with what only optimisation sees."""
    compile_all([compiler(command), *STRICT, "-fsyntax-only"], sources(packages), tmp_path)
    rough = [p for p in packages if p.module.scene in ROUGHEST and p.module.target.scalar == "float64"]
    assert len(rough) == len(ROUGHEST)
    if command == "gcc":
        compile_all([compiler(command), *STRICT, "-O1", "-c"], sources(rough), tmp_path)


def test_headers_alone_in_c_and_cxx(packages: list[sg.Package], tmp_path: Path) -> None:
    """Each header compiles on its own and twice over, all of them in one unit; C and C++."""
    lines = [f'#include "{p.prefix}.h"\n#include "{p.prefix}.h"' for p in packages]
    for p in packages:
        lines.append(f"{p.prefix}_info last_{p.prefix};")
    text = "\n".join(lines) + "\n"
    for suffix, command, flags in (
        ("c", "gcc", [f for f in STRICT if f != "-Wmissing-prototypes"]),
        ("cpp", "g++", ["-std=c++11", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]),
        ("cc", "g++", ["-std=c++20", "-Wall", "-Wextra", "-Werror"]),
    ):
        unit = tmp_path / f"all.{suffix}"
        unit.write_text(text)
        run([compiler(command), *flags, "-fsyntax-only", *include(packages), unit])
    for p in packages[:2]:
        for language, command in (("c", "gcc"), ("c++", "g++")):
            run(
                [
                    compiler(command),
                    "-x",
                    language,
                    "-Wall",
                    "-Wextra",
                    "-Werror",
                    "-fsyntax-only",
                    p.path / f"{p.prefix}.h",
                ]
            )


def test_two_packages_in_one_image(packages: list[sg.Package], tmp_path: Path) -> None:
    """f64 and f32 of one scene, another scene and a solver, called from C++; nothing but the API is visible."""
    chosen = [p for p in packages if p.prefix in ("spacecraft", "spacecraft_f32", "plain", "pinv_3x2")]
    assert len(chosen) == 4
    main = tmp_path / "main.cpp"
    calls = [
        f"    {{ {p.prefix}_model model; {p.prefix}_input in = {p.prefix}_input(); {p.module.target.real} out[3];\n"
        f"      if ({p.prefix}_prepare(&{p.prefix}_params_default, &model) != 0) return 1;\n"
        f"      if ({p.prefix}_control(&model, &in, out, 0) < 0) return 2; }}"
        for p in chosen
        if p.scene
    ]
    head = "".join(f'#include "{p.prefix}.h"\n' for p in chosen)
    main.write_text(head + "int main() {\n" + "\n".join(calls) + "\n    return 0;\n}\n")
    objects = []
    for p in chosen:
        objects.append(tmp_path / f"{p.prefix}.o")
        run([compiler("gcc"), "-O1", "-c", p.path / f"{p.prefix}.c", "-o", objects[-1]])
        names = re.findall(r" ([A-Z]) (\w+)$", run(["nm", objects[-1]]), re.MULTILINE)
        defined = {n for kind, n in names if kind in "TDRB"}
        assert all(n.startswith(f"{p.prefix}_") for n in defined)
        declared = set(re.findall(rf"\b({p.prefix}_\w+)\(", (p.path / f"{p.prefix}.h").read_text()))
        declared |= {f"{p.prefix}_params_default"} if p.scene else set()
        assert defined == declared
        assert not [n for kind, n in names if kind in "DBdb"]  # nothing that changes
    run([compiler("g++"), *include(chosen), main, *objects, "-lm", "-o", tmp_path / "main"])
    run([tmp_path / "main"])


def test_float_means_float(packages: list[sg.Package], tmp_path: Path) -> None:
    """On a Cortex-M4 no software double is called, and nothing but <math.h> is needed."""
    gcc = compiler("arm-none-eabi-gcc")
    flags = "-mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard -std=c99 -O1 -Wdouble-promotion -Werror".split()
    singles = [p for p in packages if p.module.target.scalar == "float32" and p.module.scene in {*ROUGHEST, "pinv_3x2"}]
    probe = tmp_path / "probe.c"
    probe.write_text("#include <math.h>\n")
    if subprocess.run([gcc, "-fsyntax-only", str(probe)], capture_output=True).returncode != 0:
        skip_or_fail("arm-none-eabi-gcc has no C library; apt-get install libnewlib-arm-none-eabi")
    compile_all([gcc, *flags, "-c"], sources(singles), tmp_path)
    needed: set[str] = set()
    for p in singles:
        listing = run([compiler("arm-none-eabi-nm"), tmp_path / f"{p.prefix}.o"])
        needed |= set(re.findall(r" U (\w+)", listing))
        text = (p.path / f"{p.prefix}.c").read_text() + (p.path / f"{p.prefix}.h").read_text()
        assert not re.search(r"\bdouble\b", text)
        code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
        assert not re.search(r"(?<![\w.])\d+\.\d+(?:e[+-]?\d+)?(?![\w.])", code)  # every literal has its f
    library = {n for n in needed if not n.startswith("__aeabi_")} - {"memcpy", "memset", "memmove"}
    assert not [n for n in needed if n.startswith("__aeabi_d")]
    assert all(n.endswith("f") for n in library), library


def test_doubles_have_no_suffix(packages: list[sg.Package]) -> None:
    for p in packages:
        if p.module.target.scalar == "float64":
            code = re.sub(r"/\*.*?\*/", "", (p.path / f"{p.prefix}.c").read_text(), flags=re.DOTALL)
            code = code.replace("#include <float.h>", "")
            assert not re.search(r"\d\.\d*(e[+-]?\d+)?f\b|\bfloat\b|\b(sin|cos|sqrt|pow|fabs)f\(", code)


def test_no_heap_no_recursion_no_long_double(packages: list[sg.Package]) -> None:
    for p in packages:
        code = re.sub(r"/\*.*?\*/", "", (p.path / f"{p.prefix}.c").read_text(), flags=re.DOTALL)
        for word in (r"malloc|calloc|realloc|free", r"long\s+double", r"goto", r"printf|assert|abort", r"while\s*\("):
            assert not re.search(rf"\b(?:{word})", code), (p.prefix, word)
        assert set(re.findall(r"#include <(\S+)>", code)) <= {"float.h", "stddef.h", "stdint.h", "math.h"}
        for match in re.finditer(r"^\s*static (?!const )[^(\n]*[;=]", code, re.MULTILINE):  # data that could change
            pytest.fail(f"{p.prefix}: {match[0]}")


def test_fast_math_is_refused(packages: list[sg.Package]) -> None:
    source = sources(packages)[0]
    done = subprocess.run(
        [compiler("gcc"), "-ffast-math", "-fsyntax-only", str(source)], capture_output=True, text=True
    )
    assert done.returncode != 0
    assert "-ffast-math" in done.stderr


BUILD = """
import sys
from pathlib import Path
from render.test_packages import build_some
build_some(Path(sys.argv[1]))
"""


def build_some(folder: Path) -> None:
    """Scenes of every kind, both scalars."""
    for name in ("double_pendulum_energy", "spacecraft_smooth"):
        sg.build(load_scene(name), folder / name, "float32")
    scenes = awkward_scenes()
    for name in ("everything", "everything_tau", "columns", "every_operation"):
        sg.build(scenes[name], folder / name)


def test_same_scene_same_bytes_in_two_processes(tmp_path: Path) -> None:
    """Whatever the order of hashes, the working folder, the locale and the time zone: this process and another."""
    script = tmp_path / "build.py"
    script.write_text(BUILD)
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
    build_some(here)
    paths = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    seed = "4242" if os.environ.get("PYTHONHASHSEED") != "4242" else "1"
    other = {"PYTHONHASHSEED": seed, "TZ": "Asia/Tokyo", "LC_ALL": "C", "HOME": str(tmp_path), "PYTHONPATH": paths}
    subprocess.run([sys.executable, str(script), str(there)], check=True, cwd=there, env={**os.environ, **other})
    results = [
        {p.relative_to(folder): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
        for folder in (here, there)
    ]
    assert len(results[0]) == 24
    assert results[0] == results[1]


def test_nothing_of_this_machine_in_the_files(packages: list[sg.Package]) -> None:
    """No dates, no paths, no host or user names."""
    host = socket.gethostname()
    for p in packages:
        for file in p.path.iterdir():
            text = file.read_text(encoding="utf-8")
            assert not re.search(r"\b(19|20)\d\d-\d\d-\d\d\b|\b\d\d:\d\d:\d\d\b", text), file
            assert str(p.path) not in text
            assert "/tmp" not in text
            assert "/home" not in text
            assert len(host) < 4 or host not in text
            assert "\r" not in text
            assert "\t" not in text
            assert text.endswith("\n")
            assert not re.search(r"[ \t]+$", text, re.MULTILINE), file
            assert "None" not in text.replace("None of", "")
            assert "{{" not in text


def test_header_says_when_the_solver_damps() -> None:
    """_pinv and control name REGULARISED where it can occur, and nowhere else; _pinv lists all its statuses."""

    def said(solver: sg.Solver, name: str) -> dict[str, str]:
        package = sg.build(dataclasses.replace(load_scene(name), solver=solver))
        header = (package.path / f"{name}.h").read_text()
        comment = r"/\*((?:(?!\*/).)*)\*/\s*int {}_{}\("
        return {e: re.search(comment.format(name, e), header, re.DOTALL).group(1) for e in ("pinv", "control")}  # type: ignore[union-attr]

    for name in ("spacecraft", "planar_arm_3r"):
        plain, damped = said(sg.Solver(), name), said(sg.Solver(damping=0.02), name)
        assert "amp" not in "".join(plain.values())
        assert "below e = 0.02" in damped["pinv"]
        for text in damped.values():
            assert "REGULARISED" in text
        for text in (plain["pinv"], damped["pinv"]):
            assert set(re.findall(r"[A-Z_]{5,}", text)) - {"REGULARISED"} == {
                "RANK_DEFICIENT_CONSISTENT",
                "NONFINITE",
                "OVERFLOW",
            }


def test_manifest(packages: list[sg.Package]) -> None:
    for p in packages:
        manifest = json.loads((p.path / "manifest.json").read_text())
        assert manifest == p.manifest
        assert manifest["prefix"] == p.prefix
        assert manifest["scalar"] == p.module.target.scalar
        assert re.fullmatch(r"[0-9a-f]{64}", manifest["scene_hash"])
        assert set(manifest["files"]) == {f"{p.prefix}.h", f"{p.prefix}.c", "CMakeLists.txt"}
        for name, digest in manifest["files"].items():
            assert hashlib.sha256((p.path / name).read_bytes()).hexdigest() == digest
        header = (p.path / f"{p.prefix}.h").read_text()
        assert manifest["scene_hash"][:16] in header
        for entry, said in manifest["entry_points"].items():
            assert f"int {p.prefix}_{entry}(" in header
            counts = dict(said["operations"])
            assert counts.pop("total") == sum(counts.values())


def test_operations_are_those_in_the_code(packages: list[sg.Package]) -> None:
    """The manifest's counts, against the statements that were printed."""
    for p in packages:
        code = (p.path / f"{p.prefix}.c").read_text()
        for entry in p.module.entry_points:
            body = re.search(rf"static (?:\w+ )?void {p.prefix}_eval_{entry.kernel.name}\(.*?\n}}", code, re.DOTALL)
            assert body is not None
            statements = len(re.findall(r"^    const (?:double|float) t\d+ = ", body[0], re.MULTILINE))
            statements += 2 * len(re.findall(r"^    const \w+_pair t\d+ = ", body[0], re.MULTILINE))  # sine and cosine
            assert statements == p.manifest["entry_points"][entry.name]["operations"]["total"], (p.prefix, entry.name)


def test_prefixes() -> None:
    scene = awkward_scenes()["plain"]
    assert sg.build(scene).prefix == "plain"
    assert sg.build(scene, scalar="float32").prefix == "plain_f32"
    assert sg.build(scene, prefix="mine").prefix == "mine"
    assert sg.build_solver(2, 3, scalar="float32").prefix == "pinv_2x3_f32"


def test_a_default_that_does_not_fit_names_its_parameter() -> None:
    par = sg.Parameters(huge=1e39)
    q, u, tau = ca.SX.sym("q"), ca.SX.sym("u"), ca.SX.sym("tau")
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=1.0, P=0.0, G=1.0)
    scene = sg.Scene("test", mech, [sg.Nonholonomic("c", u + q / par.huge, -1.0)], par)
    assert sg.build(scene).manifest["parameters"]["huge"]["default"] == [1e39]
    with pytest.raises(sg.SceneError, match=r"parameter 'huge'.*1e\+39 is too large for float32"):
        sg.build(scene, scalar="float32")
