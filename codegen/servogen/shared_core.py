"""The folder of a core, beside the folders of the packages that share it: each of them adds what it needs."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from servogen.errors import SceneError
from servogen.render.core import Block, blocks_of, unhidden
from servogen.render.render import SourceFile, render_core
from servogen.scalars import Scalar
from servogen.version import VERSION


def add_to_core(beside: Path, core: str, prefix: str, scalar: Scalar, blocks: Mapping[str, Block]) -> Path:
    """Writes or extends the core beside a package's folder; its folder.

    What the package of that prefix needed before is forgotten, so that the files depend on the packages alone, not on
    the order in which they were generated. SceneError where the folder holds something else.
    """
    folder = beside.resolve().parent / core
    if folder == beside.resolve():
        raise SceneError(f"core: {beside} is the folder of the core itself; give the package another one")
    if prefix == core or prefix.startswith(f"{core}_"):
        raise SceneError(f"prefix {prefix!r} collides with the names of the core {core!r}; choose another name")
    users, there = _known(folder, core)
    other = users.get(prefix, {}).get("folder", beside.resolve().name)
    if other != beside.resolve().name and (folder.parent / other / f"{prefix}.c").exists():
        raise SceneError(
            f"prefix {prefix!r}: {folder.parent / other} has it, too, and shares the core {core!r}, so that both would "
            f"clash in one image; give one of them another prefix"
        )
    needed: dict[str, dict[str, Block]] = {
        user: {n: replace(there[n], named=n in told["named"]) for n in told["blocks"]}
        for user, told in users.items()
        if user != prefix
    }
    for user, others in needed.items():
        for name in others.keys() & blocks.keys():
            if others[name] != blocks[name]:
                raise SceneError(f"core {core!r}: {name} of {user} is not that of {prefix}; {_remedy(folder)}")
    needed[prefix] = dict(blocks)
    scalars: dict[str, Scalar] = {user: told["scalar"] for user, told in users.items()} | {prefix: scalar}
    folders = {user: told["folder"] for user, told in users.items()} | {prefix: beside.resolve().name}
    files = render_core(core, dict(sorted(needed.items())), tuple(scalars.values()))
    folder.mkdir(parents=True, exist_ok=True)
    told = {user: {"folder": folders[user], "scalar": scalars[user]} | _needed(needed[user]) for user in sorted(needed)}
    for f in (*files, _manifest(core, told, files)):
        (folder / f.name).write_text(f.text, encoding="utf-8", newline="\n")
    return folder


def _manifest(core: str, users: Mapping[str, Any], files: tuple[SourceFile, ...]) -> SourceFile:
    told = {
        "generator": f"servogen {VERSION}",
        "core": core,
        "users": users,
        "files": {f.name: hashlib.sha256(f.text.encode()).hexdigest() for f in files},
    }
    return SourceFile("manifest.json", json.dumps(told, indent=2) + "\n")


def _needed(blocks: Mapping[str, Block]) -> dict[str, list[str]]:
    return {"blocks": sorted(blocks), "named": sorted(n for n, b in blocks.items() if b.named)}


def _remedy(folder: Path) -> str:
    return f"delete {folder} and generate every package that shares it anew, or give another core"


def _complete(users: Mapping[str, Mapping[str, Any]]) -> bool:
    return all(told.keys() == {"folder", "scalar", "blocks", "named"} for told in users.values())


def _known(folder: Path, core: str) -> tuple[dict[str, Any], dict[str, Block]]:
    """Who uses the core in a folder already, and its blocks by their first name."""
    file = folder / "manifest.json"
    if not folder.exists():
        return {}, {}
    remedy = _remedy(folder)
    if not file.is_file():
        raise SceneError(f"core: {folder} is no core, for it has no manifest.json; {remedy}")
    try:
        told = json.loads(file.read_text(encoding="utf-8"))
        texts = {name: (folder / name).read_text(encoding="utf-8") for name in (f"{core}.h", f"{core}.c")}
    except (json.JSONDecodeError, FileNotFoundError):
        raise SceneError(f"core: {folder} is incomplete: a file is missing or cut short; {remedy}") from None
    if told.keys() != {"generator", "core", "users", "files"} or told["core"] != core or not _complete(told["users"]):
        raise SceneError(f"core: {folder} holds another package; {remedy}")
    if told["generator"] != f"servogen {VERSION}":
        raise SceneError(f"core: {folder} is of {told['generator']}, this is servogen {VERSION}; {remedy}")
    for name, text in texts.items():
        if hashlib.sha256(text.encode()).hexdigest() != told["files"][name]:
            raise SceneError(f"core: {folder / name} was changed by hand; {remedy}")
    inside = texts[f"{core}.h"].partition("files alone ---- */\n")[2].partition("/* ---- end ---- */\n")[0]
    header = [Block(b.names, "#" if b.kind == "function" else b.kind, b.text) for b, _, _ in blocks_of(inside)]
    functions = [unhidden(b) for b, _, _ in blocks_of(texts[f"{core}.c"]) if b.kind == "function"]
    return told["users"], {b.names[0]: b for b in (*header, *functions)}
