"""Long straight-line code in bounded pieces: compilers take a time that grows faster than a function's length.

A piece is a static function. Values that several pieces need travel in a small array; a slot is used again once its
value is dead.
"""

from dataclasses import dataclass
from itertools import pairwise

from servogen.ir.program import Program

LONGEST = 2000
"""Operations of the longest kernel that stays in one function."""

PIECE = 400
"""Operations of a piece."""

_WRITTEN = ("input", "const", "neg")  # printed where they are used, never stored


@dataclass(frozen=True)
class Chunk:
    """Instructions start .. stop - 1; loads and stores are (instruction, slot)."""

    start: int
    stop: int
    loads: tuple[tuple[int, int], ...]
    stores: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Chunks:
    """A program in pieces; `results` are (instruction, slot) of what the outputs are read from at the end."""

    pieces: tuple[Chunk, ...]
    slots: int
    results: tuple[tuple[int, int], ...]


def split(program: Program, longest: int = LONGEST, piece: int = PIECE) -> Chunks | None:
    """The pieces of a long program; None where it stays whole."""
    computed = [k for k, i in enumerate(program.instrs) if i.op not in _WRITTEN]
    if len(computed) <= longest:
        return None
    bounds = [0, *(computed[k] for k in range(piece, len(computed), piece)), len(program.instrs)]
    where = [0] * len(program.instrs)
    for c, (start, stop) in enumerate(pairwise(bounds)):
        where[start:stop] = [c] * (stop - start)
    end = len(bounds) - 1
    needed = _needed(program, where, end)
    slot: dict[int, int] = {}
    free: list[int] = []
    count = 0
    pieces = []
    for c, (start, stop) in enumerate(pairwise(bounds)):
        loads = tuple((k, slot[k]) for k in sorted(needed) if k < start and c in needed[k])
        for k in [k for k in sorted(slot) if max(needed[k]) <= c]:
            free.append(slot.pop(k))
        stores = []
        for k in range(start, stop):
            if needed.get(k):
                if not free:
                    free.append(count)
                    count += 1
                slot[k] = free.pop()
                stores.append((k, slot[k]))
        pieces.append(Chunk(start, stop, loads, tuple(stores)))
    return Chunks(tuple(pieces), count, tuple(sorted(slot.items())))


def _needed(program: Program, where: list[int], end: int) -> dict[int, set[int]]:
    """Computed values that cross a border -> the pieces after their own that read them; `end` for the outputs."""

    def base(k: int) -> int:
        while program.instrs[k].op == "neg":
            k = program.instrs[k].args[0]
        return k

    needed: dict[int, set[int]] = {}

    def note(k: int, reader: int) -> None:
        k = base(k)
        if program.instrs[k].op not in _WRITTEN and where[k] < reader:
            needed.setdefault(k, set()).add(reader)

    for k, instr in enumerate(program.instrs):
        if instr.op not in _WRITTEN:
            for a in instr.args:
                note(a, where[k])
    for o in program.outputs:
        for n in o.nodes:
            note(n, end)
    return needed
