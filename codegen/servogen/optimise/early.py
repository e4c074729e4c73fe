"""The part of a program that depends on parameters alone, cut out so that it can be optimised by itself.

It is computed once, in prepare, so the search that optimises the tick hardly counts its operations and leaves behind
whatever was convenient to gather there, such as I_1 - I_2 - 2 I_1 I_2 / I_2 + ... A second search over this part alone,
in which every operation counts and nothing but parameters goes in, puts it in order.
"""

from dataclasses import replace

from servogen.ir.binding import depends_on_parameters_alone
from servogen.ir.program import Instr, Output, Program, live, needed, rebuild

_VALUES = "values"


def early_part(program: Program) -> Program | None:
    """A program that computes from parameters alone what the tick needs of them; None where it needs nothing computed.

    Its one output lists the values: those depending on parameters alone that an instruction of the tick, or an output
    of the program, reads. A parameter that is read as it is needs no computing and is not among them.
    """
    early = depends_on_parameters_alone(program)
    handed_over = _handed_over(program, early)
    if not handed_over:
        return None
    output = Output(_VALUES, len(handed_over), 1, tuple(handed_over))
    part = rebuild(program, sorted(live(program, handed_over)), (output,))
    return replace(part, name="early", inputs=tuple(i for i in program.inputs if i.kind == "parameter"))


def with_early_part(program: Program, part: Program) -> Program:
    """The program again, its values of `early_part` now computed by the instructions of `part`.

    part: the program that early_part made of this one, optimised; its output still lists the values in their order.
    """
    early = depends_on_parameters_alone(program)
    number = dict(zip(_handed_over(program, early), part.output(_VALUES).nodes, strict=True))
    instrs = list(part.instrs)
    for k, instr in enumerate(program.instrs):
        if k not in number and (not early[k] or instr.op == "input"):
            number[k] = len(instrs)
            instrs.append(Instr(instr.op, tuple(number[a] for a in instr.args), instr.const))
    outputs = tuple(replace(o, nodes=tuple(number[n] for n in o.nodes)) for o in program.outputs)
    return replace(program, instrs=tuple(instrs), outputs=outputs)


def _handed_over(program: Program, early: tuple[bool, ...]) -> list[int]:
    """The instructions, inputs aside, that depend on parameters alone and are read by the tick or are outputs."""
    taken = {a for k in needed(program) if not early[k] for a in program.instrs[k].args} | {
        n for o in program.outputs for n in o.nodes
    }
    return sorted(k for k in taken if early[k] and program.instrs[k].op != "input")
