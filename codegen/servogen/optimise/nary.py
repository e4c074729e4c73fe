"""Sums and products as lists of operands: a chain of additions whose inner results nobody else reads is one sum."""

from collections import Counter
from dataclasses import dataclass

from servogen.ir.binding import depends_on_parameters_alone
from servogen.ir.program import Program
from servogen.optimise.rewriter import Rewriter, Signed


@dataclass(frozen=True)
class Flat:
    """sums: root -> its terms with signs; products: root -> its factors. Only what is computed at tick.

    private: nodes that are read once and are no output.
    """

    sums: dict[int, list[Signed]]
    products: dict[int, list[int]]
    private: frozenset[int]


def flatten(program: Program) -> Flat:
    early = depends_on_parameters_alone(program)
    uses = Counter(a for instr in program.instrs for a in instr.args)
    uses.update(n for o in program.outputs for n in o.nodes)
    outputs = {n for o in program.outputs for n in o.nodes}
    private = frozenset(k for k, n in uses.items() if n == 1 and k not in outputs)
    sums: dict[int, list[Signed]] = {}
    products: dict[int, list[int]] = {}
    inner: set[int] = set()

    def terms(k: int, negative: bool) -> list[Signed]:
        op = program.instrs[k].op
        if op == "neg" and not early[k]:
            a = program.instrs[k].args[0]
            if a in sums and a in private and k in private:
                inner.add(a)
                return [(t, s != (not negative)) for t, s in sums[a]]
            return [(a, not negative)]
        if k in sums and k in private:
            inner.add(k)
            return [(t, s != negative) for t, s in sums[k]]
        return [(k, negative)]

    for k, instr in enumerate(program.instrs):
        if early[k]:
            continue
        if instr.op in ("add", "sub"):
            sums[k] = terms(instr.args[0], False) + terms(instr.args[1], instr.op == "sub")
        elif instr.op == "mul":
            factors = []
            for a in instr.args:
                if a in products and a in private:
                    inner.add(a)
                    factors += products[a]
                else:
                    factors.append(a)
            products[k] = factors
    return Flat(
        {k: v for k, v in sums.items() if k not in inner},
        {k: v for k, v in products.items() if k not in inner},
        private,
    )


def emit_sum(out: Rewriter, terms: list[Signed]) -> Signed:
    """A chain of additions, positive terms first so that no sign flip is left over."""
    ordered = [t for t in terms if not t[1]] + [t for t in terms if t[1]]
    total = ordered[0]
    for term in ordered[1:]:
        total = out.sum(total, term)
    return total


def emit_product(out: Rewriter, factors: list[int]) -> int:
    total = factors[0]
    for factor in factors[1:]:
        total = out.add("mul", total, factor)
    return total
