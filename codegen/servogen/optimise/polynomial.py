"""Polynomials over a program's atoms, bounded in size: the normal form in which terms meet and cancel.

Atoms are what is not a sum, product or quotient: inputs, functions, reciprocals of divisors. Coefficients are exact.
"""

from collections.abc import Collection
from fractions import Fraction

from servogen.ir.program import Program

Monomial = tuple[tuple[int, int], ...]
"""(atom, exponent), in order of the atoms. Atom k >= 0 is instruction k, atom -k - 1 its reciprocal."""

Polynomial = dict[Monomial, Fraction]

LARGEST = 64
"""Terms of the largest polynomial that is formed; what would have more is an atom."""

_LARGEST_DEGREE = 12


def expansions(program: Program, atoms: Collection[int] = (), largest: int = LARGEST) -> list[Polynomial]:
    """Every instruction as a polynomial; those in `atoms`, and those too large, are atoms themselves."""
    kept = set(atoms)
    result: list[Polynomial] = []
    for k in range(len(program.instrs)):
        found = None if k in kept else _expand(program, k, result, largest)
        result.append(_atom(k) if found is None or len(found) > largest else found)
    return result


def _expand(program: Program, k: int, known: list[Polynomial], largest: int) -> Polynomial | None:
    instr = program.instrs[k]
    if isinstance(instr.const, Fraction):
        return {(): instr.const} if instr.const else {}
    if instr.op not in ("add", "sub", "mul", "div", "neg"):
        return None
    a = known[instr.args[0]]
    if instr.op == "neg":
        return {m: -c for m, c in a.items()}
    b = known[instr.args[1]]
    if instr.op == "add":
        return _sum(a, b, 1)
    if instr.op == "sub":
        return _sum(a, b, -1)
    if instr.op == "mul":
        return _product(a, b, largest)
    if len(b) != 1:
        return _product(a, {((-instr.args[1] - 1, 1),): Fraction(1)}, largest)
    ((monomial, coefficient),) = b.items()
    reciprocal = tuple(sorted((-atom - 1, e) for atom, e in monomial))
    if any(-atom - 1 == other for atom, _ in reciprocal for m in a for other, _ in m):
        return _product(a, {((-instr.args[1] - 1, 1),): Fraction(1)}, largest)
    return _product(a, {reciprocal: 1 / coefficient}, largest)


def _atom(k: int) -> Polynomial:
    return {((k, 1),): Fraction(1)}


def _sum(a: Polynomial, b: Polynomial, sign: int) -> Polynomial:
    total = dict(a)
    for monomial, c in b.items():
        new = total.get(monomial, Fraction(0)) + sign * c
        if new:
            total[monomial] = new
        else:
            total.pop(monomial, None)
    return total


def _product(a: Polynomial, b: Polynomial, largest: int) -> Polynomial | None:
    if len(a) * len(b) > 2 * largest:
        return None
    total: Polynomial = {}
    for m, c in a.items():
        for n, d in b.items():
            monomial = times(m, n)
            if sum(e for _, e in monomial) > _LARGEST_DEGREE:
                return None
            new = total.get(monomial, Fraction(0)) + c * d
            if new:
                total[monomial] = new
            else:
                total.pop(monomial, None)
    return total


def times(m: Monomial, n: Monomial) -> Monomial:
    """The product of two monomials."""
    if not m or not n:
        return m or n
    exponents = dict(m)
    for atom, e in n:
        exponents[atom] = exponents.get(atom, 0) + e
    return tuple(sorted(exponents.items()))
