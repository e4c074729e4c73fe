"""Ours, Eigen and LAPACK on the same systems in one process: times, errors, instructions, against the bars.

    python -m servogen.bench.solver.run [--shapes 2x3,3x7] [--kappa 0,1e8] [--rounds 40] [--callgrind] [--out DIR]

Needs a C and a C++ compiler, Eigen 3.4, LAPACKE and OpenBLAS; valgrind for --callgrind. kappa 0 means random entries.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import servogen as sg
from servogen import exact
from servogen.bench import instructions
from servogen.scalars import EPSILON, Scalar
from servogen.verify.stress.matrices import with_spectra

HERE = Path(__file__).parent
N = 64
SHAPES = ((2, 3), (3, 4), (3, 7), (6, 7), (6, 12))
FLAGS = ("-O2", "-march=native")
COUNTED_FLAGS = ("-O2", "-march=haswell")  # valgrind knows no AVX-512
NAMES = ("auto", "auto with info", "forced svd", "COD", "JacobiSVD", "gelsd", "gelsy", "gesvj", "uncertified Cholesky")
RANDOM_BARS = {"COD": 6.0, "JacobiSVD": 9.0, "gelsd": 20.0}  # times faster than these, on the NORMAL rung
CONDITIONED_BARS = {"COD": 3.0, "JacobiSVD": 5.0, "gelsd": 12.0}  # on the QR rung
FORCED_BAR, FORCED_BAR_2x3 = 1.8, 3.0  # times faster than JacobiSVD
ERROR_BAR, RIVAL_BAR = 4.0, 1.5  # eps kappa; times the best rival's


def systems(m: int, l: int, scalar: Scalar, kappa: float, generator: Any) -> Any:
    """N systems: entries random (kappa 0), or singular values geometric from 1 to 1/kappa."""
    if kappa == 0:
        S = generator.standard_normal((N, m, l))
    else:
        sigma = kappa ** -np.linspace(0, 1, min(m, l))
        S = with_spectra(m, l, np.array([sigma] * N), generator)
    z = np.einsum("nij,nj->ni", S, generator.standard_normal((N, l)))
    return S.astype(scalar), z.astype(scalar)


def build(
    m: int, l: int, scalar: Scalar, folder: Path, *, callgrind: bool = False, compilers: Any = ("gcc", "g++")
) -> Any:
    """The driver for one shape and scalar."""
    flags = COUNTED_FLAGS if callgrind else FLAGS
    objects = []
    for prefix, solver in (("ours", sg.Solver()), ("forced", sg.Solver(method="svd"))):
        package = sg.build_solver(m, l, folder / prefix, scalar=scalar, prefix=prefix, solver=solver)
        target = folder / f"{prefix}{'-counted' * callgrind}.o"
        source = str(package.path / f"{prefix}.c")
        subprocess.run(
            [compilers[0], "-std=c99", "-ffp-contract=off", *flags, "-c", source, "-o", str(target)], check=True
        )
        objects.append(str(target))
    headers = [f'-D{name.upper()}_HEADER="{folder}/{name}/{name}.h"' for name in ("ours", "forced")]
    defines = [f"-DROWS={m}", f"-DCOLUMNS={l}", "-DOURS=ours", "-DFORCED=forced", *headers]
    defines += ["-DSINGLE"] * (scalar == "float32") + ["-DCALLGRIND"] * callgrind
    program = folder / ("callgrind" if callgrind else "driver")
    rivals = folder / f"rivals-{program.name}.o"
    if not rivals.exists():  # Eigen takes its time
        command = [compilers[1], "-std=c++17", "-DNDEBUG", *flags, "-I/usr/include/eigen3", *defines]
        subprocess.run([*command, "-c", str(HERE / "rivals.cpp"), "-o", str(rivals)], check=True)
    subprocess.run([compilers[1], str(rivals), *objects, "-o", str(program), "-llapacke", "-lopenblas"], check=True)
    return program


def errors(S: Any, z: Any, tau: Any, eps: float) -> Any:
    """Largest error / (eps kappa |tau|), and largest relative error, against exact rationals."""
    scaled, plain = [], []
    for s, b, t in zip(S, z, tau, strict=True):
        if not np.isfinite(t).all():
            return np.inf, np.inf
        matrix = exact.rational(s)
        right = exact.solution(matrix, exact.pinv_full(matrix), exact.rational(b))
        size = float(np.linalg.norm(exact.nearest(right)))
        miss = float(np.linalg.norm(exact.difference(t, right))) / size
        scaled.append(miss / (eps * np.linalg.cond(s.astype(float))))
        plain.append(miss)
    return max(scaled), max(plain)


def measure(m: int, l: int, scalar: Scalar, kappa: float, rounds: int, folder: Path, callgrind: bool) -> Any:
    generator = np.random.default_rng([m, l, int(kappa)])
    S, z = systems(m, l, scalar, kappa, generator)
    data = folder / "systems.bin"
    data.write_bytes(S.astype(float).tobytes() + z.astype(float).tobytes())
    program = build(m, l, scalar, folder)
    done = subprocess.run([str(program), str(data), str(rounds)], check=True, capture_output=True, text=True)
    results = json.loads(done.stdout)
    for result in results.values():
        tau = np.array([np.nan if t is None else t for t in result.pop("tau")]).reshape(N, l)
        result["error"], result["relative"] = errors(S, z, tau.astype(scalar), EPSILON[scalar])
    twin: Any = sg.build_solver(m, l, scalar=scalar).load()
    paths: Any = twin.solve(S, z)[1].path
    if callgrind:
        counting = build(m, l, scalar, folder, callgrind=True)
        for index, name in enumerate(NAMES):
            command = [str(counting), str(data), "1", str(index)]
            results[name]["instructions"] = instructions.collected(command, "--instr-atstart=no") / N
    return {
        "shape": f"{m}x{l}",
        "scalar": scalar,
        "kappa": kappa,
        "paths": sorted({int(p) for p in paths}),
        "results": results,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shapes", default=",".join(f"{m}x{l}" for m, l in SHAPES))
    parser.add_argument("--scalars", default="float64,float32")
    parser.add_argument("--kappa", default="0,1e8", help="float32 takes 1e8 as 1e4")
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--callgrind", action="store_true")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--work", type=Path, help="keep the builds here, and take the rivals' from there")
    chosen = parser.parse_args()
    rows, short = [], []
    for shape in chosen.shapes.split(","):
        m, l = map(int, shape.split("x"))
        for scalar in chosen.scalars.split(","):
            with tempfile.TemporaryDirectory() as name:
                folder = chosen.work / f"{shape}-{scalar}" if chosen.work else Path(name)
                folder.mkdir(parents=True, exist_ok=True)
                for kappa in map(float, chosen.kappa.split(",")):
                    kappa = kappa**0.5 if scalar == "float32" and kappa > 1e6 else kappa
                    rows.append(measure(m, l, scalar, kappa, chosen.rounds, folder, chosen.callgrind))
                    show(rows[-1])
                    short += shortfalls(rows[-1])
    if chosen.out:
        chosen.out.mkdir(parents=True, exist_ok=True)
        (chosen.out / "solver.json").write_text(json.dumps(rows, indent=1) + "\n")
    print("every bar is met" if not short else "short of the bars:\n" + "\n".join(short))
    sys.exit(bool(short))


def shortfalls(row: Any) -> list[str]:
    """The bars that one row of figures misses, in words."""
    results, where = row["results"], f"{row['shape']} {row['scalar']} kappa {row['kappa']:g}"
    ours = results["auto"]
    bars = RANDOM_BARS if row["kappa"] == 0 else CONDITIONED_BARS
    ratios = [(f"auto over {name}", results[name]["best"] / ours["best"], bar) for name, bar in bars.items()]
    forced = results["JacobiSVD"]["best"] / results["forced svd"]["best"]
    ratios.append(("forced svd over JacobiSVD", forced, FORCED_BAR_2x3 if row["shape"] == "2x3" else FORCED_BAR))
    found = [f"{where}: {what} {ratio:.2f}, the bar is {bar:g}" for what, ratio, bar in ratios if ratio < bar]
    rival = min(results[name]["error"] for name in ("COD", "JacobiSVD", "gelsd", "gelsy", "gesvj"))
    if ours["error"] > min(ERROR_BAR, RIVAL_BAR * rival):
        found.append(f"{where}: error {ours['error']:.3g} eps kappa, the best rival's is {rival:.3g}")
    return found


def show(row: Any) -> None:
    results = row["results"]
    ours, forced = results["auto"]["best"], results["forced svd"]["best"]
    print(f"{row['shape']} {row['scalar']} kappa {row['kappa']:g} paths {row['paths']}")
    for name, r in results.items():
        count = f"{r['instructions']:8.0f} instr" if r.get("instructions") else ""
        print(f"   {name:22s}{r['best']:8.0f} ns best {r['median']:8.0f} med  /auto {r['best'] / ours:6.2f}"
              f"  /svd {r['best'] / forced:5.2f}  error {r['error']:8.3g} eps kappa {count}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
