"""A program being rewritten: instructions are appended, nodes replaced, and what the outputs need is put in order."""

from fractions import Fraction

from servogen.ir.field import Residue
from servogen.ir.ops import COMMUTATIVE, OPS
from servogen.ir.program import Instr, Output, Program
from servogen.optimise.fingerprint import Fingerprints

Signed = tuple[int, bool]
"""A node and whether its negative is meant."""


class Rewriter:
    """`instrs` are the program's own, then the appended ones; `replace` says what stands for a node from now on.

    Appended nodes may refer to any node. `finish` follows the replacements; it returns None if they are circular.
    """

    def __init__(self, program: Program, fingerprints: Fingerprints) -> None:
        self.program, self.fingerprints = program, fingerprints
        self.instrs = list(program.instrs)
        self.values: list[Residue] = list(fingerprints.values)
        self._known: dict[Instr, int] = {}
        for k, instr in enumerate(program.instrs):
            self._known.setdefault(_in_order(instr), k)
        self._replaced: dict[int, int] = {}

    def exists(self, op: str, *args: int) -> bool:
        return _in_order(Instr(op, args)) in self._known

    def add(self, op: str, *args: int) -> int:
        """The node of an operation, simplified where an operand is 0 or 1."""
        if (simpler := self._simplified(op, args)) is not None:
            return simpler
        return self._append(Instr(op, args))

    def constant(self, value: Fraction) -> int:
        return self._append(Instr("const", (), value))

    def signed(self, node: Signed) -> int:
        return self.add("neg", node[0]) if node[1] else node[0]

    def sum(self, a: Signed, b: Signed) -> Signed:
        """a + b with the signs moved out."""
        if a[1] == b[1]:
            return self.add("add", a[0], b[0]), a[1]
        positive, negative = (b, a) if a[1] else (a, b)
        if self.exists("sub", negative[0], positive[0]):
            return self.add("sub", negative[0], positive[0]), True
        return self.add("sub", positive[0], negative[0]), False

    def product(self, a: Signed, b: Signed) -> Signed:
        return self.add("mul", a[0], b[0]), a[1] != b[1]

    def replace(self, node: int, by: int) -> None:
        self._replaced[node] = by

    def rollback(self, count: int) -> None:
        """Forget the nodes appended since there were `count`."""
        for instr in self.instrs[count:]:
            del self._known[instr]
        del self.instrs[count:], self.values[count:]

    def _number(self, k: int) -> Fraction | None:
        const = self.instrs[k].const
        return const if type(const) is Fraction else None

    def _simplified(self, op: str, args: tuple[int, ...]) -> int | None:
        if op == "neg":
            return self.instrs[args[0]].args[0] if self.instrs[args[0]].op == "neg" else None
        if op not in ("add", "sub", "mul", "div"):
            return None
        a, b = (self._number(x) for x in args)
        if a is not None and b is not None and not (op == "div" and b == 0):
            exact = OPS[op].exact
            assert exact is not None
            return self.constant(Fraction(exact(a, b)))
        if op in ("mul", "div") and b == 1:
            return args[0]
        if op == "mul" and a == 1:
            return args[1]
        if op in ("add", "sub") and b == 0:
            return args[0]
        if op == "add" and a == 0:
            return args[1]
        return None

    def _append(self, instr: Instr) -> int:
        instr = _in_order(instr)
        known = self._known.setdefault(instr, len(self.instrs))
        if known == len(self.instrs):
            self.instrs.append(instr)
            self.values.append(self.fingerprints.of_instr(instr, [self.values[a] for a in instr.args]))
        return known

    def _final(self, k: int) -> int:
        seen = 0
        while k in self._replaced and seen <= len(self._replaced):
            k, seen = self._replaced[k], seen + 1
        return k

    def finish(self) -> Program | None:
        """The rewritten program: what its outputs need, operands first."""
        number: dict[int, int] = {}
        known: dict[Instr, int] = {}
        opened: set[int] = set()
        for root in (n for o in self.program.outputs for n in o.nodes):
            stack = [self._final(root)]
            while stack:
                k = stack[-1]
                if k in number:
                    stack.pop()
                    continue
                args = [self._final(a) for a in self.instrs[k].args]
                missing = [a for a in args if a not in number]
                if missing:
                    if k in opened:
                        return None
                    opened.add(k)
                    stack += reversed(missing)
                    continue
                instr = _in_order(Instr(self.instrs[k].op, tuple(number[a] for a in args), self.instrs[k].const))
                number[k] = known.setdefault(instr, len(known))
                stack.pop()
        outputs = tuple(
            Output(o.name, o.rows, o.columns, tuple(number[self._final(n)] for n in o.nodes))
            for o in self.program.outputs
        )
        return Program(self.program.name, self.program.inputs, tuple(known), outputs)


def _in_order(instr: Instr) -> Instr:
    if instr.op in COMMUTATIVE and instr.args[1] < instr.args[0]:
        return Instr(instr.op, instr.args[::-1])
    return instr
