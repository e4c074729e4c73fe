"""Multivariate Horner form: small polynomials are rebuilt with their common factors taken out.

Terms are gathered by what is known at tick; their coefficients, of parameters alone, belong to prepare. A factor may be
an atom or a coefficient. Several orders of choice are tried, and the cheapest program wins.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction

from servogen.ir.binding import depends_on_parameters_alone
from servogen.ir.field import Residue, as_rational, unsigned
from servogen.ir.program import Program
from servogen.optimise.cones import Cones
from servogen.optimise.cost import OPERATION, Objective, weight
from servogen.optimise.fingerprint import Fingerprints
from servogen.optimise.hazards import Hazards
from servogen.optimise.polynomial import Monomial, Polynomial, expansions
from servogen.optimise.rewriter import Rewriter, Signed

MOST_TERMS = 40
"""Terms at tick of the largest polynomial that is rebuilt."""

_SMALL = 300  # instructions at tick of the largest program that is expanded down to its inputs

_RING = ("add", "sub", "mul", "div", "neg")


_ORDERS = range(4)
"""How ties are broken between factors."""


def horner(program: Program, objective: Objective) -> Program:
    """The program with those sums and products rebuilt that become cheaper by it."""
    tried: set[Residue] = set()
    while (better := _one_better(program, objective, tried)) is not None:
        program = better
    return program


def _one_better(program: Program, objective: Objective, tried: set[Residue]) -> Program | None:
    """The program with the first target rebuilt that gains; every target is tried once."""
    search = _Search(program, objective)
    for target in search.targets:
        value = unsigned(search.out.values[target])[0]
        if value not in tried:
            tried.add(value)
            if (found := search.rebuilt(target)) is not None:
                return found
    return None


class _Search:
    def __init__(self, program: Program, objective: Objective) -> None:
        self.program = program
        fingerprints = Fingerprints(program)
        self.cones = Cones(program, objective)
        self.early = depends_on_parameters_alone(program)
        self.masks = Hazards(program, fingerprints).masks
        self.out = Rewriter(program, fingerprints)
        self.by_value: dict[Residue, int] = {}
        for k, instr in enumerate(program.instrs):
            if instr.op not in ("const", "neg") and not self.early[k]:
                self.by_value.setdefault(unsigned(fingerprints.values[k])[0], k)
        self.targets = [k for k in _targets(program, self.early) if self.cones.private(k) > OPERATION // 2]
        shared = _shared(program)
        self.forms = [expansions(program, shared)]
        if shared and len(program.instrs) - sum(self.early) <= _SMALL:
            self.forms.insert(0, expansions(program))

    def rebuilt(self, target: int) -> Program | None:
        """The program with the cheapest form of the target, or None where it gains nothing."""
        cones, out = self.cones, self.out
        share = cones.costs[target] / weight(self.program.instrs[target].op)
        freed = cones.release(target) + cones.costs[target]

        def reusable(value: Residue) -> int | None:
            """A node with this value up to sign that is live without the target and does not depend on it."""
            k = self.by_value.get(value)
            if k is None or not cones.refs[k] or self.masks[k] & ~self.masks[target] or cones.depends(k, target):
                return None
            return k

        count = len(out.instrs)
        best: tuple[int, Polynomial, bool, int] | None = None
        seen: list[Polynomial] = []
        for form in self.forms:
            polynomial = form[target]
            if polynomial in seen:
                continue
            seen.append(polynomial)
            for reuse in (True, False):  # whether nodes that are live anyway may stand for a part
                builder = _Builder(out, self.early, reusable if reuse else None)
                terms = builder.terms(polynomial)
                if terms is None:
                    break
                start = len(out.instrs)
                for order in _ORDERS:
                    root = builder.emit(terms, order)
                    if root != target:
                        cones.extend(out, share)
                        price = cones.use(root)
                        cones.drop(root)
                        if price < freed - OPERATION // 10 and (best is None or price < best[0]):
                            best = price, polynomial, reuse, order
                    cones.truncate(start)
                    out.rollback(start)
                    if not builder.tied:
                        break  # the other orders give the same
                cones.truncate(count)
                out.rollback(count)
                if not builder.reused:
                    break
        if best is None:
            cones.hold(target)
            return None
        _, polynomial, reuse, order = best
        builder = _Builder(out, self.early, reusable if reuse else None)  # while the target's own nodes are not live
        terms = builder.terms(polynomial)
        assert terms is not None
        out.replace(target, builder.emit(terms, order))
        return out.finish()


def _targets(program: Program, early: tuple[bool, ...]) -> list[int]:
    """Sums and products that an output or another kind of operation reads, the last first."""
    read = {n for o in program.outputs for n in o.nodes}
    for instr in program.instrs:
        if instr.op not in _RING:
            read |= set(instr.args)
        elif instr.op == "div":
            read.add(instr.args[1])
    ring = {k for k in read if program.instrs[k].op in _RING and not early[k]}
    inside = {program.instrs[k].args[0] for k in ring if program.instrs[k].op == "neg"}
    ring = {k for k in ring if program.instrs[k].op != "neg"} | {k for k in inside if program.instrs[k].op in _RING}
    return sorted(ring, reverse=True)


def _shared(program: Program) -> set[int]:
    """Sums and products that are read more than once, or are outputs."""
    uses = Counter(a for instr in program.instrs for a in instr.args)
    uses.update(n for o in program.outputs for n in o.nodes)
    return {k for k, n in uses.items() if n > 1 and program.instrs[k].op in _RING}


@dataclass
class _Term:
    """coefficient * monomial; the coefficient is a node of parameters alone, None for one."""

    coefficient: int | None
    negative: bool
    monomial: Monomial


class _Builder:
    """Appends forms of a polynomial to a program. tied: an order had a choice; reused: `reusable` gave a node."""

    def __init__(
        self, out: Rewriter, early: tuple[bool, ...], reusable: Callable[[Residue], int | None] | None
    ) -> None:
        self.out, self.early, self.reusable = out, early, reusable
        self.coefficients: dict[Residue, int] = {}
        self.order = 0
        self.tied = self.reused = False

    # ---- terms ----

    def terms(self, polynomial: Polynomial) -> list[_Term] | None:
        """The polynomial's terms at tick; None where there are too many."""
        grouped: dict[Monomial, Polynomial] = {}
        for monomial, c in polynomial.items():
            late = tuple((a, e) for a, e in monomial if not self._is_early(a))
            grouped.setdefault(late, {})[tuple((a, e) for a, e in monomial if self._is_early(a))] = c
        if len(grouped) > MOST_TERMS:
            return None
        terms = []
        for monomial, coefficient in sorted(grouped.items()):
            node = self._coefficient(coefficient)
            if node is not None:
                terms.append(_Term(None if self._is_one(node[0]) else node[0], node[1], monomial))
        return terms

    def _is_early(self, atom: int) -> bool:
        return self.early[atom if atom >= 0 else -atom - 1]

    def _is_one(self, node: int) -> bool:
        return self.out.instrs[node].const == 1

    def _coefficient(self, polynomial: Polynomial) -> Signed | None:
        """The node of a coefficient up to sign; None where it is zero."""
        if set(polynomial) == {()}:
            number = polynomial[()]
            return self.out.constant(abs(number)), number < 0
        terms = [
            _Term(None if abs(c) == 1 else self.out.constant(abs(c)), c < 0, m) for m, c in sorted(polynomial.items())
        ]
        node, flip = self._sum_of_products(terms)
        value, flipped = unsigned(self.out.values[node])
        if (found := as_rational(self.out.values[node])) is not None:
            exact = Fraction(*found)
            return (self.out.constant(abs(exact)), (exact < 0) != flip) if exact else None
        known = self.coefficients.setdefault(value, node)
        return known, flip != (flipped != unsigned(self.out.values[known])[1])

    # ---- emission ----

    def emit(self, terms: list[_Term], order: int) -> int:
        """The node of the terms' sum."""
        self.order = order
        return self.out.signed(self._emit(terms))

    def _emit(self, terms: list[_Term]) -> Signed:
        if not terms:
            return self.out.constant(Fraction(0)), False
        if (known := self._known(terms)) is not None:
            return known
        factor = self._common_factor(terms)
        if factor is None:
            return self._sum_of_products(terms)
        inside, rest = [], []
        for term in terms:
            if factor in _factors(term):
                inside.append(_divided(term, factor))
            else:
                rest.append(term)
        product = self.out.product(self._node(factor), self._emit(inside))
        return self.out.sum(self._emit(rest), product) if rest else product

    def _known(self, terms: list[_Term]) -> Signed | None:
        if self.reusable is None or (len(terms) == 1 and len(terms[0].monomial) <= 1 and terms[0].coefficient is None):
            return None
        value = self._value(terms)
        key, flipped = unsigned(value)
        node = self.reusable(key)
        if node is None:
            return None
        self.reused = True
        return node, flipped != unsigned(self.out.values[node])[1]

    def _value(self, terms: list[_Term]) -> Residue:
        of, values = self.out.fingerprints.of, self.out.values
        total = self.out.fingerprints.constant(Fraction(0))
        for term in terms:
            product = self.out.fingerprints.constant(Fraction(1))
            for factor in _factors(term, repeat=True):
                product = of("mul", product, self._residue(factor, values))
            total = of("sub" if term.negative else "add", total, product)
        return total

    def _residue(self, factor: tuple[str, int], values: list[Residue]) -> Residue:
        kind, k = factor
        if kind == "atom" and k < 0:
            return self.out.fingerprints.of("div", self.out.fingerprints.constant(Fraction(1)), values[-k - 1])
        return values[k]

    def _common_factor(self, terms: list[_Term]) -> tuple[str, int] | None:
        counts = Counter(f for term in terms for f in _factors(term))
        often = max(counts.values(), default=0)
        if often < 2:
            return None
        best = [f for f in counts if counts[f] == often]
        self.tied |= len(best) > 1
        atoms = [f for f in best if f[0] == "atom"]
        candidates = sorted(atoms if atoms and self.order < 3 else best)
        if self.order == 1:
            return candidates[-1]
        if self.order == 2:  # what leaves the shortest monomials outside
            weights = {f: sum(len(t.monomial) for t in terms if f in _factors(t)) for f in candidates}
            return max(candidates, key=lambda f: weights[f])
        return candidates[0]

    def _node(self, factor: tuple[str, int]) -> Signed:
        kind, k = factor
        if kind == "atom" and k < 0:
            return self.out.add("div", self.out.constant(Fraction(1)), -k - 1), False
        return k, False

    def _sum_of_products(self, terms: list[_Term]) -> Signed:
        total: Signed | None = None
        for term in terms:
            product = self._product(term)
            total = product if total is None else self.out.sum(total, product)
        assert total is not None
        return total

    def _product(self, term: _Term) -> Signed:
        if (known := self._known([term])) is not None:
            return known
        factors = _factors(term, repeat=True)
        divisors = [-k - 1 for kind, k in factors if kind == "atom" and k < 0]
        nodes = [k for kind, k in factors if not (kind == "atom" and k < 0)]
        while len(nodes) > 1:  # a product that exists comes first
            i, j = next(self._pairs(nodes))
            product = self.out.add("mul", nodes[i], nodes[j])
            nodes = [n for x, n in enumerate(nodes) if x not in (i, j)] + [product]
        node = nodes[0] if nodes else self.out.constant(Fraction(1))
        if divisors:
            below = divisors[0]
            for d in divisors[1:]:
                below = self.out.add("mul", below, d)
            node = self.out.add("div", node, below)
        return node, term.negative

    def _pairs(self, nodes: list[int]) -> Iterator[tuple[int, int]]:
        every = [(i, j) for i in range(len(nodes)) for j in range(i + 1, len(nodes))]
        yield from (p for p in every if self.out.exists("mul", nodes[p[0]], nodes[p[1]]))
        yield from every


def _factors(term: _Term, repeat: bool = False) -> list[tuple[str, int]]:
    factors = [] if term.coefficient is None else [("coefficient", term.coefficient)]
    for atom, e in term.monomial:
        factors += [("atom", atom)] * (e if repeat else 1)
    return factors


def _divided(term: _Term, factor: tuple[str, int]) -> _Term:
    kind, k = factor
    if kind == "coefficient":
        return _Term(None, term.negative, term.monomial)
    left = tuple((a, e - (a == k)) for a, e in term.monomial if (a, e) != (k, 1))
    return _Term(term.coefficient, term.negative, left)
