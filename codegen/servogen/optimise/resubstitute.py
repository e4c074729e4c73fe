"""Resubstitution: a value is computed anew from one or two that are live anyway, so that its private cone dies.

As logic synthesis does, with +, - and *; it invents no division, which would cost more and may not exist everywhere.
Candidates are found with short residues by whole arrays and confirmed with the full fingerprints.
"""

from collections.abc import Iterator
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from servogen.ir.field import POINTS, PRIME, Residue, inverse, unsigned
from servogen.ir.program import Program
from servogen.optimise.cones import Cones
from servogen.optimise.cost import Objective, weight
from servogen.optimise.fingerprint import Fingerprints
from servogen.optimise.hazards import Hazards
from servogen.optimise.rewriter import Rewriter

_SHORT = 2**31 - 1
_TABLE = 1 << 20
_MOST_WORK = 60_000_000  # nodes times candidates; a larger program is searched in part, its largest cones first
_RATIOS = tuple(Fraction(n, d) for n, d in ((2, 1), (1, 2), (3, 1), (1, 3), (4, 1), (1, 4), (3, 2), (2, 3)))
_INVERSE_RATIOS = tuple(tuple(r.denominator * inverse(r.numerator) % PRIME for _ in range(POINTS)) for r in _RATIOS)

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
        self.cones = Cones(program, objective)
        self.main = [c == weight(i.op) for c, i in zip(self.cones.costs, program.instrs, strict=True)]
        self.inverses: dict[int, Residue] = {}
        self.node_of: dict[Residue, int] = {}
        for k, value in enumerate(self.values):
            self.node_of.setdefault(unsigned(value)[0], k)
        self._short_residues()

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
        value = self.values[v]
        for n, number in enumerate(_INVERSE_RATIOS):
            if (found := self._signed(tuple(a * b % PRIME for a, b in zip(value, number, strict=True)))) is not None:
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
        if x == v or self.program.instrs[x].op == "neg":
            return
        pairs = zip(self.values[v], self.values[x], strict=True)
        if form == "sub":
            wanted = tuple((a - b) % PRIME for a, b in pairs)
        elif form == "add":
            wanted = tuple((a + b) % PRIME for a, b in pairs)
        elif not all(self.values[x]):
            return
        else:
            wanted = tuple(a * b % PRIME for a, b in zip(self.values[v], self._inverse_of(x), strict=True))
        found = self._signed(wanted)
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

    def _inverse_of(self, x: int) -> Residue:
        if x not in self.inverses:
            self.inverses[x] = tuple(inverse(a) for a in self.values[x])
        return self.inverses[x]

    def _signed(self, value: Residue) -> tuple[int, bool] | None:
        """The node of a value or of its negative."""
        key, flipped = unsigned(value)
        node = self.node_of.get(key)
        return None if node is None else (node, flipped != unsigned(self.values[node])[1])

    # ---- the search ----

    def run(self) -> Program:
        cones, instrs = self.cones, self.program.instrs
        late = [
            k
            for k, i in enumerate(instrs)
            if i.op not in ("input", "const", "neg") and not cones.early[k] and cones.costs[k]
        ]
        sized = sorted(((cones.private(k), k) for k in late), reverse=True)
        budget = _MOST_WORK // max(1, len(instrs))
        out = Rewriter(self.program, self.fingerprints)
        changed = False
        for _, v in sized[:budget]:
            worthwhile = cones.private(v) > min(cones.costs[v], weight("mul"))
            if cones.refs[v] and worthwhile and self._improve(v, out):
                changed = True
        return (out.finish() or self.program) if changed else self.program

    def _improve(self, v: int, out: Rewriter) -> bool:
        cones = self.cones
        share = cones.costs[v] / weight(self.program.instrs[v].op)
        freed = cones.release(v) + cones.costs[v]
        best: tuple[float, Recipe] | None = None
        for recipe in self._recipes(v):
            op, x, y, _ = recipe
            operands = [k for k in (x, y) if k >= 0]
            if not self._may_serve(v, operands):
                continue
            born = sum(cones.use(k) for k in operands)
            for k in reversed(operands):
                cones.drop(k)
            price = born + weight(op) * share
            if price < freed - 1 and (best is None or price < best[0]):
                if any(cones.depends(k, v) for k in operands):
                    continue
                best = price, recipe
        node = v if best is None else self._built(best[1], out, share)
        if node == v:
            cones.hold(v)
            return False
        out.replace(v, node)
        cones.args[v], cones.costs[v] = (node,), 0  # v stands for the new node from now on
        cones.hold(v)
        return True

    def _may_serve(self, v: int, operands: list[int]) -> bool:
        """Whether v gains no hazard from them, and does not draw into the main outputs what served others alone."""
        mask = 0
        for k in operands:
            if self.main[v] and not self.main[k] and self.cones.costs[k] and not self.cones.early[k]:
                return False
            mask |= self.masks[k]
        return not mask & ~self.masks[v]

    def _built(self, recipe: Recipe, out: Rewriter, share: float) -> int:
        op, x, y, flipped = recipe
        node = out.add(op, out.constant(_RATIOS[-x - 1]) if x < 0 else x, y)
        if flipped:
            node = out.add("neg", node)
        self.cones.extend(out, share)
        return node


def _slot(residues: Words) -> Words:
    """Where a residue or its negative is noted in the table."""
    folded = np.minimum(residues, _SHORT - residues)
    return (folded * 1_000_003 >> 4) % _TABLE
