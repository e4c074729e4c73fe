"""From CasADi SX to the intermediate representation."""

import math
from collections.abc import Sequence
from decimal import Decimal
from fractions import Fraction
from typing import Any

import casadi as ca

from servogen.errors import SceneError
from servogen.ir.ops import BY_CASADI_ID, casadi_name
from servogen.ir.program import Input, Instr, Output, Program, check_legal


def decimal_value(number: float) -> Fraction:
    """The exact value of the shortest decimal that reads as `number`: 0.1 means one tenth."""
    return Fraction(Decimal(repr(number)))


def lower_expressions(name: str, inputs: Sequence[tuple[Input, Any]], outputs: Sequence[tuple[str, Any]]) -> Program:
    """The program computing named SX matrices from named SX columns.

    Raises SceneError for an operation without a row in the op table and for constants that are not finite.
    """
    dense = [ca.densify(expression.T) for _, expression in outputs]  # CasADi counts down columns, C along rows
    function = ca.Function("program", [symbol for _, symbol in inputs], dense)  # CasADi forbids names that C allows
    instrs: list[Instr] = []
    value: dict[int, int] = {}  # CasADi's work vector: slot -> our instruction
    nodes = [[-1] * (expression.size1() * expression.size2()) for _, expression in outputs]

    def emit(op: str, *args: int, const: Fraction | tuple[str, int] | None = None) -> int:
        instrs.append(Instr(op, args, const))
        return len(instrs) - 1

    for k in range(function.n_instructions()):
        casadi_id = function.instruction_id(k)
        into, out_of = function.instruction_output(k), function.instruction_input(k)
        if casadi_id == ca.OP_OUTPUT:
            nodes[into[0]][into[1]] = value[out_of[0]]
            continue
        if casadi_id == ca.OP_INPUT:
            result = emit("input", const=(inputs[out_of[0]][0].name, out_of[1]))
        elif casadi_id == ca.OP_CONST:
            number = function.instruction_constant(k)
            if not math.isfinite(number):
                raise SceneError(f"routine {name}, instruction {k}: a constant is {number}; give finite numbers")
            result = emit("const", const=decimal_value(number))
        else:
            args = tuple(value[slot] for slot in out_of)
            if casadi_id == ca.OP_ASSIGN:
                result = args[0]
            elif casadi_id == ca.OP_SQ:
                result = emit("mul", args[0], args[0])
            elif casadi_id == ca.OP_TWICE:
                result = emit("add", args[0], args[0])
            elif casadi_id == ca.OP_INV:
                result = emit("div", emit("const", const=Fraction(1)), args[0])
            elif casadi_id == ca.OP_CONSTPOW:
                result = emit("pow", *args)
            elif casadi_id in BY_CASADI_ID:
                result = emit(BY_CASADI_ID[casadi_id].name, *args)
            else:
                raise SceneError(
                    f"routine {name}, instruction {k}: op {casadi_name(casadi_id)} (CasADi id {casadi_id}) "
                    "is not supported; add a row to ir/ops.py"
                )
        value[into[0]] = result
    named = tuple(
        Output(label, expression.size1(), expression.size2(), tuple(entries))
        for (label, expression), entries in zip(outputs, nodes, strict=True)
    )
    return check_legal(Program(name, tuple(i for i, _ in inputs), tuple(instrs), named))
