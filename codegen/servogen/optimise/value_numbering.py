"""Semantic value numbering: expressions with equal fingerprints become one, the cheapest of them.

What no syntactic comparison finds: re-associated sums, cancellations to exactly zero, sin^2 + cos^2 = 1, a solve whose
answer is already there. A value that is the negative of another becomes its sign flip, a value that is a rational
constant becomes that constant.
"""

from collections import defaultdict
from fractions import Fraction

from servogen.ir.binding import depends_on_parameters_alone
from servogen.ir.field import Residue, as_rational, unsigned
from servogen.ir.program import Instr, Output, Program
from servogen.optimise.cost import weight
from servogen.optimise.fingerprint import Fingerprints
from servogen.optimise.hazards import Hazards

FALSE_EQUALITY = 2.0**-40
"""A program whose comparisons might err with a larger chance is left as it is."""

_LARGEST_CONSTANT = 2**32  # of a fraction's two parts; another value is taken for one with a chance below 2^-61

Class = tuple[Residue, int]
"""Equal up to sign, with the same hazards."""


def number_values(program: Program) -> Program:
    """Each value once, in its cheapest form; the outputs are the same functions.

    Correct but for a chance below FALSE_EQUALITY. No output gains a division or a partial function it did not have.
    """
    fingerprints = Fingerprints(program)
    if fingerprints.false_equality(len(program.instrs)) >= FALSE_EQUALITY:
        return program
    return _Numbering(program, fingerprints).rewritten()


class _Numbering:
    def __init__(self, program: Program, fingerprints: Fingerprints) -> None:
        self.program, self.values = program, fingerprints.values
        self.masks = Hazards(program, fingerprints).masks
        self.early = depends_on_parameters_alone(program)
        self.sign: list[bool] = []
        self.classes: list[Class] = []
        self.members: dict[Class, list[int]] = defaultdict(list)
        by_value: dict[Residue, set[int]] = defaultdict(set)
        for k, value in enumerate(self.values):
            key, flipped = unsigned(value)
            self.sign.append(flipped)
            self.classes.append((key, self.masks[k]))
            self.members[self.classes[k]].append(k)
            by_value[key].add(self.masks[k])
        # a class may also use the members of those with fewer hazards
        self.lesser = {
            (key, mask): [(key, m) for m in masks if m & ~mask == 0]
            for key, masks in by_value.items()
            for mask in masks
        }
        self.choice = self._cheapest()

    def _cheapest(self) -> dict[Class, int]:
        """The member with the cheapest tree, for every class; costs grow along every edge, so no choice is circular."""
        price: dict[Class, int] = {}
        choice: dict[Class, int] = {}
        users: dict[Class, set[int]] = defaultdict(set)
        candidates: dict[int, list[Class]] = defaultdict(list)
        for c, lesser in self.lesser.items():
            for d in lesser:
                for k in self.members[d]:
                    candidates[k].append(c)
        for k, instr in enumerate(self.program.instrs):
            for a in instr.args:
                users[self.classes[a]].add(k)
        waiting = list(range(len(self.program.instrs)))
        while waiting:
            again: set[int] = set()
            for k in waiting:
                total = self._price(k, price)
                if total is None:
                    continue
                for c in candidates[k]:
                    if c not in price or total < price[c]:
                        price[c], choice[c] = total, k
                        again |= users[c]
            waiting = sorted(again)
        return choice

    def _price(self, k: int, price: dict[Class, int]) -> int | None:
        instr = self.program.instrs[k]
        if instr.op in ("input", "const"):
            return 0
        total = 1 + weight(instr.op) // (500 if self.early[k] else 1)
        for a in instr.args:
            if self.classes[a] not in price:
                return None
            total += price[self.classes[a]]
        return total

    def rewritten(self) -> Program:
        """The chosen members in an order of definition, without recursion."""
        instrs: list[Instr] = []
        known: dict[Instr, int] = {}
        placed: dict[int, int] = {}  # chosen member -> its number

        def emit(instr: Instr) -> int:
            if instr not in known:
                known[instr] = len(instrs)
                instrs.append(instr)
            return known[instr]

        def signed(number: int, flip: bool) -> int:
            if not flip:
                return number
            if instrs[number].op == "neg":
                return instrs[number].args[0]
            return emit(Instr("neg", (number,)))

        def constant(k: int) -> Fraction | None:
            found = as_rational(self.values[k], _LARGEST_CONSTANT)
            return None if found is None else Fraction(*found)

        def operand(k: int) -> int:
            """The number of a value of the old program."""
            if (number := constant(k)) is not None:
                return emit(Instr("const", (), number))
            chosen = self.choice[self.classes[k]]
            return signed(placed[chosen], self.sign[chosen] != self.sign[k])

        def place(root: int) -> None:
            stack = [self.choice[self.classes[root]]]
            while stack:
                k = stack[-1]
                if k in placed or constant(k) is not None:
                    stack.pop()
                    continue
                instr = self.program.instrs[k]
                missing = [
                    c
                    for c in (self.choice[self.classes[a]] for a in instr.args)
                    if c not in placed and constant(c) is None
                ]
                if missing:
                    stack += reversed(missing)
                    continue
                placed[k] = emit(Instr(instr.op, tuple(operand(a) for a in instr.args), instr.const))
                stack.pop()

        outputs = []
        for o in self.program.outputs:
            for n in o.nodes:
                place(n)
            outputs.append(Output(o.name, o.rows, o.columns, tuple(operand(n) for n in o.nodes)))
        return Program(self.program.name, self.program.inputs, tuple(instrs), tuple(outputs))
