"""What cannot be NaN or infinite without an output being so: that needs no test of its own."""

from collections.abc import Iterable

from servogen.ir.ops import OPS
from servogen.ir.program import Program


def told_inputs(program: Program) -> frozenset[tuple[str, int]]:
    """(name, index) of every input element from which operations that hide no NaN and no infinity lead to an output."""
    told = _told(program, (node for output in program.outputs for node in output.nodes))
    return frozenset(i.const for k in told if isinstance((i := program.instrs[k]).const, tuple))


def watched_outputs(program: Program) -> frozenset[str]:
    """Names of outputs: where these are finite, all are. The rest lead to them, or are constants."""
    watched = {o.name: {n for n in o.nodes if program.instrs[n].op != "const"} for o in program.outputs}
    for name, nodes in list(watched.items()):
        others = (n for other, its in watched.items() if other != name for n in its)
        if nodes <= _told(program, others):
            del watched[name]
    return frozenset(watched)


def _told(program: Program, roots: Iterable[int]) -> set[int]:
    """The nodes whose NaN or infinity one of the roots shows."""
    told = set(roots)
    for k in reversed(range(len(program.instrs))):
        op = program.instrs[k].op
        if k in told and op in OPS:
            told.update(program.instrs[k].args[i] for i in OPS[op].telling)
    return told
