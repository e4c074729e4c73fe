"""Shared pairs: two operands that meet in several sums, or several products, are joined once, as in logic synthesis."""

from collections import Counter, defaultdict
from collections.abc import Hashable
from itertools import combinations

from servogen.ir.program import Program
from servogen.optimise.fingerprint import Fingerprints
from servogen.optimise.nary import emit_product, emit_sum, flatten
from servogen.optimise.rewriter import Rewriter, Signed

_LONGEST = 40  # operands of a list that takes part; longer ones have too many pairs


def share_pairs(program: Program) -> Program:
    """The most frequent pair of operands becomes a value of its own, until every pair is met once."""
    flat = flatten(program)
    out = Rewriter(program, Fingerprints(program))
    changed = _share_sums(out, flat.sums) | _share_products(out, flat.products)
    if not changed:
        return program
    return out.finish() or program


class _Lists:
    """Lists of operands and how often each pair of them meets."""

    def __init__(self, lists: dict[int, list[tuple[int, bool]]]) -> None:
        self.lists = {root: operands for root, operands in lists.items() if 2 < len(operands) <= _LONGEST}
        self.pairs = lists  # two operands alone are a pair that exists already
        self.counts: Counter[tuple[int, int, bool]] = Counter()
        self.where: dict[Hashable, set[int]] = defaultdict(set)
        for root, operands in lists.items():
            if 2 <= len(operands) <= _LONGEST:
                self._count(root, operands, 1)

    def _count(self, root: int, operands: list[tuple[int, bool]], by: int) -> None:
        for key in {_key(a, b) for a, b in combinations(operands, 2)}:
            self.counts[key] += by
            if by > 0:
                self.where[key].add(root)
            else:
                self.where[key].discard(root)

    def best(self) -> tuple[int, int, bool] | None:
        """The pair that most lists share, the first of them by number."""
        often = max(self.counts.values(), default=0)
        return min(k for k, n in self.counts.items() if n == often) if often > 1 else None

    def join(self, key: tuple[int, int, bool], node: tuple[int, bool]) -> bool:
        """Put `node` in place of the pair wherever it is; `node` is x + y or x - y for the pair's x taken positive."""
        changed = False
        for root in sorted(self.where[key]):
            operands = self.pairs[root]
            self._count(root, operands, -1)
            while len(operands) > 2 and (found := _find(operands, key)) is not None:
                i, j = found
                sign = operands[i][1] if operands[i][0] == key[0] else operands[j][1]
                rest = [t for x, t in enumerate(operands) if x not in (i, j)]
                operands = [*rest, (node[0], node[1] != sign)]
                changed = True
            self.pairs[root] = operands
            self._count(root, operands, 1)
        self.counts[key] = 0
        return changed


def _key(a: tuple[int, bool], b: tuple[int, bool]) -> tuple[int, int, bool]:
    x, y = sorted((a, b))
    return x[0], y[0], x[1] != y[1]


def _find(operands: list[tuple[int, bool]], key: tuple[int, int, bool]) -> tuple[int, int] | None:
    for i, j in combinations(range(len(operands)), 2):
        if _key(operands[i], operands[j]) == key:
            return i, j
    return None


def _share_sums(out: Rewriter, sums: dict[int, list[Signed]]) -> bool:
    lists = _Lists({root: list(terms) for root, terms in sums.items()})
    changed = False
    while (key := lists.best()) is not None:
        node = out.sum((key[0], False), (key[1], key[2]))
        changed |= lists.join(key, node)
    for root, terms in lists.pairs.items():
        if terms != sums[root]:
            out.replace(root, out.signed(emit_sum(out, terms)))
    return changed


def _share_products(out: Rewriter, products: dict[int, list[int]]) -> bool:
    lists = _Lists({root: [(f, False) for f in factors] for root, factors in products.items()})
    changed = False
    while (key := lists.best()) is not None:
        node = out.add("mul", key[0], key[1])
        changed |= lists.join(key, (node, False))
    for root, factors in lists.pairs.items():
        if len(factors) != len(products[root]):
            out.replace(root, emit_product(out, [f for f, _ in factors]))
    return changed
