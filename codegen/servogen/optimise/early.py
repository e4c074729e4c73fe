"""What parameters alone decide, as a program of its own: there every operation counts, and parameters are the atoms.

The search at tick leaves it in the form in which terms at tick were gathered: I_1 - I_2 - 2 I_1 I_2 / I_2 + ...
"""

from dataclasses import replace

from servogen.ir.binding import depends_on_parameters_alone
from servogen.ir.program import Instr, Output, Program, live, needed, rebuild

_VALUES = "values"


def early_part(program: Program) -> Program | None:
    """The computed values of parameters alone that the tick or an output takes, as one output; None without any."""
    early = depends_on_parameters_alone(program)
    handed_over = _handed_over(program, early)
    if not handed_over:
        return None
    output = Output(_VALUES, len(handed_over), 1, tuple(handed_over))
    part = rebuild(program, sorted(live(program, handed_over)), (output,))
    return replace(part, name="early", inputs=tuple(i for i in program.inputs if i.kind == "parameter"))


def with_early_part(program: Program, part: Program) -> Program:
    """The program with the values of `early_part` computed as `part` has them."""
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
    taken = {a for k in needed(program) if not early[k] for a in program.instrs[k].args} | {
        n for o in program.outputs for n in o.nodes
    }
    return sorted(k for k in taken if early[k] and program.instrs[k].op != "input")
