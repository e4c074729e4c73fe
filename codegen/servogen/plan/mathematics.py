"""Which functions of <math.h> a package brings itself, and where a sine and a cosine share one reduction."""

from collections.abc import Iterable
from typing import Literal

from servogen.ir.program import Program

Math = Literal["own", "libm"]
"""Where sin, cos and sqrt come from: emitted with the package, the same bits everywhere, or <math.h>."""

OWN_OPS = ("sin", "cos", "sqrt")

Pairs = tuple[tuple[int, int], ...]


def pair_angles(program: Program, math: Math) -> Pairs:
    """(sine, cosine) instructions of one angle: one call computes both."""
    if math == "libm":
        return ()
    place = {(i.op, i.args): k for k, i in enumerate(program.instrs) if i.op in ("sin", "cos")}
    return tuple((k, place["cos", args]) for (op, args), k in place.items() if op == "sin" and ("cos", args) in place)


def own_functions(code: Iterable[tuple[Program, Pairs]], math: Math, solves: bool) -> tuple[str, ...]:
    """The functions to emit: of sqrt, reduce, sin, cos, sincos those that are called. A solver calls sqrt."""
    if math == "libm":
        return ()
    found = {"sqrt"} if solves else set()
    for program, pairs in code:
        paired = {k for pair in pairs for k in pair}
        found |= {i.op for k, i in enumerate(program.instrs) if i.op in OWN_OPS and k not in paired}
        found |= {"sincos"} if pairs else set()
    found |= {"reduce"} if found & {"sin", "cos", "sincos"} else set()
    return tuple(f for f in ("sqrt", "reduce", "sin", "cos", "sincos") if f in found)
