"""Straight-line C from a program: one statement an operation. The printer decides nothing."""

from dataclasses import dataclass
from fractions import Fraction

from servogen.ir.ops import OPS
from servogen.ir.program import Instr, Program
from servogen.plan.chunks import Chunks
from servogen.render.literals import literal

_STRUCT = {"model": "model", "input": "in", "parameter": "params"}


@dataclass(frozen=True)
class Piece:
    """The statements of one function of a kernel, and which structs they read."""

    lines: tuple[str, ...]
    reads: frozenset[str]


def statements(program: Program, scalar: str) -> tuple[list[str], dict[str, list[str]]]:
    """(declarations of temporaries t0.. in order, output name -> its entries as C expressions)."""
    printer = _Printer(program, scalar)
    lines = [line for k in range(len(program.instrs)) if (line := printer.line(k))]
    return lines, {o.name: [printer.text[n] for n in o.nodes] for o in program.outputs}


def pieces(program: Program, chunks: Chunks, scalar: str) -> tuple[list[Piece], dict[str, list[str]]]:
    """(statements of each piece, which load from and store to live[], output name -> its entries at the end)."""
    printer = _Printer(program, scalar)
    found = []
    for chunk in chunks.pieces:
        lines = [f"const {printer.real} {printer.text[k]} = live[{slot}];" for k, slot in chunk.loads]
        lines += [line for k in range(chunk.start, chunk.stop) if (line := printer.line(k))]
        lines += [f"live[{slot}] = {printer.text[k]};" for k, slot in chunk.stores]
        text = "\n".join(lines)
        found.append(Piece(tuple(lines), frozenset(s for s in _STRUCT.values() if f"{s}->" in text)))
    for k, slot in chunks.results:
        printer.text[k] = f"live[{slot}]"
    return found, {o.name: [printer.expression(n) for n in o.nodes] for o in program.outputs}


def reads(program: Program, kind: str) -> bool:
    """Whether the program reads an input of this kind."""
    names = {i.name for i in program.inputs if i.kind == kind}
    return any(isinstance(i.const, tuple) and i.const[0] in names for i in program.instrs)


class _Printer:
    """Instructions as C, in order; `text` is what stands for each."""

    def __init__(self, program: Program, scalar: str) -> None:
        self.program, self.scalar = program, scalar
        self.real, self.suffix = ("double", "") if scalar == "float64" else ("float", "f")
        self.sizes = {i.name: (_STRUCT[i.kind], i.size) for i in program.inputs}
        self.text: list[str] = []
        self.count = 0

    def line(self, k: int) -> str:
        """The declaration of instruction k; empty for what is written where it is used."""
        instr = self.program.instrs[k]
        if (written := self._written(instr)) is not None:
            self.text.append(written)
            return ""
        self.text.append(f"t{self.count}")
        self.count += 1
        operands = [self.text[a] for a in instr.args]
        value = OPS[instr.op].c.format(*operands, f=self.suffix, real=self.real)
        return f"const {self.real} {self.text[k]} = {value};"

    def _written(self, instr: Instr) -> str | None:
        if isinstance(instr.const, Fraction):
            return literal(instr.const, self.scalar)
        if instr.const is not None:
            struct, size = self.sizes[instr.const[0]]
            return f"{struct}->{instr.const[0]}" + (f"[{instr.const[1]}]" if size > 1 else "")
        return _negative(self.text[instr.args[0]]) if instr.op == "neg" else None

    def expression(self, k: int) -> str:
        """What stands for an instruction, its operand's text taken as it is now."""
        instr = self.program.instrs[k]
        return _negative(self.expression(instr.args[0])) if instr.op == "neg" else self.text[k]


def _negative(text: str) -> str:
    return f"(-({text}))" if text.startswith("-") else f"(-{text})"  # a literal may be negative
