"""Quarter turns written as decimals: sin(x + 1.5707963267948966) is cos(x), and 1.57079632679 is meant as pi/2 too.

It changes a value, by what the decimal lacks; it is made before any rewrite, so that every check compares with its
result, and every case is told.
"""

from fractions import Fraction

import mpmath as mp

from servogen.ir.numbers import DIGITS
from servogen.ir.program import Instr, Program, check_legal, rebuild

NEAREST = 1e-10
"""A constant part of an angle within this of a multiple of pi/2 is one."""

_LARGEST_TURNS = 64


def snap_quarter_turns(program: Program) -> tuple[Program, tuple[str, ...]]:
    """The program with quarter turns taken out of the angles of sin and cos, and a remark for each decimal."""
    snapper = _Snapper(program)
    return snapper.run(), tuple(snapper.remarks)


class _Snapper:
    def __init__(self, program: Program) -> None:
        self.program = program
        self.instrs: list[Instr] = []
        self.number: list[int] = []
        self.remarks: dict[str, None] = {}

    def run(self) -> Program:
        for instr in self.program.instrs:
            args = tuple(self.number[a] for a in instr.args)
            self.number.append(
                self._angle(instr.op, args[0]) if instr.op in ("sin", "cos") else self._other(instr, args)
            )
        if not self.remarks:
            return self.program
        outputs = tuple(
            type(o)(o.name, o.rows, o.columns, tuple(self.number[n] for n in o.nodes)) for o in self.program.outputs
        )
        whole = Program(self.program.name, self.program.inputs, tuple(self.instrs), outputs)
        return check_legal(rebuild(whole, range(len(self.instrs))))

    def _add(self, op: str, *args: int, const: Fraction | None = None) -> int:
        self.instrs.append(Instr(op, args, const))
        return len(self.instrs) - 1

    def _other(self, instr: Instr, args: tuple[int, ...]) -> int:
        self.instrs.append(Instr(instr.op, args, instr.const))
        return len(self.instrs) - 1

    def _angle(self, op: str, angle: int) -> int:
        constant = self._constant(angle)
        turns = quarter_turns(constant)
        if turns == 0:
            return self._add(op, angle)
        shown = float(constant)
        self.remarks[f"{shown!r} in an angle is read as {turns} pi/2, exactly"] = None
        rest = self._rest(angle)
        steps = (turns + (op == "cos")) % 4  # of sin: cos(x) = sin(x + pi/2)
        if rest is None:
            return self._add("const", const=Fraction((0, 1, 0, -1)[steps]))
        result = self._add("cos" if steps % 2 else "sin", rest)
        return self._add("neg", result) if steps >= 2 else result

    def _constant(self, k: int) -> Fraction:
        """The constant part of a sum."""
        instr = self.instrs[k]
        if isinstance(instr.const, Fraction):
            return instr.const
        if instr.op == "neg":
            return -self._constant(instr.args[0])
        if instr.op in ("add", "sub"):
            a, b = (self._constant(x) for x in instr.args)
            return a + b if instr.op == "add" else a - b
        return Fraction(0)

    def _rest(self, k: int) -> int | None:
        """What is left of a sum without its constant part; None for nothing."""
        instr = self.instrs[k]
        if isinstance(instr.const, Fraction):
            return None
        if instr.op == "neg":
            inner = self._rest(instr.args[0])
            return None if inner is None else self._add("neg", inner)
        if instr.op not in ("add", "sub"):
            return k
        a, b = (self._rest(x) for x in instr.args)
        if b is None:
            return a
        if a is None:
            return self._add("neg", b) if instr.op == "sub" else b
        return self._add(instr.op, a, b)


def quarter_turns(value: Fraction) -> int:
    """How many quarter turns a constant is meant to be; 0 where it is none, and for 0 itself."""
    if not value or abs(value) > 2 * _LARGEST_TURNS:
        return 0
    with mp.workdps(DIGITS):
        exact = mp.mpf(value.numerator) / value.denominator
        turns = int(mp.nint(exact / (mp.pi / 2)))
        near = abs(exact - turns * mp.pi / 2) <= NEAREST
    return turns if near else 0
