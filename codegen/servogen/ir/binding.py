"""Binding times: which values are known once the parameters are."""

from servogen.ir.program import Program, asked_once


def is_constant(program: Program, k: int) -> bool:
    return program.instrs[k].op == "const"


@asked_once
def depends_on_parameters_alone(program: Program) -> tuple[bool, ...]:
    """Per instruction: known once the parameters are, and not a constant."""
    kinds = {i.name: i.kind for i in program.inputs}
    known: list[bool] = []  # constants too
    for instr in program.instrs:
        if instr.op == "input":
            assert isinstance(instr.const, tuple)
            known.append(kinds[instr.const[0]] == "parameter")
        else:
            known.append(all(known[a] for a in instr.args))  # of a constant: no arguments
    return tuple(yes and instr.op != "const" for yes, instr in zip(known, program.instrs, strict=True))
