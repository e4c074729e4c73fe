"""Factoring: a b + a c becomes a (b + c), the factor of most terms first."""

from collections import Counter

from servogen.ir.program import Program
from servogen.optimise.fingerprint import Fingerprints
from servogen.optimise.nary import emit_product, emit_sum, flatten
from servogen.optimise.rewriter import Rewriter, Signed

Term = tuple[list[int], bool]
"""Factors of a product that nobody else reads (or one node), and its sign."""


def factor(program: Program) -> Program:
    """Common factors of sums taken out, where the products serve nothing else."""
    flat = flatten(program)
    out = Rewriter(program, Fingerprints(program))
    changed = False
    for root, operands in flat.sums.items():
        terms = [(flat.products[k] if k in flat.products and k in flat.private else [k], s) for k, s in operands]
        if _most_common(terms) is not None:
            out.replace(root, out.signed(_factored(out, terms)))
            changed = True
    return (out.finish() or program) if changed else program


def _most_common(terms: list[Term]) -> int | None:
    """The factor of most terms, at least two; the one defined last among equals, which is the dearest."""
    counts = Counter(f for factors, _ in terms if len(factors) > 1 for f in set(factors))
    often = max(counts.values(), default=0)
    return max(f for f, n in counts.items() if n == often) if often > 1 else None


def _factored(out: Rewriter, terms: list[Term]) -> Signed:
    chosen = _most_common(terms)
    if chosen is None:
        return emit_sum(out, [(emit_product(out, factors), s) for factors, s in terms])
    inside: list[Term] = []
    outside: list[Term] = []
    for factors, s in terms:
        if len(factors) > 1 and chosen in factors:
            left = list(factors)
            left.remove(chosen)
            inside.append((left, s))
        else:
            outside.append((factors, s))
    product = out.product((chosen, False), _factored(out, inside))
    return out.sum(_factored(out, outside), product) if outside else product
