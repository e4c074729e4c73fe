"""Sharing reciprocals: y / d becomes y (1 / d) where the reciprocal serves twice, or belongs to prepare."""

from collections import Counter
from fractions import Fraction

from servogen.ir.binding import depends_on_parameters_alone, is_constant
from servogen.ir.program import Program
from servogen.optimise.fingerprint import Fingerprints
from servogen.optimise.rewriter import Rewriter


def share_reciprocals(program: Program) -> Program:
    """Divisions at tick by the same divisor become one division and products."""
    early = depends_on_parameters_alone(program)
    late = [k for k, i in enumerate(program.instrs) if i.op == "div" and not early[k]]
    counts = Counter(program.instrs[k].args[1] for k in late)
    out = Rewriter(program, Fingerprints(program))
    for k in late:
        above, below = program.instrs[k].args
        if program.instrs[above].const == 1:
            continue
        if counts[below] > 1 or early[below] or is_constant(program, below):
            reciprocal = out.add("div", out.constant(Fraction(1)), below)
            out.replace(k, out.add("mul", above, reciprocal))
    return out.finish() or program
