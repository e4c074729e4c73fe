"""The order of the passes. A new one is one more entry in PASSES."""

from collections.abc import Callable

from servogen.ir.program import Program, check_legal
from servogen.optimise.dead import drop_dead
from servogen.optimise.fold import fold
from servogen.optimise.merge import merge

PASSES: tuple[Callable[[Program], Program], ...] = (drop_dead, fold, merge, drop_dead)


def optimise(program: Program) -> Program:
    """Repeat the passes until none changes the program; each computes the same function of finite inputs."""
    check_legal(program)
    while True:
        before = program
        for run in PASSES:
            found = run(program)
            if found != program:  # else the old one, with what was asked of it
                program = check_legal(found)
        if program == before:
            return program
