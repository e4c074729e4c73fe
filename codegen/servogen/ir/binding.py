"""Binding times: which values are known once the parameters are."""

from servogen.ir.program import Program


def is_constant(program: Program, k: int) -> bool:
    return program.instrs[k].op == "const"


def depends_on_parameters_alone(program: Program) -> list[bool]:
    """Per instruction: known once the parameters are, and not a constant."""
    kinds = {i.name: i.kind for i in program.inputs}
    result: list[bool] = []
    for k, instr in enumerate(program.instrs):
        if instr.op == "input":
            assert isinstance(instr.const, tuple)
            result.append(kinds[instr.const[0]] == "parameter")
        elif is_constant(program, k):
            result.append(False)
        else:
            result.append(all(result[a] or is_constant(program, a) for a in instr.args))
    return result
