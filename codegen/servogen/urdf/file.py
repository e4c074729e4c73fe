"""From a path to the <robot> element of a URDF file; what is given in place of one is named, with the remedy."""

from pathlib import Path

from servogen.errors import SceneError
from servogen.urdf.markup import Element, parse

_OTHERS = {
    "sdf": "it is SDF, Gazebo's format; give the URDF it was made from",
    "mujoco": "it is MJCF, MuJoCo's format; load it with sg.mjcf.load",
    "html": "it is a web page; download the raw file",
    "COLLADA": "it is a mesh; give the URDF that names it",
}
"""Root element -> what the file is, and the remedy."""

_LFS = b"version https://git-lfs"
_EXPAND = "expand it first: xacro FILE > robot.urdf"


def robot_element(path: str | Path) -> tuple[str, Element]:
    """The file's name and its <robot>. SceneError for anything else than a URDF file."""
    if isinstance(path, str) and ("<" in path or "\n" in path):
        raise SceneError("path is text of XML; write it to a file, and give the path of that")
    if not isinstance(path, str | Path):
        raise SceneError(f"path is of type {type(path).__name__}; give the path of a URDF file")
    if isinstance(path, str) and "://" in path:
        raise SceneError(f"path {path!r} is a URI; give the path of the file on this machine")
    file = Path(path)
    try:
        if file.is_dir():
            raise SceneError(f"{str(path)!r} is a folder; give the path of a URDF file in it")
        if not file.is_file():
            raise SceneError(f"no URDF file at {str(path)!r}; give the path of one")
        text = file.read_bytes()
    except SceneError:
        raise
    except (OSError, ValueError) as error:  # a name too long, no permission, a zero byte
        raise SceneError(f"cannot read {str(path)[:200]!r}: {error}; give the path of a URDF file") from error
    return file.name, _robot(file.name, text)


def _robot(source: str, text: bytes) -> Element:
    beginning = text[:200].lstrip().lower()
    if not beginning:
        raise SceneError(f"{source} is no valid URDF: it is empty; give a robot")
    if beginning.startswith((b"<!doctype html", b"<html")):
        raise SceneError(f"{source} is no URDF: {_OTHERS['html']}")
    if beginning.startswith(_LFS):
        raise SceneError(f"{source} is no URDF: it is a pointer of Git LFS; fetch the file with `git lfs pull`")
    root = parse(text, source)
    if root.tag in _OTHERS:
        raise SceneError(f"{source} is no URDF: {_OTHERS[root.tag]}")
    if root.tag != "robot":
        raise SceneError(f"{source} is no URDF: it begins with <{root.tag[:50]}>, not with <robot>; give a URDF file")
    for element in root.children:
        parts = [element, *(element.children if element.tag in ("link", "joint") else ())]
        for part in parts:
            if part.tag.startswith("xacro:"):
                raise SceneError(f"{source} is an unexpanded xacro: line {part.line} holds <{part.tag}>; {_EXPAND}")
    return root


def check_expanded(source: str, line: int, value: str) -> None:
    """SceneError where a value still holds an expression of xacro."""
    if "${" in value or "$(" in value:
        raise SceneError(f"{source} is an unexpanded xacro: line {line} holds {value[:50]!r}; {_EXPAND}")
