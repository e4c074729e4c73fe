"""The intermediate representation: a flat tuple of instructions in SSA order, which prints and reads back."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from functools import wraps
from typing import Any, NamedTuple, TypeVar, cast

from servogen.ir.ops import OPS

Leaf = tuple[str, int]  # an input's name and the entry's index

Function = TypeVar("Function", bound=Callable[..., Any])


class Instr(NamedTuple):  # the optimiser makes and compares millions of them, tuples faster than dataclasses
    """One instruction: `args` are the numbers of earlier ones; `const` the value of "const", the leaf of "input"."""

    op: str
    args: tuple[int, ...] = ()
    const: Fraction | Leaf | None = None


@dataclass(frozen=True)
class Input:
    """A named column of `size` entries; kind says when it is known: "parameter" (prepare), "model", "input" (tick)."""

    name: str
    size: int
    kind: str = "input"


@dataclass(frozen=True)
class Output:
    """A named matrix, its entries row by row as numbers of instructions."""

    name: str
    rows: int
    columns: int
    nodes: tuple[int, ...]

    @property
    def size(self) -> int:
        return self.rows * self.columns


class IllegalProgramError(AssertionError):
    """A pass broke the representation: a defect of servogen, not of the scene."""


@dataclass(frozen=True)
class Program:
    """inputs -> outputs by `instrs`, each of which refers to earlier ones only."""

    name: str
    inputs: tuple[Input, ...]
    instrs: tuple[Instr, ...]
    outputs: tuple[Output, ...]

    def output(self, name: str) -> Output:
        return next(o for o in self.outputs if o.name == name)

    def operations(self) -> dict[str, int]:
        """Operation counts by name and in "total"; inputs, constants, outputs and sign flips are free."""
        counts = Counter(i.op for i in self.instrs if i.op not in ("input", "const", "neg"))
        return {"total": sum(counts.values()), **{op: counts[op] for op in OPS if counts[op]}}

    def __str__(self) -> str:
        lines = [f"program {self.name}"]
        lines += [f"{i.kind} {i.name}[{i.size}]" for i in self.inputs]
        for k, instr in enumerate(self.instrs):
            operands = [f"%{a}" for a in instr.args]
            if isinstance(instr.const, Fraction):
                operands.append(str(instr.const))
            elif instr.const is not None:
                operands.append(f"{instr.const[0]}[{instr.const[1]}]")
            lines.append(f"%{k} = {' '.join([instr.op, *operands])}")
        for o in self.outputs:
            lines.append(f"output {o.name}[{o.rows}x{o.columns}] = {' '.join(f'%{n}' for n in o.nodes)}".rstrip())
        return "\n".join(lines) + "\n"


def parse(text: str) -> Program:
    """The program that prints as `text`."""
    name, inputs, instrs, outputs = "", [], [], []
    for line in text.splitlines():
        word, _, rest = line.partition(" ")
        if word == "program":
            name = rest
        elif word == "output":
            label, _, nodes = rest.partition(" =")
            output_name, shape = label[:-1].split("[")
            rows, columns = (int(x) for x in shape.split("x"))
            outputs.append(Output(output_name, rows, columns, tuple(int(n[1:]) for n in nodes.split())))
        elif word.startswith("%"):
            op, *operands = rest.removeprefix("= ").split()
            args = tuple(int(a[1:]) for a in operands if a.startswith("%"))
            others = [a for a in operands if not a.startswith("%")]
            const: Fraction | Leaf | None = None
            if op == "const":
                const = Fraction(others[0])
            elif op == "input":
                leaf, index = others[0][:-1].split("[")
                const = (leaf, int(index))
            instrs.append(Instr(op, args, const))
        else:
            input_name, size = rest[:-1].split("[")
            inputs.append(Input(input_name, int(size), word))
    return Program(name, tuple(inputs), tuple(instrs), tuple(outputs))


def check_legal(program: Program) -> Program:
    """Return `program`; IllegalProgramError naming the first offending instruction if it is not in order."""
    sizes = {i.name: i.size for i in program.inputs}
    if len(sizes) != len(program.inputs):
        raise IllegalProgramError(f"program {program.name}: two inputs share a name")
    if len({o.name for o in program.outputs}) != len(program.outputs):
        raise IllegalProgramError(f"program {program.name}: two outputs share a name")
    for k, instr in enumerate(program.instrs):
        if instr.args and not (min(instr.args) >= 0 and max(instr.args) < k):
            raise IllegalProgramError(f"{_place(program, k)} refers to an instruction that is not before it")
        if instr.op == "input":
            legal = isinstance(instr.const, tuple) and 0 <= instr.const[1] < sizes.get(instr.const[0], 0)
            legal = legal and not instr.args
        elif instr.op == "const":
            legal = isinstance(instr.const, Fraction) and not instr.args
        else:
            legal = instr.op in OPS and len(instr.args) == OPS[instr.op].arity and instr.const is None
        if not legal:
            raise IllegalProgramError(f"{_place(program, k)} {instr.args} {instr.const} is not legal")
    for o in program.outputs:
        if len(o.nodes) != o.size or any(not 0 <= n < len(program.instrs) for n in o.nodes):
            raise IllegalProgramError(
                f"program {program.name}: output {o.name} is not {o.rows}x{o.columns} instructions"
            )
    return program


def _place(program: Program, k: int) -> str:
    return f"program {program.name}, instruction {k}: {program.instrs[k].op}"


def asked_once(function: Function) -> Function:
    """The function, its answers kept with the program: passes ask the same of one program again and again.

    An answer is shared by all who ask, so it must be immutable.
    """

    @wraps(function)
    def kept(program: Program, *more: Hashable) -> Any:
        answers = vars(program).setdefault("answers", {})
        key = (function.__module__, function.__name__, *more)
        if key not in answers:
            answers[key] = function(program, *more)
        return answers[key]

    return cast(Function, kept)


@asked_once
def needed(program: Program) -> frozenset[int]:
    """The numbers of all instructions that some output depends on."""
    return frozenset(live(program, (n for o in program.outputs for n in o.nodes)))


def live(program: Program, roots: Iterable[int]) -> set[int]:
    """The numbers of all instructions that the roots depend on, themselves included."""
    alive = set(roots)
    for k in range(max(alive, default=-1), -1, -1):
        if k in alive:
            alive.update(program.instrs[k].args)
    return alive


def only(program: Program, *names: str) -> Program:
    """The part of a program that computes the named outputs."""
    kept = [program.output(name) for name in names]
    return rebuild(program, sorted(live(program, (n for o in kept for n in o.nodes))), kept)


def rebuild(program: Program, order: Iterable[int], outputs: Iterable[Output] | None = None) -> Program:
    """The instructions `order` alone, in that order, renumbered; outputs default to the program's own."""
    number: dict[int, int] = {}
    instrs: list[Instr] = []
    for k in order:
        instr = program.instrs[k]
        number[k] = len(instrs)
        instrs.append(Instr(instr.op, tuple(number[a] for a in instr.args), instr.const))
    kept = tuple(
        Output(o.name, o.rows, o.columns, tuple(number[n] for n in o.nodes))
        for o in (program.outputs if outputs is None else outputs)
    )
    return Program(program.name, program.inputs, tuple(instrs), kept)
