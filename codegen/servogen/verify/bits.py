"""One hash of all outputs over all vectors, from every compiler, level and board: python -m servogen.verify.bits.

With --solvers 3x7 ..., one hash of 20,000 solves of each of these shapes instead, singular ones among them.
"""

import argparse
import hashlib
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from servogen.compiler import build, build_solver
from servogen.plan.mathematics import Math
from servogen.scene.loading import builtin_names, load_scene
from servogen.scene.scene import Scene
from servogen.scene.solver import EPSILON, Scalar
from servogen.verify.harness import HarnessResult, default_states, hash_solvers, run_harness, targets
from servogen.verify.truth import Truth, states_to_check

LEVELS = ("-O0", "-O1", "-O2", "-O3")
SYSTEMS = 20_000


class Build(NamedTuple):
    """A way to compile and a place to run."""

    target: str
    compiler: str
    level: str


def builds(boards: Iterable[str], levels: Sequence[str] = LEVELS) -> list[Build]:
    """gcc and clang on this machine at every level, and the boards: at every level where they have room."""
    found = [Build("host", compiler, level) for compiler in ("gcc", "clang") for level in levels]
    for board in boards:
        small = default_states(board, 0) > 0
        found += [Build(board, "gcc", level) for level in (("-O2",) if small else levels)]
    return found


def hashes(
    scenes: Sequence[Scene], where: Sequence[Build], states: int, math: Math = "own", seed: int = 0
) -> dict[str, dict[Build, str]]:
    """By prefix, then by build: a digest over the harness' hashes of every output; "failed: ..." where a run fails."""
    scalars: tuple[Scalar, ...] = ("float64", "float32")
    assert set(scalars) == set(EPSILON)
    found: dict[str, dict[Build, str]] = {}
    with tempfile.TemporaryDirectory(prefix="servogen-bits-") as name:
        folder = Path(name)
        packages = [build(s, folder / f"{s.name}-{x}", x, math=math) for s in scenes for x in scalars]
        vectors = {}
        for package in packages:
            assert package.scene is not None
            drawn = states_to_check(package.scene, states, seed)[0]
            vectors[package.prefix] = Truth(package.scene, package.module, drawn, states).vector_set()
        paths = [p.path for p in packages]
        for number, one in enumerate(where):
            options: dict[str, Any] = {"target": one.target, "compiler": one.compiler, "optimisation": one.level}
            for result in run_harness(paths, vectors, build_dir=folder / f"build{number}", **options):
                found.setdefault(result.prefix, {})[one] = digest(result)
    return found


def solver_hashes(
    shapes: Sequence[tuple[int, int]], where: Sequence[Build], systems: int = SYSTEMS
) -> dict[str, dict[Build, str]]:
    """By prefix, then by build: a hash over the answers of the bare solver to `systems` systems, and their infos."""
    found: dict[str, dict[Build, str]] = {}
    with tempfile.TemporaryDirectory(prefix="servogen-bits-") as name:
        folder = Path(name)
        packages = []
        for m, l in shapes:
            for x in EPSILON:
                prefix = f"pinv_{m}x{l}_{x}"
                packages.append(build_solver(m, l, folder / prefix, scalar=x, prefix=prefix).path)
        for number, one in enumerate(where):
            options: dict[str, Any] = {"target": one.target, "compiler": one.compiler, "optimisation": one.level}
            printed = hash_solvers(packages, systems, build_dir=folder / f"build{number}", timeout=3600, **options)
            for prefix, value in printed.items():
                found.setdefault(prefix, {})[one] = value
    return found


def digest(result: HarnessResult) -> str:
    """Of one run, 16 hexadecimal digits."""
    if result.problems:
        return f"failed: {result.problems[0]}"
    text = " ".join(f"{o.entry} {o.output} {o.vectors} {o.hash}" for o in result.outputs)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def main() -> int:
    """Print the hashes; 0 if each package has but one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=16)
    parser.add_argument("--boards", nargs="*", default=[t for t in targets() if t != "host"])
    parser.add_argument("--scenes", nargs="*", default=list(builtin_names()))
    parser.add_argument("--math", choices=["own", "libm"], default="own")
    parser.add_argument("--solvers", nargs="*", metavar="MxL", help="shapes of bare solvers, instead of scenes")
    parser.add_argument("--systems", type=int, default=SYSTEMS, help="solves of each of --solvers")
    given = parser.parse_args()
    where = builds(given.boards)
    if given.solvers:
        shapes = [(int(m), int(l)) for m, l in (shape.split("x") for shape in given.solvers)]
        found = solver_hashes(shapes, where, given.systems)
    else:
        found = hashes([load_scene(s) for s in given.scenes], where, given.states, given.math)
    good = True
    for prefix, by_build in found.items():
        different = set(by_build.values())
        same = len(different) == 1 and not next(iter(different)).startswith("failed")
        good &= same
        print(f"{prefix}: {'one hash ' + next(iter(different)) if same else 'DIFFERENT'} from {len(by_build)} builds")
        if not same:
            for one, value in by_build.items():
                print(f"    {one.target} {one.compiler} {one.level}: {value}")
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main())
