"""Which tests for NaN and infinity the generated code can leave out, because another value would show the failure.

A NaN or infinity passes through most operations: where an operand of a sum or of a sine is not finite, the result is
not finite either. So a finite result proves that such operands were finite, and no code needs to look at them. Other
operations hide it: 1 / x is zero for an infinite x, a comparison or a choice may drop an operand. The column `telling`
of the table of operations (`ir/ops.py`) lists, for each operation, the operands that it cannot hide.
"""

from collections.abc import Iterable

from servogen.ir.ops import OPS
from servogen.ir.program import Program


def told_inputs(program: Program) -> frozenset[tuple[str, int]]:
    """(name, index) of the input elements that need no test: if one is NaN or infinite, an output is not finite either.

    These are the elements from which a path of operations, none of which hides that operand, leads to an output.
    """
    told = _told(program, (node for output in program.outputs for node in output.nodes))
    return frozenset(i.const for k in told if isinstance((i := program.instrs[k]).const, tuple))


def watched_outputs(program: Program) -> frozenset[str]:
    """Names of the outputs that have to be tested: where these are finite, all outputs are.

    An output is left out where each of its values is a constant or an operand on the way to another output that is
    tested and that would not hide its NaN or infinity.
    """
    watched = {o.name: {n for n in o.nodes if program.instrs[n].op != "const"} for o in program.outputs}
    for name, nodes in list(watched.items()):
        others = (n for other, its in watched.items() if other != name for n in its)
        if nodes <= _told(program, others):
            del watched[name]
    return frozenset(watched)


def _told(program: Program, roots: Iterable[int]) -> set[int]:
    """The instructions whose NaN or infinity makes at least one of the roots not finite; the roots are among them."""
    # backwards, so that an instruction is judged before the operands that it passes the mark on to
    told = set(roots)
    for k in reversed(range(len(program.instrs))):
        op = program.instrs[k].op
        if k in told and op in OPS:
            told.update(program.instrs[k].args[i] for i in OPS[op].telling)
    return told
