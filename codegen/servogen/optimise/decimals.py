"""Constants as they were meant, where double precision has left its traces before anybody wrote them down.

A model that a library made of numbers holds products folded in double precision (1.6480800000000002 for 9.81 times
0.168), and cosines of quarter turns that are not quite zero: of pi/2 as a double, or as the decimal in a URDF file.
Both hide identities from value numbering. What is changed here is told, as with angles.
"""

from collections.abc import Iterable
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import combinations_with_replacement
from math import prod

import mpmath as mp

from servogen.ir.numbers import DIGITS
from servogen.ir.program import Instr, Program

_ULP = 2.0**-52
_DIGITS = 12  # of a decimal that somebody wrote, or of a product of such
_FOLDS = 4  # ulps by which a few roundings may have moved it
_LARGEST_NOISE = 1e-9
_MOST_FACTORS = 4  # cosines of quarter turns in one folded product


def clean_constants(program: Program) -> tuple[Program, tuple[str, ...]]:
    """The program with folded constants as the decimals next to them, noise of quarter turns as zero; and remarks."""
    values = sorted({i.const for i in program.instrs if isinstance(i.const, Fraction) and i.const})
    meant = {value: _meant(value) for value in values}
    zeros, source = _noise([v for v in values if abs(v) < _LARGEST_NOISE])
    meant |= dict.fromkeys(zeros, Fraction(0))
    changed = [v for v in values if meant[v] != v]
    if not changed:
        return program, ()
    instrs = tuple(
        Instr("const", (), meant[i.const]) if isinstance(i.const, Fraction) and i.const else i for i in program.instrs
    )
    remarks = []
    if zeros:
        remarks.append(f"{float(source)!r} and its multiples are read as 0: the rounding error of a quarter turn")
    folded = [v for v in changed if meant[v]]
    if folded:
        example = f"{float(folded[0])!r} as {float(meant[folded[0]])!r}"
        remarks.append(f"{len(folded)} constants within {_FOLDS} ulps of a short decimal are read as that: {example}")
    return replace(program, instrs=instrs), tuple(remarks)


def _meant(value: Fraction) -> Fraction:
    """The decimal of up to _DIGITS digits within _FOLDS ulps, or the value itself."""
    rounded = Fraction(f"{float(value):.{_DIGITS - 1}e}")
    return rounded if abs(rounded - value) <= _FOLDS * _ULP * abs(value) else value


def _noise(small: list[Fraction]) -> tuple[list[Fraction], Fraction]:
    """Those that are decimal multiples of products of a quarter turn's noise, and one that is the noise itself."""
    bases = [v for v in small if any(_close(abs(float(v)), known, _FOLDS) for known in _quarter_turn_noise())]
    products = [
        float(prod(factors, start=Fraction(1)))
        for count in range(1, _MOST_FACTORS + 1)
        for factors in combinations_with_replacement(sorted({abs(b) for b in bases}), count)
    ]
    return [v for v in small if _is_multiple(float(v), products)], bases[0] if bases else Fraction(0)


def _is_multiple(value: float, of: Iterable[float]) -> bool:
    return any(_close(value / p, float(f"{value / p:.{_DIGITS - 3}e}"), 4 * _FOLDS) for p in of)


def _close(a: float, b: float, ulps: int) -> bool:
    return abs(a - b) <= ulps * _ULP * abs(b)


@cache
def _quarter_turn_noise() -> tuple[float, ...]:
    """What cos or sin gives where zero is meant: of multiples of pi/2 written with 10 to 17 digits, in doubles."""
    found = set()
    with mp.workdps(DIGITS):
        for turns in range(1, 5):
            exact = turns * mp.pi / 2
            for digits in range(10, 18):
                for decimal in (mp.nstr(exact, digits), mp.nstr(exact, digits + 4)[: digits + 1]):  # rounded, cut off
                    angle = mp.mpf(float(decimal))
                    found.add(abs(float(mp.cos(angle) if turns % 2 else mp.sin(angle))))
    return tuple(sorted(found))
