"""Straight-line C from a program: one statement an operation. The printer decides nothing."""

from fractions import Fraction

from servogen.ir.ops import OPS
from servogen.ir.program import Program
from servogen.plan.mathematics import OWN_OPS
from servogen.plan.module import Kernel, Prepare
from servogen.render.literals import literal

_STRUCT = {"model": "model", "input": "in", "parameter": "params"}


def statements(code: Kernel | Prepare, scalar: str, own: str = "") -> tuple[list[str], dict[str, list[str]]]:
    """(declarations of temporaries t0.. in order, output name -> its entries as C expressions).

    own: the prefix of the package's own sin, cos and sqrt; "": those of <math.h>.
    """
    program = code.program
    partner = {a: b for s, c in code.pairs for a, b in ((s, c), (c, s))}
    shared: dict[int, str] = {}
    real, suffix = ("double", "") if scalar == "float64" else ("float", "f")
    sizes = {i.name: (_STRUCT[i.kind], i.size) for i in program.inputs}
    text: list[str] = []
    lines: list[str] = []
    for k, instr in enumerate(program.instrs):
        operands = [text[a] for a in instr.args]
        if isinstance(instr.const, Fraction):
            expression = literal(instr.const, scalar)
        elif instr.const is not None:
            struct, size = sizes[instr.const[0]]
            expression = f"{struct}->{instr.const[0]}" + (f"[{instr.const[1]}]" if size > 1 else "")
        elif instr.op == "neg":
            expression = f"(-{operands[0]})"
        elif k in shared:
            expression = f"{shared[k]}.{instr.op}"
        elif k in partner:
            shared[partner[k]] = f"t{len(lines)}"
            expression = f"t{len(lines)}.{instr.op}"
            lines.append(f"const {own}_pair t{len(lines)} = {own}_sincos({operands[0]});")
        else:
            expression = f"t{len(lines)}"
            form = f"{own}_{instr.op}({{0}})" if own and instr.op in OWN_OPS else OPS[instr.op].c
            value = form.format(*operands, f=suffix, real=real)
            lines.append(f"const {real} {expression} = {value};")
        text.append(expression)
    return lines, {o.name: [text[n] for n in o.nodes] for o in program.outputs}


def reads(program: Program, kind: str) -> bool:
    """Whether the program reads an input of this kind."""
    names = {i.name for i in program.inputs if i.kind == kind}
    return any(isinstance(i.const, tuple) and i.const[0] in names for i in program.instrs)
