"""Machine instructions of the generated S z and A B beside CasADi's own C after `cse`, counted by callgrind.

Like with like: the kernels alone, as CasADi's code looks at no result; `servogen bench` counts the checks too.
"""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.bench.instructions import _self_cost
from servogen.loading import load_scene
from support.c import compiler, run

BARS = {
    ("double_pendulum_energy", "gcc"): (3.5, 2.0),
    ("double_pendulum_energy", "clang"): (3.5, 2.0),
    ("spacecraft", "gcc"): (2.5, 2.5),
    ("spacecraft", "clang"): (3.0, 3.0),
}
"""How many times fewer outside the maths library, and in all. Of the spacecraft 3 is asked; gcc packs no lanes."""


@pytest.mark.parametrize("optimisation", ["-O2", "-O3"])
@pytest.mark.parametrize(("name", "cc"), BARS)
def test_fewer_instructions_than_casadi(name: str, cc: str, optimisation: str, tmp_path: Path) -> None:
    ours, theirs = measured(name, cc, optimisation, tmp_path)
    outside, total = BARS[name, cc]
    print(f"{name}, {cc} {optimisation}: servogen {ours}, CasADi cse {theirs} (in all, outside libm)")
    assert theirs[1] >= outside * ours[1]
    assert theirs[0] >= total * ours[0]


def measured(name: str, cc: str, optimisation: str, folder: Path) -> tuple[tuple[float, float], tuple[float, float]]:
    """(in all, outside libm) instructions of one call, of the generated kernel and of CasADi's function."""
    scene = load_scene(name)
    package = sg.build(scene, folder, math="libm")  # both call the same sin and cos
    fields = package.module.inputs
    values = np.random.default_rng(5).uniform(-1, 1, sum(f.size for f in fields)).tolist()
    casadi_c(scene, folder)
    kernel = f"{package.prefix}_eval_{package.module.control.name}" if package.module.control else ""
    members, k = [], 0
    for f in fields:
        numbers = ", ".join(repr(v) for v in values[k : k + f.size])
        members.append(f"{{{numbers}}}" if f.size > 1 else numbers)
        k += f.size
    rows, columns = scene.rows, scene.controls
    arguments = ", ".join(f"x[{k}]" for k in range(len(scene.input_fields())))
    parameters = [v for f in scene.parameters or () for v in f.default]
    (folder / "ours.c").write_text(
        f"""
#include "{package.prefix}.c"
void ours(const {package.prefix}_model *model, const {package.prefix}_input *in, double *a, double *b);
void ours(const {package.prefix}_model *model, const {package.prefix}_input *in, double *a, double *b)
{{
    {kernel}(model, in, a, b);
}}
"""
    )
    main = f"""
#include "{package.prefix}.h"
void ours(const {package.prefix}_model *model, const {package.prefix}_input *in, double *a, double *b);
int theirs(const double **arg, double **res, long long int *iw, double *w, int mem);
int main(void)
{{
    {package.prefix}_model model;
    const {package.prefix}_input in = {{{", ".join(members)}}};
    double x[8][16], p[{len(parameters) + 1}] = {{{", ".join(map(repr, parameters))}}};
    double a[{rows * columns}], b[{rows}], c[{rows * columns}], d[{rows}], w[1000];
    const double *arg[12] = {{{arguments}, p}};
    double *res[8] = {{c, d}};
    long long int iw[8];
    int k;
    for (k = 0; k < 8 * 16; ++k) x[k / 16][k % 16] = 0.1 * (k % 16) - 0.3 + 0.05 * (k / 16);
    {package.prefix}_prepare(&{package.prefix}_params_default, &model);
    for (k = 0; k < 100; ++k) ours(&model, &in, a, b);
    for (k = 0; k < 100; ++k) theirs(arg, res, iw, w, 0);
    return 0;
}}
"""
    (folder / "main.c").write_text(main)
    flags = ["-std=c99", optimisation, "-w", f"-I{folder}"]
    sources = [folder / name for name in ("main.c", "ours.c", "theirs.c")]
    run([compiler(cc), *flags, *sources, "-lm", "-o", folder / "main"])
    costs = []
    for symbol in ("ours", "theirs"):
        profile = folder / f"{symbol}.out"
        options = ["--tool=callgrind", f"--toggle-collect={symbol}", f"--callgrind-out-file={profile}"]
        run(
            [
                "env",
                "LD_BIND_NOW=1",
                compiler("valgrind"),
                *options,
                "--compress-strings=no",
                "--compress-pos=no",
                folder / "main",
            ]
        )
        by_object = _self_cost(profile)
        libm = sum(cost for what, cost in by_object.items() if Path(what).name.startswith("libm"))
        total = sum(by_object.values())
        costs.append((total / 100, (total - libm) / 100))
    return costs[0], costs[1]


def casadi_c(scene: sg.Scene, folder: Path) -> None:
    """What a user of CasADi generates: S and z (A and B) with its own solve of Q, after `cse`."""
    from servogen.bench import user

    expressions = list(user.expressions(scene).values())[:2]
    symbols = [symbol for _, symbol in user.arguments(scene)]
    function = ca.Function("theirs", symbols, ca.cse([expressions[0].T, expressions[1]]))
    generator = ca.CodeGenerator("theirs")
    generator.add(function)
    generator.generate(f"{folder}/")
