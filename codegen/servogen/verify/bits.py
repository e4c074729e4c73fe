"""One hash of all outputs over all vectors, from every compiler, level and board: python -m servogen.verify.bits."""

import argparse
import hashlib
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from servogen.compiler import build
from servogen.loading import builtin_names, load_scene
from servogen.plan.mathematics import Math
from servogen.scalars import EPSILON, Scalar
from servogen.scene.scene import Scene
from servogen.verify.harness import HarnessResult, default_states, run_harness, targets
from servogen.verify.truth import Truth, states_to_check

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
    given = parser.parse_args()
    scenes = [load_scene(s) for s in given.scenes]
    good = True
    for prefix, by_build in hashes(scenes, builds(given.boards), given.states, given.math).items():
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
