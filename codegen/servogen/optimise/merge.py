"""Common subexpressions: equal operations on equal operands are one; operands of commutative ones may swap."""

from servogen.ir.ops import COMMUTATIVE
from servogen.ir.program import Instr, Output, Program


def merge(program: Program) -> Program:
    """Each distinct operation once. Operands of commutative operations are put in order of their definition."""
    number: list[int] = []
    known: dict[Instr, int] = {}
    for instr in program.instrs:
        args = tuple(number[a] for a in instr.args)
        if instr.op in COMMUTATIVE and args[1] < args[0]:
            args = args[::-1]
        number.append(known.setdefault(Instr(instr.op, args, instr.const), len(known)))
    outputs = tuple(Output(o.name, o.rows, o.columns, tuple(number[n] for n in o.nodes)) for o in program.outputs)
    return Program(program.name, program.inputs, tuple(known), outputs)
