"""Long lines of C are broken, so that none has 120 characters or more unless a single name is as long."""

import re
from collections.abc import Iterator

LONGEST = 119

_RANKS = (",", "?", ":", "=", "||", "&&", "|", "==", "!=", "<=", ">=", "<", ">", "+", "-", "*")
"""Where a statement is best broken: what binds least comes first. The bracket of a call is the last resort."""

_PLACE = re.compile(
    r"(?<=(?P<comma>,)) | (?=(?P<before>[-+*?:|<>]|&&|\|\||[<>=!]=) )|(?<= (?P<equals>=)) |(?<=\w\()(?=\w)"
)

_TRAILING = re.compile(r"^( *)(\S.*?) (/\*(?:[^*]|\*(?!/))*\*/)$")
"""Code with a comment behind it, all on one line."""


def folded(text: str) -> str:
    """C source with its long lines broken; a comment that makes a line too long goes in front of it."""
    lines: list[str] = []
    rest = text.split("\n")[::-1]
    in_comment = False
    while rest:
        line = rest.pop()
        starts = line.rfind("/*") > line.rfind("*/")
        ends = "*/" in line and not starts
        if len(line) <= LONGEST or line.lstrip().startswith("#error"):
            lines.append(line)
        elif in_comment or (line.lstrip().startswith("/*") and (starts or line.endswith("*/"))):
            indent = re.match(r" *", line)[0] + ("" if in_comment else "   ")  # type: ignore[index]
            place = line.rfind(" ", len(indent) + 3, LONGEST + 1)
            if line[place + 1 :] == "*/":
                place = line.rfind(" ", len(indent) + 3, place)
            if place < 0:  # a single word as long as that
                lines.append(line)
                in_comment = starts or (in_comment and not ends)
                continue
            lines.append(line[:place])
            over = indent + line[place + 1 :]
            if not ends and rest and re.match(rf"{indent}\w", rest[-1]):  # goes on with the words of the next line
                over += " " + rest.pop().lstrip()
            rest.append(over)
            in_comment = True
            continue
        elif found := _TRAILING.match(line):
            rest += [found[1] + found[2].rstrip(), found[1] + found[3]]
        else:
            lines += _broken(line)
        in_comment = starts or (in_comment and not ends)
    return "\n".join(lines)


def _broken(line: str) -> Iterator[str]:
    """A statement on several lines; the head of a loop stays on one, for `verify/loops.py` reads it so."""
    indent = re.match(r" *", line)[0]  # type: ignore[index]
    further = indent + ("        " if line.lstrip().startswith("if (") else "    ")
    while len(line) > LONGEST and not re.match(r" *(?:for|while) \(", line):
        # behind the indent that the rest is given: else it would not be shorter
        places = [found for found in _places(line) if len(further) < found[2] <= LONGEST]
        late = [found for found in places if found[2] > LONGEST // 3] or places
        if not places:
            break
        place = -min((depth, rank, -place) for depth, rank, place in late)[2]
        yield line[:place].rstrip()
        line = further + line[place:].lstrip()
    yield line


def _places(code: str) -> list[tuple[int, int, int]]:
    """(depth of brackets, rank, place) of every place where a statement may be broken."""
    depths, depth = [], 0
    for c in code:
        depth += (c in "([{") - (c in ")]}")
        depths.append(depth)
    found = [] if '"' in code else list(_PLACE.finditer(code))
    signs = [m["comma"] or m["before"] or m["equals"] for m in found]
    return [
        (depths[m.start()], _RANKS.index(sign) if sign else len(_RANKS), m.start())
        for m, sign in zip(found, signs, strict=True)
    ]
