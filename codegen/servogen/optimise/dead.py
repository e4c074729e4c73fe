"""Dead code: what no output depends on."""

from servogen.ir.program import Program, needed, rebuild


def drop_dead(program: Program) -> Program:
    """Only the instructions that some output depends on, in their order."""
    alive = needed(program)
    return program if len(alive) == len(program.instrs) else rebuild(program, sorted(alive))
