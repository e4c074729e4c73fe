"""What packages share: a package's C is cut into what is its own, and what depends on no scene and goes into a core.

Like unused.py this works on text. A function, constant or type of the solver may be shared where it is made of nothing
but such others: not of a scene's tolerances, say. In the core it has a name that tells what it depends on, the shape of
the matrix, the scalar, and options other than the usual; so equal names mean equal text, and a core is the union of
what its packages need, in whatever order they come.
"""

import hashlib
import heapq
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from servogen.plan.module import Module
from servogen.plan.solver import SolverPlan, plan_solver
from servogen.render.fold import folded
from servogen.results import Path, Status
from servogen.scalars import Scalar
from servogen.scene.solver import Solver

_WORD = re.compile(r"[A-Za-z_]\w*")
_DEFINED = re.compile(r"^#define (\w+)", re.MULTILINE)
_FUNCTION = re.compile(r"^(?:static )?[^;{}=#/]*?\b(\w+)\([^;{}]*\)\n\{$", re.MULTILINE)
_OF_SCENES = r"copy|finite|mass_status|input_finite|reason|piece_\w+|eval_\w+|prepare"
"""With the first of these functions begins what a package has behind its solvers."""

_HEADING_OF_NOTHING = re.compile(r"/\* ----(?:[^*]|\*(?!/))*\*/\n+(?=/\* ----)")
_OF_ROWS = re.compile(r"atol|ATOL|ROOT_L|SQUARE_(LOW|HIGH|FLOOR)(_\d+)?")
"""What a solver has of the tolerances of its rows, which are the scene's."""

_SHORT = 16
"""Lines up to which a function of bits is compiled where it is called."""

_SERIES = ("reduce", "sin", "cos", "sincos")
"""Functions of few lines that take others into them: one copy in the image."""

_COMMENT = re.compile(r"\A/\*(?:[^*]|\*(?!/))*\*/\n")
_HIDDEN = "static\n"

_FOR_ANY_SHAPE = ("refuse", "copy", "finite", "INLINE_WITH_VECTORS", "UNROLL")
"""What stands among a solver's or a scene's functions and depends on the scalar alone."""


@dataclass(frozen=True)
class Block:
    """A piece of C between two others, its comment included. names: what it defines; kind: "#" (constants, attributes
    and whatever is compiled under conditions), "type", "data" or "function"; named: whether a package's C names it."""

    names: tuple[str, ...]
    kind: str
    text: str
    named: bool = field(default=False, compare=False)

    @property
    def words(self) -> frozenset[str]:
        """All names in it, but for its comment's."""
        return frozenset(_WORD.findall(self.text))


def info_type(core: str, scalar: Scalar) -> str:
    """The core's type of info in a scalar."""
    return f"{_stem(core, scalar)}_info"


def _stem(core: str, scalar: Scalar) -> str:
    return core if scalar == "float64" else f"{core}_f32"


def blocks_of(text: str) -> Iterator[tuple[Block, int, int]]:
    """The blocks of C source that define something, and where each begins and ends."""
    lines = text.split("\n")
    starts = [0]
    for line in lines:
        starts.append(starts[-1] + len(line) + 1)
    k = begin = 0
    while k < len(lines):
        line = lines[k]
        if line.startswith("/*"):
            begin = k
            while "*/" not in lines[k]:
                k += 1
            k += 1
            begin = k if lines[begin].startswith("/* ----") else begin  # a heading is of all that follows
            if k < len(lines) and lines[k] and not lines[k].startswith("/*"):
                k, block = _block(lines, begin, k)
            else:
                block = None
        elif line:
            begin = k
            k, block = _block(lines, k, k)
        else:
            k, block = k + 1, None
        if block is not None and block.names:
            yield block, starts[begin], starts[k]


def _block(lines: list[str], begin: int, k: int) -> tuple[int, Block | None]:
    """The block whose comment begins at `begin` and whose code at k, and the line behind it."""
    first = lines[k]
    if re.match(r"#if", first):
        depth = 0
        while True:
            depth += bool(re.match(r"#if", lines[k])) - lines[k].startswith("#endif")
            k += 1
            if depth == 0:
                break
        text = "\n".join(lines[begin:k]) + "\n"
        return k, Block(tuple(dict.fromkeys(_DEFINED.findall(text) + _FUNCTION.findall(text))), "#", text)
    if first.startswith("#"):
        while lines[k].endswith("\\"):
            k += 1
        text = "\n".join(lines[begin : k + 1]) + "\n"
        return k + 1, Block(tuple(_DEFINED.findall(text)), "#", text)
    opened = closed = 0
    while True:
        opened, closed = opened + lines[k].count("{"), closed + lines[k].count("}")
        if opened == closed and re.match(r"\}$|.*;( /\*.*\*/)?$", lines[k]):
            break
        k += 1
    text = "\n".join(lines[begin : k + 1]) + "\n"
    last = lines[k]
    if last == "}":
        found = _FUNCTION.search(text)
        return k + 1, Block((found[1],), "function", text) if found else None
    if first.startswith("typedef"):
        return k + 1, Block((re.findall(r"\w+", last.split("/*")[0])[-1],), "type", text)
    name = re.match(r"static const \w+ (\w+)", first)
    return k + 1, Block((name[1],), "data", text) if name else None


def cut_out(text: str, module: Module, of_words: str) -> tuple[str, Mapping[str, Block]]:
    """A package's C in two: its own, and by name what its core must have.

    of_words: the C of bits and mathematics, all of it, which depends on the scalar alone.
    """
    prefix = module.target.prefix
    names = _Names(module, {n for block, _, _ in blocks_of(of_words) for n in block.names})
    first = re.search(rf"^[^\n]*\b{prefix}_(?:{_OF_SCENES})\(", text, re.MULTILINE)
    head = len(text) if first is None else first.start()
    placed = [(b, i, j, i < head) for b, i, j in blocks_of(text)]
    aliases = [(i, j) for b, i, j, _ in placed if b.text.startswith(f"typedef {prefix}_info ")]
    shared = [
        (b, i, j)
        for b, i, j, solves in placed
        if (i, j) not in aliases
        and (solves or all(names.rest(n)[1] in _FOR_ANY_SHAPE for n in b.names))
        and not _is_public(b)
    ]
    taken = {n for b, _, _ in shared for n in b.names if names.in_core(n) is not None}
    while True:
        held = {n for b, _, _ in shared for n in b.names if not _stands_alone(b, taken, names, prefix)}
        if not held & taken:
            break
        taken -= held
    kept = [(b, i, j) for b, i, j in shared if set(b.names) <= taken]
    renamed = {n: str(names.in_core(n)) for n in taken} | names.of_info()
    own = text
    for i, j in sorted([*((i, j) for _, i, j in kept), *aliases], reverse=True):
        own = own[:i] + own[j:].removeprefix("\n")
    own = _renamed(_HEADING_OF_NOTHING.sub("", re.sub(r"\n{3,}", "\n\n", own)), renamed)
    named = set(_WORD.findall(own))
    blocks: dict[str, Block] = {}
    whole = [f for f, _, _ in blocks_of(of_words) if f.kind == "#" and len(f.names) > 1]
    for b, _, _ in kept:
        # of attributes a package has those that it uses, a core all
        full = next((f for f in whole if b.kind == "#" and set(b.names) <= set(f.names)), b)
        block = _shareable(full, renamed | {n: str(names.in_core(n)) for n in full.names}, names)
        blocks[block.names[0]] = replace(block, named=not named.isdisjoint(block.names))
    return own, blocks


def _is_public(block: Block) -> bool:
    return block.kind == "function" and "\nstatic " not in f"\n{block.text}"


def _stands_alone(block: Block, taken: set[str], names: "_Names", prefix: str) -> bool:
    known = names.of_info()
    used = {w for w in block.words if w.startswith((f"{prefix}_", f"{prefix.upper()}_"))}
    return all(w in taken or w in known for w in used)


def _shareable(block: Block, renamed: Mapping[str, str], names: "_Names") -> Block:
    """The block by the core's names, and functions static no more where they are long or of one shape."""
    rest = {names.rest(n)[1] for n in block.names}
    inline = block.kind == "#" or (
        rest <= names.of_scalar and rest.isdisjoint(_SERIES) and block.text.count("\n") <= _SHORT
    )
    # what stands above a constant is of a group, whose first one is another in another package
    code = re.sub(r"\A(?:/\*(?:[^*]|\*(?!/))*\*/\n)+(?=#define)", "", block.text)
    text = _renamed(code, renamed)
    if "(" in text and block.kind in ("function", "#"):
        attributes = r"(?:inline |\w+_(?:ALWAYS_INLINE|INLINE_WITH_VECTORS) )?"
        text = re.sub(rf"^static {attributes}(?=[^;={{}}]*\()", "static ", text, flags=re.M)
        text = re.sub(r"^static (?=[^;={}]*\()", "static inline " if inline else "", text, flags=re.M)
    own = tuple(renamed[n] for n in block.names)
    return Block(own, "#" if inline and block.kind == "function" else block.kind, folded(text))


def _renamed(text: str, names: Mapping[str, str]) -> str:
    return _WORD.sub(lambda found: names.get(found[0], found[0]), text)


class _Names:
    """What a package's names are in the core."""

    def __init__(self, module: Module, of_words: set[str]) -> None:
        self._module, self._core = module, module.target.core
        self._prefix, self._scalar = module.target.prefix, module.target.scalar
        self.of_scalar = {self.rest(n)[1] for n in of_words} | set(_FOR_ANY_SHAPE)

    def rest(self, name: str) -> tuple[str, str]:
        """The solver that a name of the package belongs to, and the name behind its prefix."""
        for solver in self._module.solvers:
            for start in (f"{self._prefix}_{solver}_", f"{self._prefix}_{solver}_".upper()):
                if name.startswith(start):
                    return solver, name.removeprefix(start)
        first = next(iter(self._module.solvers))
        for start in (f"{self._prefix}_", f"{self._prefix}_".upper()):
            if name.startswith(start):
                return first, name.removeprefix(start)
        return first, name

    def in_core(self, name: str) -> str | None:
        """Its name in the core, None where it is a scene's own."""
        solver, rest = self.rest(name)
        if rest == name:
            return None
        plan = self._module.solvers[solver]
        if rest not in self.of_scalar and (plan.form != "full" or (plan.atol_used and _OF_ROWS.fullmatch(rest))):
            return None  # the closed form of a row or column is inlined where it is called, which gains more
        stem = _stem(self._core, self._scalar)
        stem = stem if rest in self.of_scalar else f"{stem}_{plan.m}x{plan.l}{_variant(plan)}"
        return f"{stem.upper() if rest.isupper() or rest.upper() == rest else stem}_{rest}"

    def of_info(self) -> dict[str, str]:
        """Statuses, paths and the type of info, which are of every core."""
        told = [s.name for s in Status] + [f"PATH_{p.name}" for p in Path]
        found = {f"{self._prefix.upper()}_{n}": f"{self._core.upper()}_{n}" for n in told}
        own = info_type(self._core, self._scalar)
        others = [f"{self._prefix}_{s}_info" for s in self._module.solvers]
        return found | dict.fromkeys([f"{self._prefix}_info", *others], own)


def _variant(plan: SolverPlan) -> str:
    """A mark of options that are not the usual ones of the shape, whatever the rows' tolerances; "" where all are."""
    usual = plan_solver(plan.m, plan.l, plan.scalar, Solver())
    of_rows = {name: getattr(usual, name) for name in ("atol", "square_ranges", "row_range")}
    asked, plain = (replace(x, root="") for x in (replace(plan, **of_rows), usual))
    mark = "" if asked == plain else f"_{hashlib.sha256(repr(asked).encode()).hexdigest()[:8]}"
    return mark if plan.root else f"{mark}_libm"


def ordered(blocks: Iterable[Block]) -> list[Block]:
    """Blocks so that each stands behind what it names; else by name."""
    found = sorted(blocks, key=lambda b: b.names)
    owner = {n: b.names for b in found for n in b.names}
    needs = {b.names: {owner[w] for w in b.words if w in owner} - {b.names} for b in found}
    by_names = {b.names: b for b in found}
    waiting = {names: len(n) for names, n in needs.items()}
    users: dict[Any, list[Any]] = {names: [] for names in needs}
    for names, needed in needs.items():
        for n in needed:
            users[n].append(names)
    ready = [names for names, count in waiting.items() if count == 0]
    heapq.heapify(ready)
    result = []
    while ready:
        names = heapq.heappop(ready)
        result.append(by_names[names])
        for user in users[names]:
            waiting[user] -= 1
            if waiting[user] == 0:
                heapq.heappush(ready, user)
    assert len(result) == len(found), "blocks of a core name one another in a circle"
    return result


def merged(needed: Iterable[Block]) -> list[Block]:
    """What several packages need, each block once: `named` where one of them, or the header, names it."""
    found: dict[tuple[str, ...], Block] = {}
    for b in needed:
        if b.named or b.names not in found:
            found[b.names] = b
    inside = {w for b in found.values() if b.kind != "function" for w in b.words}
    return [replace(b, named=b.named or not inside.isdisjoint(b.names)) for b in found.values()]


def prototype(block: Block) -> str:
    """The declaration of a function."""
    code = _COMMENT.sub("", block.text)
    return code[: code.index("\n{\n")] + ";\n"


def hidden(block: Block) -> str:
    """The function's C where nothing outside the core's file calls it: `static` on a line of its own."""
    comment = _COMMENT.match(block.text)
    begin = comment.end() if comment else 0
    return block.text[:begin] + _HIDDEN + block.text[begin:]


def unhidden(block: Block) -> Block:
    """The block that `hidden` may have printed."""
    comment = _COMMENT.match(block.text)
    begin = comment.end() if comment else 0
    return replace(block, text=block.text[:begin] + block.text[begin:].removeprefix(_HIDDEN))
