"""What an interrupted campaign has done, so that it goes on from there: a line of JSON for each finished piece."""

import hashlib
import json
from pathlib import Path
from typing import Any

import servogen


class Journal:
    """Finished pieces by name. With a path, every one is on disk before the next begins; without, in memory only.

    A journal of other code or another seed, or a damaged one, is put aside (its name gains `.old`): its figures are not
    this code's.
    """

    def __init__(self, path: Path | None, seed: int) -> None:
        self.path = path
        self.found: dict[str, Any] = {}
        head = {"seed": seed, "code": fingerprint()}
        if path is None:
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_file() and not self._read(path, head):
            path.replace(path.with_name(path.name + ".old"))
        if not path.is_file():
            path.write_text(json.dumps(head) + "\n")

    def _read(self, path: Path, head: dict[str, Any]) -> bool:
        text = path.read_text(errors="replace")
        lines = text.split("\n")[:-1]  # what follows the last line's end was cut off as it was written
        try:
            entries = [json.loads(line) for line in lines]
        except json.JSONDecodeError:
            return False
        if not entries or entries[0] != head:
            return False
        if not all(isinstance(e, dict) and all(isinstance(v, dict | list) for v in e.values()) for e in entries[1:]):
            return False
        for entry in entries[1:]:
            self.found.update(entry)
        if not text.endswith("\n"):
            path.write_text("\n".join(lines) + "\n")
        return True

    def write(self, name: str, value: Any) -> None:
        self.found[name] = value
        if self.path is not None:
            with self.path.open("a") as file:
                file.write(json.dumps({name: value}) + "\n")


def fingerprint() -> str:
    """Of everything a figure depends on: the package's own files."""
    folder = Path(servogen.__file__).parent
    names = sorted(p for p in folder.rglob("*") if p.suffix in (".py", ".j2", ".c"))
    whole = hashlib.sha256()
    for path in names:
        whole.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes())
    return whole.hexdigest()[:16]
