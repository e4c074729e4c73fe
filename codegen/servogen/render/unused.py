"""Functions that nothing calls, and constants that nothing names, are left out: a package's text tells which.

A package of few entry points needs few of the helpers that templates print; compilers warn of the rest, and embedded
linkers do not always drop them.
"""

import re

_FUNCTION = re.compile(
    r"(?:^/\*(?:[^*]|\*(?!/))*\*/\n)?"  # the comment right above it
    r"^static [^;{}=#]*?\b(?P<name>\w+)\([^;{}]*\)\n\{\n(?:.*\n)*?\}\n\n?",
    re.MULTILINE,
)

_CONSTANT = re.compile(r"^#define (?P<name>\w+)(?: .*[^\\])?\n", re.MULTILINE)


def without_unused(text: str) -> str:
    """C source less its static functions and its constants that nothing names, or only such ones name."""
    return _without_constants(_without_functions(text))


def _without_constants(text: str) -> str:
    """Less every #define of a name that appears in its definitions alone."""
    while True:
        defined = [m["name"] for m in _CONSTANT.finditer(text)]
        unused = {name for name in defined if len(re.findall(rf"\b{name}\b", text)) == defined.count(name)}
        if not unused:
            return text
        for found in reversed([m for m in _CONSTANT.finditer(text) if m["name"] in unused]):
            text = text[: found.start()] + text[found.end() :]


def _without_functions(text: str) -> str:
    while True:
        unused = [f for f in _FUNCTION.finditer(text) if len(re.findall(rf"\b{f['name']}\b", text)) == _own(f)]
        if not unused:
            return text
        for found in reversed(unused):
            text = text[: found.start()] + text[found.end() :]


def _own(function: re.Match[str]) -> int:
    """How often a function's own text has its name: once, but for a comment about it."""
    return len(re.findall(rf"\b{function['name']}\b", function[0]))
