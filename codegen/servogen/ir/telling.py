"""Which inputs cannot be NaN or infinite without an output being so: those need no test of their own."""

from servogen.ir.ops import OPS
from servogen.ir.program import Program


def told_inputs(program: Program) -> frozenset[tuple[str, int]]:
    """(name, index) of every input element from which operations that hide no NaN and no infinity lead to an output."""
    told = {node for output in program.outputs for node in output.nodes}
    found = set()
    for k in reversed(range(len(program.instrs))):
        instr = program.instrs[k]
        if k not in told:
            continue
        if isinstance(instr.const, tuple):
            found.add(instr.const)
        elif instr.op in OPS:
            told.update(instr.args[i] for i in OPS[instr.op].telling)
    return frozenset(found)
