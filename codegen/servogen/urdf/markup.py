"""XML as plain elements, read no more strictly than the mechanics of a robot need.

Names keep their prefixes as written, so that neither a default namespace nor an undeclared prefix (of Gazebo's blocks,
say) is an error. What no reader can make sense of, such as an unclosed element, is one with its line.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat

from servogen.errors import SceneError


@dataclass(eq=False)
class Element:
    """One element: its tag and attributes as written, the elements within, the line it begins at."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list["Element"] = field(default_factory=list)

    def all(self, tag: str) -> Iterator["Element"]:
        """The elements of that tag right within this one."""
        return (child for child in self.children if child.tag == tag)

    def first(self, tag: str) -> "Element | None":
        """The first of them, or None."""
        return next(self.all(tag), None)


def parse(text: bytes, source: str) -> Element:
    """The root element. SceneError, with the line, where the text is no XML."""
    parser = expat.ParserCreate()
    top = Element("", {}, 0)
    open_elements = [top]

    def start(tag: str, attributes: Any) -> None:
        element = Element(tag, dict(attributes), parser.CurrentLineNumber)
        open_elements[-1].children.append(element)
        open_elements.append(element)

    def end(_: str) -> None:
        open_elements.pop()

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        words = expat.ErrorString(error.code)
        raise SceneError(f"{source} is no valid URDF: line {error.lineno}: {words}; correct the file") from error
    except (ValueError, LookupError) as error:  # an encoding that Python does not know
        raise SceneError(f"{source} is no valid URDF: {error}; save the file as UTF-8") from error
    return top.children[0]
