"""What the pipeline leaves behind: a folder of C, and what can be done with it."""

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from servogen.errors import SceneError
from servogen.plan.module import Module
from servogen.render.core import Block
from servogen.render.render import SourceFile
from servogen.scene.scene import Scene
from servogen.shared_core import add_to_core
from servogen.twins.compiled import CompiledSolver, CompiledTwin, LimitedSolver, load_package


@dataclass(frozen=True, eq=False, repr=False)
class Package:
    """A generated package: `path` is its folder, `manifest` what manifest.json says.

    core: the folder of what it shares with others, None where it brings everything itself.
    remarks: what is odd about the scene and yet no error; `sg.build` says each as a warning.
    """

    path: Path
    manifest: dict[str, Any]
    module: Module
    scene: Scene | None = None
    remarks: tuple[str, ...] = ()
    core: Path | None = None
    _keep: Any = None  # a temporary folder lives as long as its package

    def __repr__(self) -> str:
        return f"<Package {self.prefix} ({self.module.target.scalar}) in {self.path}: {', '.join(self._functions())}>"

    def _repr_markdown_(self) -> str:
        """As a notebook shows it."""
        rows = [f"| `{self.prefix}_{name}` | {count or ''} |" for name, count in self._functions().items()]
        lines = [f"**{self.prefix}** ({self.module.target.scalar}) in `{self.path}`", ""]
        lines += ["| C function | operations |", "|---|--:|", *rows]
        return "\n".join([*lines, *(f"\n*{text}*" for text in self.remarks)])

    def _functions(self) -> dict[str, Any]:
        """Entry point -> operations of the scene's own code."""
        return {name: point["operations"]["total"] for name, point in self.manifest["entry_points"].items()}

    @property
    def prefix(self) -> str:
        return self.module.target.prefix

    def load(
        self, compiler: str | None = None, flags: Sequence[str] = ("-O2",)
    ) -> CompiledTwin | CompiledSolver | LimitedSolver:
        """Compile the C on this machine and load it. compiler: default $CC, else cc."""
        if isinstance(flags, str):
            raise TypeError(f"load: flags={flags!r} is text; give its words, {flags.split()!r}")

        return load_package(self, compiler, tuple(flags))


def write(
    files: Sequence[SourceFile],
    out: str | Path | None,
    module: Module,
    scene: Scene | None,
    remarks: tuple[str, ...] = (),
    shared: Mapping[str, Block] | None = None,
) -> Package:
    """Write the files to a folder (made if need be; None: a temporary one). SceneError where that is no folder.

    shared: what they need of the target's core, which is written to a folder of its own beside that.
    """
    keep = None
    if out is None:
        keep = tempfile.TemporaryDirectory(prefix="servogen-")
        out = Path(keep.name) / module.target.prefix if module.target.core else keep.name
    folder = Path(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise SceneError(f"out: {folder} is a file, or lies below one; give a folder for the package's files") from None
    except OSError as why:
        raise SceneError(f"out: no folder {folder} can be made: {why.strerror}; give another one") from None
    core = None
    if shared is not None:
        core = add_to_core(folder, module.target.core, module.target.prefix, module.target.scalar, shared)
    for f in files:
        (folder / f.name).write_text(f.text, encoding="utf-8", newline="\n")
    manifest = json.loads(next(f.text for f in files if f.name == "manifest.json"))
    return Package(folder, manifest, module, scene, remarks, core, keep)
