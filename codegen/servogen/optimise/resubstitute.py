"""Resubstitution: a value is computed anew from one or two that are live anyway, so that its private cone dies.

As logic synthesis does, with +, - and *; it invents no division, which would cost more and may not exist everywhere.
Candidates are found with short residues by whole arrays and confirmed with the full fingerprints.
"""

from collections.abc import Iterator
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from servogen.ir.binding import depends_on_parameters_alone
from servogen.ir.field import Residue, rational, unsigned
from servogen.ir.program import Instr, Program
from servogen.optimise.cost import Objective, weight
from servogen.optimise.fingerprint import Fingerprints
from servogen.optimise.hazards import Hazards
from servogen.optimise.rewriter import Rewriter

_SHORT = 2**31 - 1
_TABLE = 1 << 20
_MOST_WORK = 60_000_000  # nodes times candidates; a larger program is searched in part, its largest cones first
_RATIOS = tuple(Fraction(n, d) for n, d in ((2, 1), (1, 2), (3, 1), (1, 3), (4, 1), (1, 4), (3, 2), (2, 3)))

Words = NDArray[np.int64]

Recipe = tuple[str, int, int, bool]
"""op, two operands and whether the result is the negative of the value sought; an operand below zero is a ratio."""


def resubstitute(program: Program, objective: Objective) -> Program:
    """The program with every value whose private cone costs more than one operation on live values so computed."""
    return _Search(program, objective).run()


class _Search:
    def __init__(self, program: Program, objective: Objective) -> None:
        self.program = program
        self.fingerprints = Fingerprints(program)
        self.values = self.fingerprints.values
        self.masks = Hazards(program, self.fingerprints).masks
        self.early = depends_on_parameters_alone(program)
        self.costs = objective.node_costs(program)
        self.main = [c == weight(i.op) for c, i in zip(self.costs, program.instrs, strict=True)]
        self.args = [tuple(i.args) for i in program.instrs]
        self.ops = [i.op for i in program.instrs]
        self.outputs = {n for o in program.outputs for n in o.nodes}
        self.refs = [0] * len(program.instrs)
        for args in self.args:
            for a in args:
                self.refs[a] += 1
        for o in program.outputs:
            for n in o.nodes:
                self.refs[n] += 1
        self.node_of: dict[Residue, int] = {}
        for k, value in enumerate(self.values):
            self.node_of.setdefault(unsigned(value)[0], k)
        self._short_residues()

    # ---- cones ----

    def _release(self, k: int) -> int:
        """Take away the operands of a node; the cost of what dies."""
        dead, stack = 0, [k]
        while stack:
            node = stack.pop()
            for a in self.args[node]:
                self.refs[a] -= 1
                if self.refs[a] == 0:
                    dead += self.costs[a]
                    stack.append(a)
        return dead

    def _hold(self, k: int) -> int:
        """The reverse of _release: the cost of what comes to life."""
        born, stack = 0, [k]
        while stack:
            node = stack.pop()
            for a in self.args[node]:
                self.refs[a] += 1
                if self.refs[a] == 1:
                    born += self.costs[a]
                    stack.append(a)
        return born

    def _depends(self, k: int, on: int) -> bool:
        stack, seen = [k], {k}
        while stack:
            node = stack.pop()
            if node == on:
                return True
            for a in self.args[node]:
                if a not in seen:
                    seen.add(a)
                    stack.append(a)
        return False

    # ---- candidates ----

    def _short_residues(self) -> None:
        """Residues of one machine word, of which equal values have equal ones, and a table of those present."""
        short: list[int] = []
        for k, instr in enumerate(self.program.instrs):
            a = [short[x] for x in instr.args]
            if instr.op == "add":
                r = (a[0] + a[1]) % _SHORT
            elif instr.op == "sub":
                r = (a[0] - a[1]) % _SHORT
            elif instr.op == "mul":
                r = a[0] * a[1] % _SHORT
            elif instr.op == "neg":
                r = -a[0] % _SHORT
            elif instr.op == "div" and a[1]:
                r = a[0] * pow(a[1], -1, _SHORT) % _SHORT
            elif isinstance(instr.const, Fraction) and instr.const.denominator % _SHORT:
                r = instr.const.numerator * pow(instr.const.denominator, -1, _SHORT) % _SHORT
            else:
                key, flipped = unsigned(self.values[k])
                r = (-1 if flipped else 1) * (key[0] % (_SHORT - 1) + 1) % _SHORT
            short.append(r)
        self.short = np.array(short, dtype=np.int64)
        self.inverse = np.array([pow(r, -1, _SHORT) if r else 0 for r in short], dtype=np.int64)
        self.present = np.zeros(_TABLE, dtype=bool)
        self.present[_slot(self.short)] = True

    def _recipes(self, v: int) -> Iterator[Recipe]:
        """Ways to compute v from one or two other values, unproven as to their order and cost."""
        of, value = self.fingerprints.of, self.values[v]
        for n, ratio in enumerate(_RATIOS):
            number = rational(ratio.numerator, ratio.denominator)
            assert number is not None
            if (found := self._signed(of("div", value, number))) is not None:
                yield "mul", -n - 1, found[0], found[1]
        short = int(self.short[v])
        for form, wanted in (
            ("sub", (short - self.short) % _SHORT),  # v = x + y
            ("add", (short + self.short) % _SHORT),  # v = y - x
            ("div", short * self.inverse % _SHORT),  # v = x y
        ):
            for x in np.flatnonzero(self.present[_slot(wanted)]):
                yield from self._confirmed(form, v, int(x))

    def _confirmed(self, form: str, v: int, x: int) -> Iterator[Recipe]:
        if x == v or self.ops[x] == "neg":
            return
        value = self.values[x]
        if not any(value):
            return
        found = self._signed(self.fingerprints.of(form, self.values[v], value))
        if found is None or found[0] == v:
            return
        y, flipped = found
        if form == "sub":  # v = x + (+-y)
            yield ("sub", x, y, False) if flipped else ("add", x, y, False)
        elif form == "add":  # v = (+-y) - x
            if flipped:
                yield "add", x, y, True
            else:
                yield "sub", y, x, False
        else:
            yield "mul", x, y, flipped

    def _signed(self, value: Residue) -> tuple[int, bool] | None:
        """The node of a value or of its negative."""
        key, flipped = unsigned(value)
        node = self.node_of.get(key)
        return None if node is None else (node, flipped != unsigned(self.values[node])[1])

    # ---- the search ----

    def run(self) -> Program:
        late = [
            k for k in range(len(self.ops))
            if self.ops[k] not in ("input", "const", "neg") and not self.early[k] and self.costs[k]
        ]  # fmt: skip
        sized = sorted(((self._cone(k), k) for k in late), reverse=True)
        budget = _MOST_WORK // max(1, len(self.ops))
        out = Rewriter(self.program, self.fingerprints)
        changed = False
        for _, v in sized[:budget]:
            if self.refs[v] and self._cone(v) > min(self.costs[v], weight("mul")) and self._improve(v, out):
                changed = True
        return (out.finish() or self.program) if changed else self.program

    def _cone(self, v: int) -> int:
        dead = self._release(v)
        self._hold(v)
        return dead + self.costs[v]

    def _improve(self, v: int, out: Rewriter) -> bool:
        share = self.costs[v] / weight(self.ops[v])
        freed = self._release(v) + self.costs[v]
        best: tuple[float, Recipe] | None = None
        for recipe in self._recipes(v):
            op, x, y, _ = recipe
            needed = self._needed(v, x, y)
            if needed is None:
                continue
            price = needed + weight(op) * share
            if price < freed - 1 and (best is None or price < best[0]):
                if self._depends(y, v) or (x >= 0 and self._depends(x, v)):
                    continue
                best = price, recipe
        if best is None:
            self._hold(v)
            return False
        op, x, y, flipped = best[1]
        if x < 0:
            x = self._ratio(out, -x - 1)
        node = out.add(op, x, y)
        if flipped:
            node = out.add("neg", node)
        self._extend(out)
        if node == v:
            self._hold(v)
            return False
        out.replace(v, node)
        self.ops[v], self.args[v] = "neg", (node,)  # v stands for the new node from now on
        self._hold(v)
        return True

    def _needed(self, v: int, x: int, y: int) -> int | None:
        """The cost of what two operands bring to life again; None where they may not serve."""
        operands = [k for k in (x, y) if k >= 0]
        mask = 0
        for k in operands:
            if self.main[v] and not self.main[k] and self.costs[k] and not self.early[k]:
                return None
            mask |= self.masks[k]
        if mask & ~self.masks[v]:
            return None
        born = 0
        for k in operands:
            self.refs[k] += 1
            if self.refs[k] == 1:
                born += self.costs[k] + self._hold(k)
        for k in reversed(operands):
            self.refs[k] -= 1
            if self.refs[k] == 0:
                self._release(k)
        return born

    def _ratio(self, out: Rewriter, n: int) -> int:
        node = out.constant(_RATIOS[n])
        self._extend(out)
        return node

    def _extend(self, out: Rewriter) -> None:
        """Take notice of appended nodes."""
        for k in range(len(self.args), len(out.instrs)):
            instr: Instr = out.instrs[k]
            self.args.append(instr.args)
            self.ops.append(instr.op)
            self.refs.append(0)
            self.costs.append(weight(instr.op))
            self.early.append(False)
            self.main.append(True)
            self.masks.append(0)


def _slot(residues: Words) -> Words:
    """Where a residue or its negative is noted in the table."""
    folded = np.minimum(residues, _SHORT - residues)
    return (folded * 1_000_003 >> 4) % _TABLE
