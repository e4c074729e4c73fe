"""Answers within limits beside DAQP and eiquadprog on the same systems, in one process.

    python -m servogen.bench.solver.limited --daqp DIR --eiquadprog DIR [--shapes 3x7] [--systems 300] [--rounds 20]

DIR: sources of https://github.com/darnstrom/daqp and https://github.com/stack-of-tasks/eiquadprog, which no package of
PyPI or Debian brings in a form that can be called from C. Needs a C and a C++ compiler and Eigen. Ratios are of the
systems that a rival answers: stated with S tau = z it answers those alone whose rows can be met.
"""

import argparse
import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np

import servogen as sg

HERE = Path(__file__).parent
REACH = {(3, 7): 1.7, (6, 7): 1.5, (6, 12): 1.6, (4, 6): 1.55}
"""How far, in limits, the tau is drawn that z asks for: about a third of the controls then end at a limit."""


def systems(m: int, l: int, count: int, path: Path) -> None:
    """A file of random systems, each with limits of -1 and 1."""
    generator = np.random.default_rng([m, l])
    S = generator.standard_normal((count, m, l))
    z = np.einsum("nij,nj->ni", S, REACH.get((m, l), 1.6) * generator.uniform(-1, 1, (count, l)))
    y, one = np.zeros((count, l)), np.ones((count, l))
    np.concatenate([[float(count)], *(a.ravel() for a in (S, z, y, -one, one))]).tofile(path)


def build(m: int, l: int, folder: Path, daqp: Path, eiquadprog: Path) -> Path:
    """The driver for one shape."""
    package = sg.build_solver(m, l, folder, prefix="ours", limits=True)
    sources = [*sorted((daqp / "src").glob("*.c")), package.path / "ours.c"]
    objects = []
    for source in sources:
        target = folder / f"{source.stem}.o"
        flags = ["-O2", "-ffp-contract=off"] if source.stem == "ours" else ["-O3"]
        command = ["gcc", "-std=gnu99", "-march=native", *flags, f"-I{daqp / 'include'}", "-c", str(source)]
        subprocess.run([*command, "-o", str(target)], check=True)
        objects.append(str(target))
    program = folder / "driver"
    defines = [f"-DROWS={m}", f"-DCOLUMNS={l}", f'-DOURS_HEADER="{package.path}/ours.h"', "-DOURS=ours_solve"]
    folders = ["-I/usr/include/eigen3", f"-I{daqp / 'include'}", f"-I{eiquadprog / 'include'}"]
    command = ["g++", "-std=c++17", "-O3", "-march=native", "-DNDEBUG", *defines, *folders, str(HERE / "limited.cpp")]
    subprocess.run([*command, *objects, "-o", str(program), "-lm"], check=True)
    return program


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--daqp", type=Path, required=True)
    parser.add_argument("--eiquadprog", type=Path, required=True)
    parser.add_argument("--shapes", default=",".join(f"{m}x{l}" for m, l in REACH))
    parser.add_argument("--systems", type=int, default=300)
    parser.add_argument("--rounds", type=int, default=20)
    chosen = parser.parse_args()
    for shape in chosen.shapes.split(","):
        m, l = map(int, shape.split("x"))
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            systems(m, l, chosen.systems, folder / "systems.bin")
            program = build(m, l, folder, chosen.daqp, chosen.eiquadprog)
            command = [str(program), str(folder / "systems.bin"), str(chosen.rounds)]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
        print(f"{shape}, {chosen.systems} systems")
        for row in json.loads(done.stdout):
            print(f"   {row['name']:27s}{row['answered']:5d} answered{row['ns']:9.0f} ns   over servogen's there:"
                  f" {row['ratio']:5.2f}, least {row['least']:5.2f}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
