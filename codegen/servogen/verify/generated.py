"""The committed C of the built-in scenes: made anew, and compared byte for byte."""

import sys
from pathlib import Path

from servogen.compiler import build
from servogen.loading import builtin_names, load_scene
from servogen.scalars import Scalar

FOLDERS: dict[Scalar, str] = {"float64": "f64", "float32": "f32"}


def regenerate(folder: str | Path) -> tuple[Path, ...]:
    """Builds every built-in scene for both scalars into folder/<scene>/f64 and f32; the packages' folders."""
    packages = []
    for name in builtin_names():
        for scalar, short in FOLDERS.items():
            packages.append(build(load_scene(name), Path(folder) / name / short, scalar).path)
    return tuple(packages)


def compare(committed: Path, fresh: Path) -> list[str]:
    """How two folders differ, one line a file, with the first line of the file that does."""
    new, old = _files(fresh), _files(committed)
    lines = [f"{name}: missing" for name in new.keys() - old.keys()]
    lines += [f"{name}: no scene makes it" for name in old.keys() - new.keys()]
    lines += [
        f"{name}: {_first_difference(old[name], new[name])}"
        for name in new.keys() & old.keys()
        if new[name] != old[name]
    ]
    return sorted(lines)


def committed_folder() -> Path:
    """generated/ of the repository this package runs from. Raises FileNotFoundError for an installed package."""
    folder = Path(__file__).resolve().parents[3] / "generated"
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} does not exist; run this from a checkout of the repository")
    return folder


def _files(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def _first_difference(old: bytes, new: bytes) -> str:
    pairs = zip(old.splitlines(), new.splitlines(), strict=False)
    for number, (before, after) in enumerate(pairs, start=1):
        if before != after:
            return f"line {number} is {before.decode(errors='replace')!r}, now {after.decode(errors='replace')!r}"
    return "one is longer than the other, or its line ends differ"


if __name__ == "__main__":
    for package in regenerate(sys.argv[1] if len(sys.argv) > 1 else committed_folder()):
        print(package)
