"""What controllers share: the same bits as without, the same files in whatever order, and no foreign core touched."""

import ctypes as ct
import filecmp
import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
import servogen as sg
from servogen.render.core import blocks_of
from servogen.scalars import Scalar
from servogen.tools import c_compiler
from servogen.verify.truth import states_to_check
from support.models import awkward_scenes, random_scene

CORE = "servogen_core"
FLAGS = "-std=c99 -O0 -ffp-contract=off -Wall -Wextra -Wpedantic -Wconversion -Wmissing-prototypes -Wshadow -Werror"


def chosen() -> list[tuple[sg.Scene, Scalar]]:
    """Rows with tolerances of their own, ideal forces (two solvers), one row in both scalars, Newton's projection."""
    mixed, row = random_scene(3, "mixed", y="input"), awkward_scenes()["plain"]
    parts = (mixed.mechanism, mixed.constraints, mixed.parameters, mixed.references)
    ideal = sg.Scene("ideal", *parts, mode="ideal")
    return [
        (mixed, "float64"),
        (ideal, "float32"),
        (row, "float64"),
        (row, "float32"),
        (awkward_scenes()["one_cubic"], "float64"),
    ]


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> list[sg.Package]:
    folder = tmp_path_factory.mktemp("image")
    return [sg.build(scene, folder / f"{scene.name}_{scalar}", scalar, core=CORE) for scene, scalar in chosen()]


def test_answers_are_the_bits_of_a_package_alone(image) -> None:
    for package in image:
        scene, scalar = package.scene, package.module.target.scalar
        own, shared = sg.build(scene, scalar=scalar).load(flags=("-O0",)), package.load(flags=("-O0",))
        states, _ = states_to_check(scene, 20)
        functions = ["control", *(f.name for f in scene.system.functions if f.controls and not f.arguments)]
        for k in range(len(states["q"])):
            inputs = {name: values[k] for name, values in states.items()}
            for name in functions:
                a, b = getattr(own, name)(**inputs), getattr(shared, name)(**inputs)
                assert a.value.tobytes() == b.value.tobytes(), (package.prefix, name, k)
                assert repr(a.info) == repr(b.info), (package.prefix, name, k)
            matrix = np.random.default_rng(k).normal(size=scene.system_shape)
            assert own.pinv(matrix).tobytes() == shared.pinv(matrix).tobytes(), (package.prefix, k)


def test_all_link_into_one_image_and_one_supervisor_reads_every_info(image, tmp_path) -> None:
    packages = image
    folder = packages[0].core
    reads = "".join(
        f"    {p.prefix}_input in{k} = {{0}}; {p.prefix}_model model{k}; {p.prefix}_info info{k};\n"
        f"    {'double' if p.module.target.scalar == 'float64' else 'float'} tau{k}[12];\n"
        f"    {p.prefix}_prepare(&{p.prefix}_params_default, &model{k});\n"
        f"    {p.prefix}_control(&model{k}, &in{k}, tau{k}, &info{k});\n"
        f"    worst = worse(worst, &info{k}.status);\n"
        for k, p in enumerate(packages)
    )
    main = "".join(f'#include "{p.prefix}.h"\n' for p in packages) + (
        "int supervise(void);\n"
        "static int worse(int worst, const int *info)\n{\n"
        f"    return info[0] < 0 && info[1] != {CORE.upper()}_PATH_NONE ? 99 : info[2] < 0 ? 98 : worst;\n}}\n"
        f"int supervise(void)\n{{\n    int worst = {CORE.upper()}_OK;\n{reads}    return worst;\n}}\n"
    )
    (tmp_path / "main.c").write_text(main)
    sources = [str(p.path / f"{p.prefix}.c") for p in packages] + [str(folder / f"{CORE}.c"), str(tmp_path / "main.c")]
    includes = [f"-I{f}" for f in (folder, *(p.path for p in packages))]
    library = tmp_path / "image.so"
    command = [*c_compiler(None), *FLAGS.split(), "-fPIC", "-shared", *includes, *sources, "-o", str(library), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert ct.CDLL(str(library)).supervise() == 0
    header = [
        "-x",
        "c++",
        "-fsyntax-only",
        "-Wall",
        "-Werror",
        f"-I{folder}",
        str(packages[0].path / f"{packages[0].prefix}.h"),
    ]
    assert subprocess.run([*c_compiler(None), *header], capture_output=True, text=True).stderr == ""


def test_the_files_depend_on_the_packages_not_on_their_order(tmp_path) -> None:
    all_jobs = chosen()[1:4]
    for order, jobs in (("one", all_jobs), ("other", [*all_jobs[::-1], all_jobs[0]])):
        for scene, scalar in jobs:
            sg.build(scene, tmp_path / order / f"{scene.name}_{scalar}", scalar, core=CORE)
    names = ["CMakeLists.txt", "manifest.json", f"{CORE}.c", f"{CORE}.h"]
    one, other = tmp_path / "one" / CORE, tmp_path / "other" / CORE
    assert sorted(p.name for p in one.iterdir()) == names
    assert filecmp.cmpfiles(one, other, names, shallow=False)[0] == names


def test_what_no_package_needs_any_more_goes(tmp_path) -> None:
    scene = awkward_scenes()["plain"]
    plain = sg.build(scene, tmp_path / "a", prefix="a", core=CORE).core
    before = (plain / f"{CORE}.c").read_text()
    other = sg.Scene("b", scene.mechanism, scene.constraints, solver=sg.Solver(method="svd", damping=0.01))
    sg.build(other, tmp_path / "b", "float32", prefix="b", core=CORE)
    assert (plain / f"{CORE}.c").read_text() != before
    assert json.loads((plain / "manifest.json").read_text())["users"].keys() == {"a", "b"}
    sg.build(scene, tmp_path / "b", prefix="b", core=CORE)
    assert (plain / f"{CORE}.c").read_text() == before


def test_what_is_no_core_is_left_alone_and_named(tmp_path) -> None:
    scene = awkward_scenes()["plain"]
    core = tmp_path / CORE
    core.mkdir()
    (core / "notes.txt").write_text("mine")
    with pytest.raises(sg.SceneError, match="is no core, for it has no manifest\\.json; delete"):
        sg.build(scene, tmp_path / "a", core=CORE)
    assert [p.name for p in core.iterdir()] == ["notes.txt"]
    with pytest.raises(sg.SceneError, match="prefix 'servogen_core_a' collides with the names of the core"):
        sg.build(scene, tmp_path / "other" / "a", prefix=f"{CORE}_a", core=CORE)
    sg.build(scene, tmp_path / "two" / "a", prefix="hover", core=CORE)
    with pytest.raises(sg.SceneError, match=r"prefix 'hover': .*a has it, too, .*clash in one image"):
        sg.build(scene, tmp_path / "two" / "b", prefix="hover", core=CORE)
    with pytest.raises(sg.SceneError, match="core 'no name' is not a C identifier"):
        sg.build(scene, tmp_path / "a", core="no name")


@pytest.mark.parametrize(
    ("file", "edit", "words"),
    [
        (f"{CORE}.c", lambda text: text + "\n", "was changed by hand"),
        ("manifest.json", lambda text: text.replace("servogen 0", "servogen 99.0"), "is of servogen 99.0"),
        ("manifest.json", lambda text: text.replace(f'"core": "{CORE}"', '"core": "x"'), "holds another package"),
        ("manifest.json", lambda text: text[:40], "is incomplete: a file is missing or cut short; delete"),
        ("manifest.json", lambda text: "{}", "holds another package"),
    ],
)
def test_a_core_that_is_not_ours_is_not_extended(tmp_path, file, edit, words) -> None:
    scene = awkward_scenes()["plain"]
    core = sg.build(scene, tmp_path / "a", prefix="a", core=CORE).core
    (core / file).write_text(edit((core / file).read_text()))
    with pytest.raises(sg.SceneError, match=words):
        sg.build(scene, tmp_path / "b", prefix="b", core=CORE)


def test_what_no_package_calls_is_static_and_closed_forms_stay_where_they_are_called(image) -> None:
    """Else compilers could neither inline nor specialise it, and an image of two small controllers would grow."""
    folder = image[0].core
    text, own = (folder / f"{CORE}.c").read_text(), "".join((p.path / f"{p.prefix}.c").read_text() for p in image)
    functions = {b.names[0]: b.text for b, _, _ in blocks_of(text) if b.kind == "function"}
    header = (folder / f"{CORE}.h").read_text()
    hidden = {name for name, code in functions.items() if "static\n" in code}
    assert hidden
    assert hidden != functions.keys()
    assert not any(re.search(rf"\b{name}\(", own + header) for name in hidden)
    assert all(re.search(rf"\b{name}\(", own) or f"{name}(" in header for name in functions.keys() - hidden)
    assert not re.search(r"_1x\d+_\w+\(", text)
    assert re.search(r"^static \w*ALWAYS_INLINE int \w+_solve_core\(", own, re.MULTILINE)


def test_a_core_reads_back_as_it_was_written(image) -> None:
    folder = image[0].core
    text = (folder / f"{CORE}.c").read_text()
    functions = [b for b, _, _ in blocks_of(text) if b.kind == "function"]
    assert len(functions) > 20
    assert all(text[i:j] == b.text for b, i, j in blocks_of(text))
    assert Path(folder / f"{CORE}.h").read_text().count("static inline") > 5
