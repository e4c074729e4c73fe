"""Exact constant folding and the identities of 0, 1 and sign; every rule is exact for real, finite operands."""

from fractions import Fraction

from servogen.ir.balls import BITS, balls, middle, working
from servogen.ir.ops import OPS
from servogen.ir.program import Instr, Output, Program

ZERO, ONE = Fraction(0), Fraction(1)  # to make constants of; a comparison with the int is faster
_LARGEST_UNROLLED_POWER = 16


def fold(program: Program) -> Program:
    """Constants are computed exactly (or to 120 digits), operations with 0 and 1 vanish, signs move out."""
    folder = _Folder()
    number: list[int] = []
    for instr in program.instrs:
        number.append(folder.add(instr.op, tuple(number[a] for a in instr.args), instr.const))
    outputs = tuple(Output(o.name, o.rows, o.columns, tuple(number[n] for n in o.nodes)) for o in program.outputs)
    return Program(program.name, program.inputs, tuple(folder.instrs), outputs)


class _Folder:
    """Appends instructions, simplified, and returns their numbers."""

    def __init__(self) -> None:
        self.instrs: list[Instr] = []

    def add(self, op: str, args: tuple[int, ...] = (), const: Fraction | tuple[str, int] | None = None) -> int:
        if op not in OPS:
            return self._append(op, args, const)
        constants = [self._constant(a) for a in args]
        known = [c for c in constants if c is not None]
        if len(known) == len(args):
            value = _constant_value(op, known)
            if value is not None:
                return self._append("const", (), value)
        simpler = self._simplify(op, args, constants)
        return self._append(op, args, const) if simpler is None else simpler

    def _append(self, op: str, args: tuple[int, ...], const: Fraction | tuple[str, int] | None) -> int:
        self.instrs.append(Instr(op, args, const))
        return len(self.instrs) - 1

    def _constant(self, k: int) -> Fraction | None:
        const = self.instrs[k].const
        return const if type(const) is Fraction else None

    def _number(self, value: Fraction) -> int:
        return self._append("const", (), value)

    def _negated(self, k: int) -> int | None:
        """The operand of a sign flip, or None."""
        return self.instrs[k].args[0] if self.instrs[k].op == "neg" else None

    def _simplify(self, op: str, args: tuple[int, ...], constants: list[Fraction | None]) -> int | None:
        rule = getattr(self, f"_simplify_{op}", None)
        return None if rule is None else rule(args, constants)

    def _simplify_neg(self, args: tuple[int, ...], constants: list[Fraction | None]) -> int | None:
        return self._negated(args[0])

    def _simplify_add(self, args: tuple[int, ...], constants: list[Fraction | None]) -> int | None:
        a, b = args
        if constants[0] == 0:
            return b
        if constants[1] == 0:
            return a
        if (flipped := self._negated(b)) is not None:
            return self.add("sub", (a, flipped))
        if (flipped := self._negated(a)) is not None:
            return self.add("sub", (b, flipped))
        for k, other in ((a, b), (b, a)):
            if self.instrs[k].op == "sub" and self.instrs[k].args[1] == other:  # (x - b) + b
                return self.instrs[k].args[0]
        return None

    def _simplify_sub(self, args: tuple[int, ...], constants: list[Fraction | None]) -> int | None:
        a, b = args
        if a == b:
            return self._number(ZERO)
        if constants[1] == 0:
            return a
        if constants[0] == 0:
            return self.add("neg", (b,))
        if (flipped := self._negated(b)) is not None:
            return self.add("add", (a, flipped))
        if (other := self._other_operand("add", a, b)) is not None:  # (x + b) - b
            return other
        if self.instrs[b].op == "sub" and self.instrs[b].args[0] == a:  # a - (a - x)
            return self.instrs[b].args[1]
        if (other := self._other_operand("add", b, a)) is not None:  # a - (a + x)
            return self.add("neg", (other,))
        if self.instrs[a].op == "sub" and self.instrs[a].args[0] == b:  # (b - x) - b
            return self.add("neg", (self.instrs[a].args[1],))
        return None

    def _other_operand(self, op: str, k: int, operand: int) -> int | None:
        """x where instruction k is x op operand or operand op x; None if it is neither."""
        instr = self.instrs[k]
        if instr.op != op or operand not in instr.args:
            return None
        return instr.args[1] if instr.args[0] == operand else instr.args[0]

    def _simplify_mul(self, args: tuple[int, ...], constants: list[Fraction | None]) -> int | None:
        for c, other in ((constants[0], args[1]), (constants[1], args[0])):
            if c == 0:
                return self._number(ZERO)
            if c == 1:
                return other
            if c is not None and c < 0:
                return self.add("neg", (self.add("mul", (self._number(-c), other)),))
        return self._move_sign_out("mul", args)

    def _simplify_div(self, args: tuple[int, ...], constants: list[Fraction | None]) -> int | None:
        if constants[1] == 0:
            return None  # no value, and none may be made up
        if constants[0] == 0:
            return self._number(ZERO)
        if constants[1] == 1:
            return args[0]
        for k, c in enumerate(constants):
            if c is not None and c < 0:
                positive = self._number(-c)
                return self.add("neg", (self.add("div", (positive, args[1]) if k == 0 else (args[0], positive)),))
        if constants[1] is not None and _is_power_of_two(constants[1]):
            return self.add("mul", (args[0], self._number(1 / constants[1])))
        if constants[1] is not None and (other := self._other_operand("mul", *args)) is not None:
            return other
        return self._move_sign_out("div", args)

    def _move_sign_out(self, op: str, args: tuple[int, ...]) -> int | None:
        """(-a) op b = -(a op b), so that equal products meet whatever their signs."""
        a, b = args
        a_flipped, b_flipped = self._negated(a), self._negated(b)
        if a_flipped is None and b_flipped is None:
            return None
        product = self.add(op, (a if a_flipped is None else a_flipped, b if b_flipped is None else b_flipped))
        both = a_flipped is not None and b_flipped is not None
        return product if both else self.add("neg", (product,))

    def _simplify_pow(self, args: tuple[int, ...], constants: list[Fraction | None]) -> int | None:
        exponent = constants[1]
        if exponent is None or exponent.denominator != 1 or abs(exponent) > _LARGEST_UNROLLED_POWER:
            return None
        if exponent < 0:
            return self.add("div", (self._number(ONE), self._power(args[0], -exponent.numerator)))
        return self._power(args[0], exponent.numerator)

    def _power(self, base: int, exponent: int) -> int:
        if exponent == 0:
            return self._number(ONE)
        if exponent == 1:
            return base
        half = self._power(base, exponent // 2)
        square = self.add("mul", (half, half))
        return self.add("mul", (square, base)) if exponent % 2 else square

    def _simplify_cos(self, args: tuple[int, ...], constants: list[Fraction | None]) -> int | None:
        flipped = self._negated(args[0])
        return None if flipped is None else self.add("cos", (flipped,))

    def _simplify_fabs(self, args: tuple[int, ...], constants: list[Fraction | None]) -> int | None:
        flipped = self._negated(args[0])
        return None if flipped is None else self.add("fabs", (flipped,))

    def _simplify_odd(self, op: str, args: tuple[int, ...]) -> int | None:
        flipped = self._negated(args[0])
        return None if flipped is None else self.add("neg", (self.add(op, (flipped,)),))

    def _simplify_sin(self, args: tuple[int, ...], constants: list[Fraction | None]) -> int | None:
        return self._simplify_odd("sin", args)

    def _simplify_tan(self, args: tuple[int, ...], constants: list[Fraction | None]) -> int | None:
        return self._simplify_odd("tan", args)

    def _simplify_if_else_zero(self, args: tuple[int, ...], constants: list[Fraction | None]) -> int | None:
        if constants[0] is not None:
            return args[1] if constants[0] else self._number(ZERO)
        return self._number(ZERO) if constants[1] == 0 else None


def _is_power_of_two(value: Fraction) -> bool:
    n, d = value.numerator, value.denominator
    return n > 0 and n & (n - 1) == 0 and d & (d - 1) == 0


def _constant_value(op: str, operands: list[Fraction]) -> Fraction | None:
    """The value of an operation on constants: exact, or to 120 digits; None where it has no real one."""
    row = OPS[op]
    value = row.exact(*operands) if row.exact is not None else None
    if value is not None:
        return Fraction(value)
    with working(2 * BITS):
        try:
            rounded = row.ball(*balls(operands))
        except (ZeroDivisionError, ValueError, OverflowError):
            return None
        return middle(rounded) if rounded.is_finite() else None
