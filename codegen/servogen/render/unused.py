"""Functions that nothing calls, and constants that nothing names, are left out: a package's text tells which.

A package of few entry points needs few of the helpers that templates print; compilers warn of the rest, and embedded
linkers do not always drop them.
"""

import re
from collections import Counter

_FUNCTION = re.compile(
    r"(?:^/\*(?:[^*]|\*(?!/))*\*/\n)?"  # the comment right above it
    r"^static [^;{}=#]*?\b(?P<name>\w+)\([^;{}]*\)\n\{\n(?:.*\n)*?\}\n\n?",
    re.MULTILINE,
)

_WORD = re.compile(r"\w+")

_CONSTANT = re.compile(r"^#define (?P<name>\w+)(?: .*[^\\])?\n", re.MULTILINE)


def without_unused(text: str) -> str:
    """C source less its static functions and its constants that nothing names, or only such ones name."""
    return _without_constants(_without_functions(text))


def _without_constants(text: str) -> str:
    """Less every #define of a name that appears in its definitions alone."""
    while True:
        named, defined = _words(text), Counter(m["name"] for m in _CONSTANT.finditer(text))
        unused = {name for name, count in defined.items() if named[name] == count}
        if not unused:
            return text
        for found in reversed([m for m in _CONSTANT.finditer(text) if m["name"] in unused]):
            text = text[: found.start()] + text[found.end() :]


def _without_functions(text: str) -> str:
    """Less every static function that nothing outside its own text, and the comment above it, names."""
    while True:
        named = _words(text)
        unused = [f for f in _FUNCTION.finditer(text) if named[f["name"]] == _words(f[0])[f["name"]]]
        if not unused:
            return text
        for found in reversed(unused):
            text = text[: found.start()] + text[found.end() :]


def _words(text: str) -> Counter[str]:
    """How often each word stands there: counted once, for packages have thousands of lines."""
    return Counter(_WORD.findall(text))
