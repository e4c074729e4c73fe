"""Functions that nothing calls are left out: which ones a package needs follows from its text.

A package of few entry points needs few of the helpers that templates print; compilers warn of the rest, and embedded
linkers do not always drop them.
"""

import re

_FUNCTION = re.compile(
    r"(?:^/\*(?:[^*]|\*(?!/))*\*/\n)?"  # the comment right above it
    r"^static [^;{}=#]*?\b(?P<name>\w+)\([^;{}]*\)\n\{\n(?:.*\n)*?\}\n\n?",
    re.MULTILINE,
)


def without_unused(text: str) -> str:
    """C source less its static functions that no other function names, and those that only such ones name."""
    while True:
        unused = [f for f in _FUNCTION.finditer(text) if len(re.findall(rf"\b{f['name']}\b", text)) == _own(f)]
        if not unused:
            return text
        for found in reversed(unused):
            text = text[: found.start()] + text[found.end() :]


def _own(function: re.Match[str]) -> int:
    """How often a function's own text has its name: once, but for a comment about it."""
    return len(re.findall(rf"\b{function['name']}\b", function[0]))
