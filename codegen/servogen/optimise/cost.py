"""What a program costs at each tick: the number every pass tries to lower.

Values of parameters alone are computed in prepare and cost next to nothing; constants, inputs and sign flips cost
nothing, but a shorter program wins among equals.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

from servogen.ir.binding import depends_on_parameters_alone
from servogen.ir.program import Program, asked_once, live, needed

OPERATION = 1000
"""The cost of one addition or multiplication at tick."""

_WEIGHT = {"add": 1.0, "sub": 1.0, "mul": 1.0, "neg": 0.01, "div": 3.0, "sqrt": 4.0, "sin": 8.0, "cos": 8.0}
_OTHER = 8.0
_CHEAP = {"fabs", "fmin", "fmax", "floor", "ceil", "sign", "copysign", "lt", "le", "eq", "ne", "not", "and", "or"}
EARLY = 0.002
"""The share of an operation on parameters alone."""

_ASIDE = 0.25  # needed by minor outputs alone


@cache
def weight(op: str) -> int:
    """The cost of one operation at tick; divisions and functions cost several additions."""
    if op in ("input", "const"):
        return 0
    return round(OPERATION * (1.0 if op in _CHEAP or op == "if_else_zero" else _WEIGHT.get(op, _OTHER)))


@dataclass(frozen=True)
class Objective:
    """minor: outputs that are seldom asked for, or only beside others; what they alone need counts a quarter."""

    minor: frozenset[str] = frozenset()

    def node_costs(self, program: Program) -> tuple[int, ...]:
        """What each instruction adds to the cost of the program; zero for what no output needs."""
        return _node_costs(program, self.minor)

    def cost(self, program: Program) -> int:
        return sum(self.node_costs(program))


@asked_once
def _node_costs(program: Program, minor: frozenset[str]) -> tuple[int, ...]:
    early = depends_on_parameters_alone(program)
    everything = needed(program)
    main = live(program, _roots(program, (o.name for o in program.outputs if o.name not in minor)))
    costs = []
    for k, instr in enumerate(program.instrs):
        share = 0.0 if k not in everything else EARLY if early[k] else 1.0 if k in main else _ASIDE
        costs.append(round(weight(instr.op) * share))
    return tuple(costs)


def tick_operations(program: Program, names: Iterable[str] | None = None) -> int:
    """Operations at each tick for the named outputs (default all), counted as the manifest counts them."""
    early = depends_on_parameters_alone(program)
    alive = needed(program) if names is None else live(program, _roots(program, names))
    return sum(program.instrs[k].op not in ("input", "const", "neg") and not early[k] for k in alive)


def _roots(program: Program, names: Iterable[str]) -> list[int]:
    return [n for name in names for n in program.output(name).nodes]
