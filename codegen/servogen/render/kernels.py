"""Straight-line C from a program: one statement an operation. The printer decides nothing."""

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

from servogen.derive.lower import MASS_PIVOT, MASS_SCALE
from servogen.ir.ops import OPS
from servogen.ir.program import Instr, Program
from servogen.plan.chunks import Chunks
from servogen.plan.mathematics import OWN_OPS, Pairs
from servogen.plan.module import Kernel, Prepare
from servogen.render.literals import literal

_PIVOTS = {MASS_PIVOT: "pivots of Q", MASS_SCALE: "pivots of Q"}

_STRUCT = {"model": "model", "input": "in", "parameter": "params"}


@dataclass(frozen=True)
class Piece:
    """The statements of one function of a kernel, and which structs they read."""

    lines: tuple[str, ...]
    reads: frozenset[str]


def statements(code: Kernel | Prepare, scalar: str, own: str = "") -> tuple[list[str], dict[str, list[str]]]:
    """(declarations of temporaries t0.. in order, output name -> its entries as C expressions).

    In a kernel a comment line says which outputs the temporaries below it lead to. own: the prefix of the package's own
    sin, cos and sqrt; "": those of <math.h>.
    """
    program = code.program
    # of prepare's temporaries most lead to many fields of the model: a list of them would tell nothing
    return printed(Printer(program, scalar, own, code.pairs, told=isinstance(code, Kernel)))


def pieces(program: Program, chunks: Chunks, scalar: str, own: str = "") -> tuple[list[Piece], dict[str, list[str]]]:
    """(statements of each piece, which load from and store to live[], output name -> its entries at the end)."""
    return printed_pieces(Printer(program, scalar, own, ()), chunks)


def printed(printer: "Printer") -> tuple[list[str], dict[str, list[str]]]:
    """All statements of a printer's program, and its outputs as `statements` gives them."""
    lines = list(printer.lines(0, len(printer.program.instrs)))
    return lines, {o.name: [printer.text[n] for n in o.nodes] for o in printer.program.outputs}


def printed_pieces(printer: "Printer", chunks: Chunks) -> tuple[list[Piece], dict[str, list[str]]]:
    """The statements of a printer's program in pieces, and its outputs as `pieces` gives them."""
    found = []
    for chunk in chunks.pieces:
        lines = [f"const {printer.real} {printer.text[k]} = live[{slot}];" for k, slot in chunk.loads]
        lines += printer.lines(chunk.start, chunk.stop)
        lines += [f"live[{slot}] = {printer.text[k]};" for k, slot in chunk.stores]
        text = "\n".join(lines)
        found.append(Piece(tuple(lines), frozenset(s for s in _STRUCT.values() if f"{s}->" in text)))
    for k, slot in chunks.results:
        printer.text[k] = f"live[{slot}]"
    return found, {o.name: [printer.expression(n) for n in o.nodes] for o in printer.program.outputs}


def reads(program: Program, kind: str) -> bool:
    """Whether the program reads an input of this kind."""
    names = {i.name for i in program.inputs if i.kind == kind}
    return any(isinstance(i.const, tuple) and i.const[0] in names for i in program.instrs)


class Printer:
    """Instructions as C, in order; `text` is what stands for each."""

    def __init__(self, program: Program, scalar: str, own: str, pairs: Pairs, told: bool = True) -> None:
        self.program, self.scalar, self.own = program, scalar, own
        self.real, self.suffix = ("double", "") if scalar == "float64" else ("float", "f")
        self.sizes = {i.name: (_STRUCT[i.kind], i.size) for i in program.inputs}
        self.partner = {a: b for s, c in pairs for a, b in ((s, c), (c, s))}
        self.text: list[str] = []
        self.count = 0
        self.towards = _towards(program) if told else [()] * len(program.instrs)

    def lines(self, start: int, stop: int) -> Iterator[str]:
        """The declarations of instructions start..stop - 1, a comment before each group that leads to other outputs."""
        group: tuple[str, ...] = ()
        for k in range(start, stop):
            if line := self.line(k):
                if self.towards[k] != group:
                    group = self.towards[k]
                    yield f"/* towards {', '.join(group)} */"
                yield line

    def line(self, k: int) -> str:
        """The declaration of instruction k; empty for what is written where it is used."""
        instr = self.program.instrs[k]
        if (written := self._written(k, instr)) is not None:
            self.text.append(written)
            return ""
        name = f"t{self.count}"
        self.count += 1
        operands = [self.text[a] for a in instr.args]
        paired = k in self.partner
        self.text.append(f"{name}.{instr.op}" if paired else name)
        return self.declared(name, instr, operands, paired)

    def declared(self, name: str, instr: Instr, operands: list[str], paired: bool) -> str:
        """A temporary as C; paired: a sine and a cosine at once."""
        if paired:
            return f"const {self.own}_pair {name} = {self.own}_sincos({operands[0]});"
        if self.own and instr.op in OWN_OPS:
            return f"const {self.real} {name} = {self.own}_{instr.op}({operands[0]});"
        return f"const {self.real} {name} = {OPS[instr.op].c.format(*operands, f=self.suffix, real=self.real)};"

    def same_for_all(self, text: str) -> str:
        """A number that does not depend on the state."""
        return text

    def _written(self, k: int, instr: Instr) -> str | None:
        if isinstance(instr.const, Fraction):
            return self.same_for_all(literal(instr.const, self.scalar))
        if instr.const is not None:
            struct, size = self.sizes[instr.const[0]]
            place = f"{struct}->{instr.const[0]}" + (f"[{instr.const[1]}]" if size > 1 else "")
            return place if struct == "in" else self.same_for_all(place)
        if k in self.partner and self.partner[k] < k:  # the pair is there already
            return f"{self.text[self.partner[k]].partition('.')[0]}.{instr.op}"
        return _negated(self.text[instr.args[0]]) if instr.op == "neg" else None

    def expression(self, k: int) -> str:
        """What stands for an instruction, its operand's text taken as it is now."""
        instr = self.program.instrs[k]
        return _negated(self.expression(instr.args[0])) if instr.op == "neg" else self.text[k]


def _towards(program: Program) -> list[tuple[str, ...]]:
    """By instruction, the names of the outputs that depend on it; the two outputs that judge Q go as its pivots."""
    found: list[set[int]] = [set() for _ in program.instrs]
    names = list(dict.fromkeys(_PIVOTS.get(o.name, o.name) for o in program.outputs))
    for o in program.outputs:
        for n in o.nodes:
            found[n].add(names.index(_PIVOTS.get(o.name, o.name)))
    for k in reversed(range(len(program.instrs))):
        for a in program.instrs[k].args:
            found[a] |= found[k]
    return [tuple(names[i] for i in sorted(outputs)) for outputs in found]


def _negated(operand: str) -> str:
    """The sign flipped; a literal may be negative."""
    return f"(-({operand}))" if operand.startswith("-") else f"(-{operand})"
