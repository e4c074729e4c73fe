"""Where a value may fail to exist although its mathematics does not: x y / x at x = 0.

A rewrite may lose hazards but never gain them, so removable singularities behave no worse than before.
"""

from servogen.ir.field import Residue, unsigned
from servogen.ir.program import Instr, Program
from servogen.optimise.fingerprint import Fingerprints

_PARTIAL = frozenset(["sqrt", "asin", "acos", "log", "log1p", "acosh", "atanh", "tan", "pow", "fmod", "remainder"])


class Hazards:
    """A bit mask per instruction in `masks`: one bit for each divisor and each operation that is not total."""

    def __init__(self, program: Program, fingerprints: Fingerprints) -> None:
        self._program, self._fingerprints = program, fingerprints
        self._bits: dict[tuple[str, tuple[Residue, ...]], int] = {}
        self.factors: list[int] = []  # the bits that a division by this value needs
        self.masks: list[int] = []
        for k, instr in enumerate(program.instrs):
            self.factors.append(self._factors(k, instr))
            self.masks.append(self._mask(instr))

    def _bit(self, op: str, *operands: Residue) -> int:
        return self._bits.setdefault((op, operands), 1 << len(self._bits))

    def _factors(self, k: int, instr: Instr) -> int:
        value = self._fingerprints.values[k]
        if instr.op == "const" and any(value):
            return 0
        if instr.op == "mul":
            return self.factors[instr.args[0]] | self.factors[instr.args[1]]
        if instr.op in ("neg", "div"):
            return self.factors[instr.args[0]]
        return self._bit("div", unsigned(value)[0])

    def _mask(self, instr: Instr) -> int:
        mask = 0
        for a in instr.args:
            mask |= self.masks[a]
        operands = [self._fingerprints.values[a] for a in instr.args]
        if instr.op == "if_else_zero":  # what it guards is no hazard outside; it is one of its own, to stay whole
            return self.masks[instr.args[0]] | self._bit(instr.op, operands[0], unsigned(operands[1])[0])
        if instr.op == "div":
            mask |= self.factors[instr.args[1]]
        elif instr.op in _PARTIAL:
            mask |= self._bit(instr.op, *operands)
        return mask
