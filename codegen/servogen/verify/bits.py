"""One hash of all answers, from every compiler, level and board: python -m servogen.verify.bits.

With --solvers 3x7 ..., one hash of 20,000 solves of each of these shapes instead, singular ones among them. With
--batch also by <prefix>_batch.c, in vectors of every length that this machine has.
"""

import argparse
import os
import platform
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from servogen.compiler import build, build_solver
from servogen.loading import builtin_names, load_scene
from servogen.plan.mathematics import Math
from servogen.scalars import EPSILON
from servogen.scene.scene import Scene
from servogen.verify.campaign import VECTORS, campaign_header, run_campaign
from servogen.verify.harness import default_states, hash_solvers, targets

LEVELS = ("-O0", "-O1", "-O2", "-O3")
SYSTEMS = 20_000


class Build(NamedTuple):
    """A way to compile and a place to run."""

    target: str
    compiler: str
    level: str
    batch: bool = False  # many states at once


def builds(boards: Iterable[str], levels: Sequence[str] = LEVELS) -> list[Build]:
    """gcc and clang on this machine at every level, and the boards: at every level where they have room."""
    found = [Build("host", compiler, level) for compiler in ("gcc", "clang") for level in levels]
    for board in boards:
        small = default_states(board, 0) > 0
        found += [Build(board, "gcc", level) for level in (("-O2",) if small else levels)]
    return found


def batch_builds() -> list[Build]:
    """gcc and clang on this machine, with the vectors of every x86-64 and the longest of this one; else its own."""
    levels = ("-O1", "-O3;-march=native") if platform.machine() in ("x86_64", "AMD64") else ("-O1", "-O3")
    return [Build("host", compiler, level, True) for compiler in ("gcc", "clang") for level in levels]


def hashes(
    scenes: Sequence[Scene], where: Sequence[Build], vectors: int, math: Math = "own", jobs: int = 1
) -> dict[str, dict[Build, str]]:
    """By prefix, then by build: the campaign's hashes of every entry point; "failed: ..." where a run fails."""
    found: dict[str, dict[Build, str]] = {}
    with tempfile.TemporaryDirectory(prefix="servogen-bits-") as name:
        folder = Path(name)
        made = {
            many: [build(s, folder / f"{s.name}-{x}-{many}", x, math=math, batch=many) for s in scenes for x in EPSILON]
            for many in {one.batch for one in where}
        }
        headers = {
            many: {
                p.prefix: campaign_header(p.scene, p.prefix, p.module.target.scalar, p.manifest)
                for p in packages
                if p.scene is not None
            }
            for many, packages in made.items()
        }
        for number, one in enumerate(where):
            for result in run_campaign(
                made[one.batch],
                headers[one.batch],
                target=one.target,
                compiler=one.compiler,
                optimisation=one.level,
                vectors=vectors,
                build_dir=folder / f"build{number}",
                jobs=jobs,
            ):
                found.setdefault(result.prefix, {})[one] = result.hash
    return found


def solver_hashes(
    shapes: Sequence[tuple[int, int]], where: Sequence[Build], systems: int = SYSTEMS
) -> dict[str, dict[Build, str]]:
    """By prefix, then by build: a hash over the answers of the bare solver to `systems` systems, and their infos."""
    found: dict[str, dict[Build, str]] = {}
    with tempfile.TemporaryDirectory(prefix="servogen-bits-") as name:
        folder = Path(name)
        made: dict[bool, list[Path]] = {many: [] for many in {one.batch for one in where}}
        for many, paths in made.items():
            for m, l in shapes:
                for x in EPSILON:
                    prefix = f"pinv_{m}x{l}_{x}"
                    built = build_solver(m, l, folder / f"{prefix}-{many}", scalar=x, prefix=prefix, batch=many)
                    paths.append(built.path)
        for number, one in enumerate(where):
            options: dict[str, Any] = {"target": one.target, "compiler": one.compiler, "optimisation": one.level}
            printed = hash_solvers(
                made[one.batch], systems, build_dir=folder / f"build{number}", timeout=3600, **options
            )
            for prefix, value in printed.items():
                found.setdefault(prefix, {})[one] = value
    return found


def main() -> int:
    """Print the hashes; 0 if each package has but one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vectors", type=int, default=VECTORS, help="states, made on the target")
    parser.add_argument("--boards", nargs="*", default=[t for t in targets() if t != "host"])
    parser.add_argument("--scenes", nargs="*", default=list(builtin_names()))
    parser.add_argument("--math", choices=["own", "libm"], default="own")
    parser.add_argument("--solvers", nargs="*", metavar="MxL", help="shapes of bare solvers, instead of scenes")
    parser.add_argument("--systems", type=int, default=SYSTEMS, help="solves of each of --solvers")
    parser.add_argument("--batch", action="store_true", help="also many states at once")
    given = parser.parse_args()
    where = builds(given.boards) + (batch_builds() if given.batch else [])
    good = True
    each: Iterable[dict[str, dict[Build, str]]]
    if given.solvers:
        shapes = (tuple(map(int, shape.split("x"))) for shape in given.solvers)
        each = (solver_hashes([(m, l)], where, given.systems) for m, l in shapes)
    else:
        cores = os.cpu_count() or 1
        each = (hashes([load_scene(name)], where, given.vectors, given.math, cores) for name in given.scenes)
    for found in each:
        for prefix, by_build in found.items():
            different = set(by_build.values())
            same = len(different) == 1 and not next(iter(different)).startswith("failed")
            good &= same
            text = f"one hash {next(iter(different))}" if same else "DIFFERENT"
            print(f"{prefix}: {text} from {len(by_build)} builds", flush=True)
            if not same:
                for one, value in by_build.items():
                    print(f"    {one.target} {one.compiler} {one.level}{' batch' if one.batch else ''}: {value}")
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main())
