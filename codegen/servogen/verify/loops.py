"""The loops of generated C, and how often each may turn: read from the source, where every limit is written.

Generated loops are of few forms: they count up to a number or a dimension, or down to zero. A limit that is a variable
is one of the dimensions in `sizes`, or a function's argument that every call gives as a number. A limit may have a name
that #define gives to a number.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

_LOOP = re.compile(r"^\s*(for|while) \((.*)\) \{\s*$")
_LIMIT = re.compile(r"^(\w+) (<|<=|>|>=|!=) (.+)$")
_NUMBER = re.compile(r"^(?:0x[0-9a-f]+|\d+)u?$")


class LoopUnboundedError(RuntimeError):
    """A loop whose limit cannot be told; the message has its line."""


@dataclass(frozen=True)
class Loop:
    """A loop from its first line to its last, both counted from 1; its body runs at most `turns` times."""

    first: int
    last: int
    turns: int


def loops_of(text: str, sizes: Mapping[str, int]) -> tuple[Loop, ...]:
    """All loops of a C file, outer ones first. sizes: dimension -> its largest value.

    Raises LoopUnboundedError for a loop without a limit known.
    """
    text = re.sub(r"/\*.*?\*/", lambda m: "\n" * m[0].count("\n"), text, flags=re.DOTALL)
    named = dict(re.findall(r"^#define (\w+) (\d+) *$", text, re.MULTILINE))
    lines = re.sub(r"\w+", lambda m: named.get(m[0], m[0]), text).splitlines()
    found: list[Loop] = []
    for number, line in enumerate(lines, start=1):
        if head := _LOOP.match(line):
            found.append(Loop(number, _end(lines, number), _turns(head[1], head[2], number, lines, sizes, found)))
        elif re.search(r"\b(?:for|while|do|goto)\b", line):
            raise LoopUnboundedError(f"line {number}: {line.strip()}: not a form of loop that is known")
    return tuple(found)


def _turns(kind: str, head: str, number: int, lines: list[str], sizes: Mapping[str, int], found: list[Loop]) -> int:
    parts = [part.strip() for part in head.split(";")]
    if kind == "for" and len(parts) == 3:
        start, condition, steps = parts[0], parts[1], parts[2].split(", ")
        for part in condition.split(" && "):
            if not (limit := _LIMIT.match(part)):
                continue
            name, relation, value = limit.groups()
            most = None
            if f"++{name}" in steps and relation in ("<", "<="):
                most = _most(value, number, lines, sizes, found)
            elif f"--{name}" in steps and relation in (">", ">=") and value == "0":
                most = _most(start.split(" = ")[-1], number, lines, sizes, found)
            if most is not None:
                return most + relation.endswith("=")
            if steps == [f"{name} >>= 1"] and (relation, value) == ("!=", "0"):
                return 64  # bits of the widest word
    raise LoopUnboundedError(f"line {number}: {kind} ({head}): its limit is neither a number nor a dimension known")


def _most(text: str, number: int, lines: list[str], sizes: Mapping[str, int], found: list[Loop]) -> int | None:
    """The largest value a loop may count to, or down from: a dimension, or the counter of a loop around it."""
    if (value := _value(text, number, lines, sizes)) is not None:
        return value
    around = [loop for loop in found if loop.first < number <= loop.last]
    counters = {m[1]: loop.turns for loop in around if (m := re.search(r"for \((\w+) = ", lines[loop.first - 1]))}
    return counters.get(text)


def _value(text: str, number: int, lines: list[str], sizes: Mapping[str, int]) -> int | None:
    """A number, a dimension, one of them plus or minus a number, or an argument that is a number in every call."""
    if _NUMBER.match(text):
        return int(text.rstrip("u"), 0)
    if m := re.match(r"^(.+) ([+-]) (\d+)$", text):
        base = _value(m[1], number, lines, sizes)
        return None if base is None else base + (int(m[3]) if m[2] == "+" else -int(m[3]))
    if m := re.match(r"^(\d+) - \w+$", text):  # less a counter, and no counter is negative
        return int(m[1])
    name = text.rsplit("->", 1)[-1].rsplit(".", 1)[-1]
    if name in sizes:
        return sizes[name]
    return _argument(text, number, lines, sizes)


def _argument(name: str, number: int, lines: list[str], sizes: Mapping[str, int]) -> int | None:
    """The largest value that calls of the function around line `number` give for its argument `name`."""
    head = _head(number, lines)
    if head is None or name not in head[1]:
        return None
    function, names = head
    values = []
    for line, arguments in _calls(function, lines):
        values.append(_value(arguments[names.index(name)].strip(), line, lines, sizes))
    known = [v for v in values if v is not None]
    return max(known) if known and len(known) == len(values) else None


def _head(number: int, lines: list[str]) -> tuple[str, list[str]] | None:
    """Name and arguments of the function around line `number`."""
    for k in range(number - 1, -1, -1):
        if re.match(r"^[A-Za-z_]", lines[k]):
            text = " ".join(line.strip() for line in lines[k:number])
            head = re.match(r"^[\w\s*]*?(\w+)\(([^)]*)\)", text)
            return (
                (head[1], [part.split()[-1].lstrip("*").split("[")[0] for part in head[2].split(",")]) if head else None
            )
    return None


def _calls(function: str, lines: list[str]) -> Iterator[tuple[int, list[str]]]:
    """The line and the arguments of every call of a function."""
    for k, line in enumerate(lines):
        for call in re.finditer(rf"\b{function}\(", line):
            if not re.match(r"^[A-Za-z_]", line):  # else its definition
                yield k + 1, _arguments("\n".join(lines[k:]), call.end())


def _arguments(text: str, start: int) -> list[str]:
    """The arguments of a call, from behind its opening bracket."""
    depth, parts, k = 0, [""], start
    while depth >= 0:
        c = text[k]
        depth += (c in "([{") - (c in ")]}")
        if c == "," and depth == 0:
            parts.append("")
        elif depth >= 0:
            parts[-1] += c
        k += 1
    return parts


def _end(lines: list[str], number: int) -> int:
    """The line on which the block that opens on line `number` closes."""
    depth = 0
    for k in range(number - 1, len(lines)):
        depth += lines[k].count("{") - lines[k].count("}")
        if depth == 0:
            return k + 1
    raise LoopUnboundedError(f"line {number}: its block does not close")
