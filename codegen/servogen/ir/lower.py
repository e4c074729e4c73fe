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
    emit = _Emitter(name, function, [entry.name for entry, _ in inputs])
    value: dict[int, int] = {}  # CasADi's work vector: slot -> our instruction
    nodes = [[-1] * (expression.size1() * expression.size2()) for _, expression in outputs]
    for k in range(function.n_instructions()):
        into, out_of = function.instruction_output(k), function.instruction_input(k)
        casadi_id = function.instruction_id(k)
        if casadi_id == ca.OP_OUTPUT:
            nodes[into[0]][into[1]] = value[out_of[0]]
        elif casadi_id == ca.OP_INPUT:
            value[into[0]] = emit.input(*out_of)
        elif casadi_id == ca.OP_CONST:
            value[into[0]] = emit.constant(k)
        else:
            value[into[0]] = emit.operation(k, casadi_id, tuple(value[slot] for slot in out_of))
    named = tuple(
        Output(label, expression.size1(), expression.size2(), tuple(entries))
        for (label, expression), entries in zip(outputs, nodes, strict=True)
    )
    return check_legal(Program(name, tuple(i for i, _ in inputs), tuple(emit.instrs), named))


class _Emitter:
    """Our instructions as those of CasADi's function come in; each method appends what it takes, and names the last."""

    def __init__(self, name: str, function: Any, inputs: Sequence[str]) -> None:
        self.instrs: list[Instr] = []
        self._name = name
        self._function = function
        self._inputs = inputs

    def input(self, which: int, entry: int) -> int:
        return self._emit("input", const=(self._inputs[which], entry))

    def constant(self, k: int) -> int:
        number = self._function.instruction_constant(k)
        if not math.isfinite(number):
            raise SceneError(f"routine {self._name}, instruction {k}: a constant is {number}; give finite numbers")
        return self._emit("const", const=decimal_value(number))

    def operation(self, k: int, casadi_id: int, args: tuple[int, ...]) -> int:
        if casadi_id == ca.OP_ASSIGN:
            return args[0]
        if casadi_id == ca.OP_SQ:
            return self._emit("mul", args[0], args[0])
        if casadi_id == ca.OP_TWICE:
            return self._emit("add", args[0], args[0])
        if casadi_id == ca.OP_INV:
            return self._emit("div", self._emit("const", const=Fraction(1)), args[0])
        if casadi_id == ca.OP_CONSTPOW:
            return self._emit("pow", *args)
        if casadi_id in BY_CASADI_ID:
            return self._emit(BY_CASADI_ID[casadi_id].name, *args)
        raise SceneError(
            f"routine {self._name}, instruction {k}: op {casadi_name(casadi_id)} (CasADi id {casadi_id}) "
            "is not supported; add a row to ir/ops.py"
        )

    def _emit(self, op: str, *args: int, const: Fraction | tuple[str, int] | None = None) -> int:
        self.instrs.append(Instr(op, args, const))
        return len(self.instrs) - 1
