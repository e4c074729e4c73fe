"""Run time against error of the solver alone, over the condition: the data of the work-precision diagrams.

In one run on the same systems with the same flags: every step of ours, CasADi's own C, Eigen and LAPACK in C++, numpy
and scipy from Python. Times are of solves with all their checks; errors are against exact rationals.
"""

import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from servogen import exact
from servogen.bench.solver import contenders
from servogen.bench.solver.contenders import FLAGS, HERE, LIBRARIES, PYTHON, Variant
from servogen.results import FloatArray
from servogen.scalars import EPSILON, Scalar
from servogen.tools import find_tool
from servogen.verify.stress.matrices import MODES, with_spectra

SHAPES = ((2, 3), (3, 4), (3, 7), (6, 7), (6, 12))
SYSTEMS = 48  # of each condition
ROUNDS = 12

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class Point:
    """One contender at one condition. Nanoseconds a solve: median and worst over the systems, of each its best round;
    p999: 99.9th percentile over all systems and rounds, the machine's own noise included. error: largest, over
    eps kappa |tau|; relative: largest, over |tau|; infinite where an answer is not finite."""

    contender: str
    kind: str  # "ours", "C" or "Python"
    shape: str
    scalar: Scalar
    kappa: float
    median: float
    p999: float
    worst: float
    error: float
    relative: float


@dataclass(frozen=True)
class WorkPrecision:
    """points: every contender at every shape, scalar and condition. missing: rivals not here, and the remedy."""

    compiler: str
    flags: tuple[str, ...]
    systems: int
    rounds: int
    seed: int
    points: tuple[Point, ...]
    missing: tuple[str, ...]

    def facet(self, shape: str, scalar: str, kappa: float) -> list[Point]:
        return [p for p in self.points if (p.shape, p.scalar, p.kappa) == (shape, scalar, kappa)]


def decades(scalar: Scalar) -> tuple[float, ...]:
    """1 to 1e14; to 1e5 in float32, beyond which the smallest singular value nears rtol and may be cut off."""
    return tuple(10.0**k for k in range(15 if scalar == "float64" else 6))


def measure(
    shapes: Sequence[tuple[int, int]] = SHAPES,
    scalars: Sequence[Scalar] = ("float64", "float32"),
    *,
    systems: int = SYSTEMS,
    rounds: int = ROUNDS,
    seed: int = 1,
    peers: bool = True,
    progress: Progress | None = None,
) -> WorkPrecision:
    """Everything measured. peers=False leaves out Eigen and LAPACK. Raises ToolMissing without gcc and g++."""
    compiler = str(find_tool("g++", "g++"))
    find_tool("gcc", "gcc")
    here = [library for library in LIBRARIES if peers and library.here(compiler)]
    missing = tuple(
        f"{library.name}: not installed; to have it: apt-get install {library.packages}"
        for library in LIBRARIES
        if peers and library not in here
    )
    points: list[Point] = []
    work = [(m, l, scalar) for m, l in shapes for scalar in scalars]
    for done, (m, l, scalar) in enumerate(work):
        if progress is not None:
            progress(done, len(work), f"{m}x{l} {scalar}")
        points += _measure_shape(m, l, scalar, systems, rounds, seed, here)
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True).stdout.splitlines()[0]
    return WorkPrecision(version, FLAGS, systems, rounds, seed, tuple(points), missing)


def _measure_shape(
    m: int, l: int, scalar: Scalar, systems: int, rounds: int, seed: int, here: Sequence[contenders.Library]
) -> list[Point]:
    generator = np.random.default_rng([seed, m, l])
    conditions = decades(scalar)
    S, z = draw(m, l, scalar, conditions, systems, generator)
    chosen = contenders.variants(scalar)
    with tempfile.TemporaryDirectory(prefix="servogen-precision-") as name:
        folder = Path(name)
        program = build(m, l, scalar, chosen, folder, here)
        data, found = folder / "systems.bin", folder / "found.bin"
        data.write_bytes(S.astype(np.float64).tobytes() + z.astype(np.float64).tobytes())
        argv = [str(program), str(data), str(len(S)), str(rounds), str(found)]
        names = subprocess.run(argv, check=True, capture_output=True, text=True).stdout.splitlines()
        numbers = np.fromfile(found).reshape(len(names), -1)
    times: dict[str, FloatArray] = {
        n: row[: rounds * len(S)].reshape(rounds, len(S)) for n, row in zip(names, numbers, strict=True)
    }
    taus: dict[str, FloatArray] = {
        n: row[rounds * len(S) :].reshape(len(S), l) for n, row in zip(names, numbers, strict=True)
    }
    for label, call in PYTHON.items():
        times[label], taus[label] = _time_in_python(call, S, z, max(2, rounds // 4))
    ours = {variant.name for variant in chosen}
    kinds = {n: "ours" if n in ours else "Python" if n in PYTHON else "C" for n in times}
    right = truths(S, z)
    errors = {n: relative_errors(tau, right) for n, tau in taus.items()}
    kappa = np.linalg.cond(S.astype(np.float64))
    points = []
    for k, condition in enumerate(conditions):
        own = slice(k * systems, (k + 1) * systems)
        for label, rows in times.items():
            best = rows[:, own].min(axis=0)
            relative = errors[label][own]
            points.append(
                Point(
                    label,
                    kinds[label],
                    f"{m}x{l}",
                    scalar,
                    condition,
                    float(np.median(best)),
                    float(np.percentile(rows[:, own], 99.9)),
                    float(best.max()),
                    float((relative / (EPSILON[scalar] * kappa[own])).max()),
                    float(relative.max()),
                )
            )
    return points


def draw(
    m: int, l: int, scalar: Scalar, conditions: Sequence[float], systems: int, generator: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """`systems` of each condition: the dlatms spectra that have exactly that, in random bases; z = S x."""
    modes = [MODES[name] for name in ("geometric", "one small", "one large", "arithmetic")]
    sigma = np.array(
        [modes[i % len(modes)](min(m, l), kappa, generator) for kappa in conditions for i in range(systems)]
    )
    S = with_spectra(m, l, sigma, generator).astype(scalar)
    z = np.einsum("nij,nj->ni", S.astype(np.float64), generator.standard_normal((len(S), l)))
    return S, z.astype(scalar)


def build(
    m: int,
    l: int,
    scalar: Scalar,
    chosen: Sequence[Variant],
    folder: Path,
    here: Sequence[contenders.Library],
) -> Path:
    """The program that times all contenders in C and C++."""
    gcc, gxx = str(find_tool("gcc", "gcc")), str(find_tool("g++", "g++"))
    sources = [contenders.generate(m, l, scalar, variant, folder) for variant in chosen]
    sources.append(contenders.casadi_pinv(m, l, scalar, folder))
    objects = []
    for source in sources:
        objects.append(str(source.with_suffix(".o")))
        command = [gcc, "-std=c99", "-ffp-contract=off", *FLAGS, "-c", str(source), "-o", objects[-1]]
        subprocess.run(command, check=True, capture_output=True)
    (folder / "ours.hpp").write_text(contenders.header(m, l, scalar, tuple(chosen)))
    defines = [f"-DROWS={m}", f"-DCOLUMNS={l}", '-DOURS="ours.hpp"', "-DNDEBUG"] + ["-DSINGLE"] * (scalar == "float32")
    defines += [f"-D{library.define}" for library in here]
    compile_flags = [flag for library in here for flag in library.compile]
    link = [flag for library in here for flag in library.link]
    program = folder / "precision"
    command = [gxx, "-std=c++17", *FLAGS, f"-I{folder}", f"-I{HERE}", *compile_flags, *defines]
    command += [str(HERE / "precision.cpp"), *objects, "-o", str(program), *link, "-lm"]
    subprocess.run(command, check=True, capture_output=True)
    return program


def _time_in_python(
    call: Callable[[FloatArray, FloatArray], FloatArray], S: FloatArray, z: FloatArray, rounds: int
) -> tuple[FloatArray, FloatArray]:
    """Nanoseconds (rounds, N) of single calls, and the answers (N, l)."""
    tau = np.array([call(s, b) for s, b in zip(S, z, strict=True)], np.float64)
    times = np.empty((rounds, len(S)))
    for row in times:
        for i, (s, b) in enumerate(zip(S, z, strict=True)):
            start = time.perf_counter_ns()
            call(s, b)
            row[i] = time.perf_counter_ns() - start
    return times, tau


def truths(S: FloatArray, z: FloatArray) -> list[exact.Matrix]:
    """S+ z of each system, in rationals."""
    return [exact.pinv_full(s) * exact.rational(b) for s, b in zip(map(exact.rational, S), z, strict=True)]


def relative_errors(tau: FloatArray, right: Sequence[exact.Matrix]) -> FloatArray:
    """|tau - right| / |right| of each system; infinite where tau is not finite."""
    found = np.full(len(tau), np.inf)
    for i in np.flatnonzero(np.isfinite(tau).all(axis=1)).tolist():
        found[i] = np.linalg.norm(exact.difference(tau[i], right[i])) / np.linalg.norm(exact.nearest(right[i]))
    return found
