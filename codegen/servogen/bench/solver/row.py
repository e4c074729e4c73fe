"""The closed form of a row beside the bare formula, as ratios of run time: what its checks cost.

    python -m servogen.bench.solver.row [--columns 2,3,4] [--rounds 300]

Both at -O2 and without contraction; a pragma writes the bare formula's loops out. With a y the bar is held against the
bare formula refined where y cancels, as ours is; against the plain one, whose errors then grow with y, for information.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import servogen as sg
from servogen.scalars import Scalar

HERE = Path(__file__).parent
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-D_POSIX_C_SOURCE=199309L")
REAL = {"float64": "double", "float32": "float"}
BAR = 1.5  # times the bare formula, checks included
PLAIN, REFINED = ("mild y", "random y"), ("mild y, bare refined", "random y, bare refined")
KINDS = ("without y", *PLAIN, *REFINED)


def measure(l: int, scalar: Scalar, rounds: int, folder: Path) -> list[float]:
    """Ours over bare, in the order of KINDS; mild: a y that needs no refinement."""
    package = sg.build_solver(1, l, folder, scalar=scalar, prefix="ours")
    defines = [f"-DREAL={REAL[scalar]}", f"-DCOLUMNS={l}", f'-DOURS_HEADER="{package.path}/ours.h"']
    sources = [str(source) for source in (package.path / "ours.c", HERE / "bare_row.c", HERE / "row.c")]
    program = folder / "row"
    subprocess.run(["gcc", *FLAGS, *defines, *sources, "-o", str(program), "-lm"], check=True)
    done = subprocess.run([str(program), str(rounds)], check=True, capture_output=True, text=True)
    return [float(ours) / float(bare) for bare, ours in map(str.split, done.stdout.splitlines())]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--columns", default="2,3,4")
    parser.add_argument("--rounds", type=int, default=300)
    chosen = parser.parse_args()
    short = []
    scalars: tuple[Scalar, ...] = ("float64", "float32")
    for l in map(int, chosen.columns.split(",")):
        for scalar in scalars:
            with tempfile.TemporaryDirectory() as folder:
                ratios = measure(l, scalar, chosen.rounds, Path(folder))
            named = [f"{kind} {ratio:.2f}" for kind, ratio in zip(KINDS, ratios, strict=True)]
            print(f"1x{l} {scalar}:", ", ".join(named), flush=True)
            held = [kind not in PLAIN for kind in KINDS]
            each = zip(named, ratios, held, strict=True)
            short += [f"1x{l} {scalar} {what}" for what, ratio, counts in each if counts and ratio > BAR]
    print(f"above {BAR}: " + "; ".join(short) if short else f"all within {BAR}")
    sys.exit(bool(short))


if __name__ == "__main__":
    main()
