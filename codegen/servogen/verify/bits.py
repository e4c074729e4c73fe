"""One hash of all answers, from every compiler, level and board: python -m servogen.verify.bits."""

import argparse
import os
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from servogen.compiler import build
from servogen.loading import builtin_names, load_scene
from servogen.plan.mathematics import Math
from servogen.scalars import EPSILON
from servogen.scene.scene import Scene
from servogen.verify.campaign import VECTORS, campaign_header, run_campaign
from servogen.verify.harness import default_states, targets

LEVELS = ("-O0", "-O1", "-O2", "-O3")


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
    scenes: Sequence[Scene], where: Sequence[Build], vectors: int, math: Math = "own", jobs: int = 1
) -> dict[str, dict[Build, str]]:
    """By prefix, then by build: the campaign's hashes of every entry point; "failed: ..." where a run fails."""
    found: dict[str, dict[Build, str]] = {}
    with tempfile.TemporaryDirectory(prefix="servogen-bits-") as name:
        folder = Path(name)
        packages = [build(s, folder / f"{s.name}-{x}", x, math=math) for s in scenes for x in EPSILON]
        headers = {
            p.prefix: campaign_header(p.scene, p.prefix, p.module.target.scalar, p.manifest)
            for p in packages
            if p.scene is not None
        }
        for number, one in enumerate(where):
            for result in run_campaign(
                packages,
                headers,
                target=one.target,
                compiler=one.compiler,
                optimisation=one.level,
                vectors=vectors,
                build_dir=folder / f"build{number}",
                jobs=jobs,
            ):
                found.setdefault(result.prefix, {})[one] = result.hash
    return found


def main() -> int:
    """Print the hashes; 0 if each package has but one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vectors", type=int, default=VECTORS, help="states, made on the target")
    parser.add_argument("--boards", nargs="*", default=[t for t in targets() if t != "host"])
    parser.add_argument("--scenes", nargs="*", default=list(builtin_names()))
    parser.add_argument("--math", choices=["own", "libm"], default="own")
    given = parser.parse_args()
    where = builds(given.boards)
    good = True
    for name in given.scenes:
        found = hashes([load_scene(name)], where, given.vectors, given.math, os.cpu_count() or 1)
        for prefix, by_build in found.items():
            different = set(by_build.values())
            same = len(different) == 1 and not next(iter(different)).startswith("failed")
            good &= same
            text = f"one hash {next(iter(different))}" if same else "DIFFERENT"
            print(f"{prefix}: {text} from {len(by_build)} builds", flush=True)
            if not same:
                for one, value in by_build.items():
                    print(f"    {one.target} {one.compiler} {one.level}: {value}")
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main())
