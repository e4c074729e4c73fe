"""Dead code: what no output depends on."""

from servogen.ir.program import Program, live, rebuild


def drop_dead(program: Program) -> Program:
    """Only the instructions that some output depends on, in their order."""
    return rebuild(program, sorted(live(program, (n for o in program.outputs for n in o.nodes))))
