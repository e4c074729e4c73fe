"""Instructions on the boards of two versions of the generated C side by side, at the same states.

    git archive COMMIT generated | tar x -C OLD
    python -m servogen.bench.versions OLD/generated generated --boards cortex-m4 cortex-m7

Every entry point that a campaign runs is counted over the campaign's states, infos included. A scene whose inputs,
parameters or operations are not the same in both is left out, and said so: it is another function. The exit code is 1
where an entry point takes more than before, beyond what the board's clock leaves open.
"""

import argparse
import json
import math
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from servogen.loading import builtin_names, load_scene
from servogen.verify.campaign import Campaign, campaign_header, run_campaign
from servogen.verify.generated import FOLDERS, committed_folder
from servogen.verify.harness import targets

TICK = 63
"""Instructions of the slowest board's clock between two ticks."""


def clock_error(vectors: int) -> float:
    """Instructions by which two means over so many calls may differ by the clock alone: a call begins and ends at any
    phase of a tick, which leaves each count a variance of TICK^2 / 6; three standard deviations of the difference."""
    return 3 * TICK * math.sqrt(1 / 3 / vectors)


@dataclass(frozen=True)
class Compared:
    """One entry point: the mean of its instructions over all states, in both versions."""

    scene: str
    scalar: str
    board: str
    entry: str
    before: float
    after: float


def comparable(before: Path, after: Path, names: Sequence[str]) -> tuple[list[str], list[str]]:
    """The scenes that are the same functions in both folders, and why the others are not."""
    same, others = [], []
    for name in names:
        why = next(
            filter(None, (_difference(*(folder / name / f for folder in (before, after))) for f in _SHORT)), None
        )
        if why is None:
            same.append(name)
        else:
            others.append(f"{name}: {why}")
    return same, others


_SHORT = tuple(FOLDERS.values())


def _difference(before: Path, after: Path) -> str | None:
    files = [folder / "manifest.json" for folder in (before, after)]
    for file in files:
        if not file.is_file():
            return f"there is no {file}"
    old, new = (json.loads(file.read_text()) for file in files)
    for part in ("inputs", "parameters"):
        if [(n, x["size"]) for n, x in old[part].items()] != [(n, x["size"]) for n, x in new[part].items()]:
            return f"it has other {part}"
    counts = [{n: point["operations"] for n, point in given["entry_points"].items()} for given in (old, new)]
    changed = [n for n in counts[0] if counts[0][n] != counts[1].get(n)]
    return f"operations of {', '.join(changed)} are others" if changed else None


def compare(before: Path, after: Path, names: Sequence[str], board: str, vectors: int) -> Iterator[Compared]:
    """All entry points of these scenes on one board, in both scalars."""
    for scalar, short in FOLDERS.items():
        old, new = (
            _campaigns([(n, folder / n / short) for n in names], scalar, board, vectors) for folder in (before, after)
        )
        for name, one, other in zip(names, old, new, strict=True):
            for a, b in zip(one.entries, other.entries, strict=True):
                assert a.entry == b.entry
                yield Compared(name, scalar, board, a.entry, a.total / vectors, b.total / vectors)


def _campaigns(found: Sequence[tuple[str, Path]], scalar: Any, board: str, vectors: int) -> list[Campaign]:
    packages, headers = [], {}
    for name, folder in found:
        manifest = json.loads((folder / "manifest.json").read_text())
        packages.append((folder, manifest["prefix"]))
        headers[manifest["prefix"]] = campaign_header(load_scene(name), manifest["prefix"], scalar, manifest)
    with tempfile.TemporaryDirectory(prefix="servogen-versions-") as name:
        return run_campaign(packages, headers, target=board, vectors=vectors, build_dir=Path(name))


def main() -> int:
    """Print a line an entry point; 1 if any takes more than before."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path, help="a folder like generated/")
    parser.add_argument("after", type=Path, nargs="?", help="another; default that of this checkout")
    parser.add_argument("--boards", nargs="*", default=[t for t in targets() if t != "host"])
    parser.add_argument("--scenes", nargs="*", default=list(builtin_names()))
    parser.add_argument("--vectors", type=int, default=3000, help="states, made on the board")
    given = parser.parse_args()
    after = given.after or committed_folder()
    names, others = comparable(given.before, after, given.scenes)
    for text in others:
        print(f"not compared: {text}")
    more = []
    for board in given.boards:
        for one in compare(given.before, after, names, board, given.vectors):
            ratio = f"{one.before:12.1f} -> {one.after:12.1f}  {one.after / one.before:.3f}"
            found = one.after > one.before + clock_error(given.vectors)
            print(f"{one.scene:32} {one.scalar} {one.board:10} {one.entry:8} {ratio}{'  MORE' * found}", flush=True)
            more += [one] * found
    print(f"{len(more)} entry points take more than before, by {clock_error(given.vectors):.1f} instructions or above")
    return 1 if more else 0


if __name__ == "__main__":
    raise SystemExit(main())
