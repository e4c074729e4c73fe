"""A program as formulas: sums, products and fractions as one writes them, with names for what is shared."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

from servogen.ir.program import Output, Program, live
from servogen.report.mathml import bracketed, math, matrix, mi, mn, mo, row, symbol, tag

INLINE = 60
"""Operations, counted as often as they are read, up to which nothing gets a name of its own."""

SHARED = 3
"""Operations from which on a value that is used again is written once and named."""

LARGEST = 400
"""Operations beyond which nobody reads formulas: their number is said instead."""

_SUM, _PRODUCT, _ATOM = 1, 2, 3
_SHORT = 64  # the largest denominator that is written out
_WORDS = {"fmin": "min", "fmax": "max", "fabs": "abs", "log": "ln", "if_else_zero": "if"}
_SIGNS = {"lt": "<", "le": "≤", "eq": "=", "ne": "≠", "and": "∧", "or": "∨"}

Text = tuple[str, int]  # MathML, and how tightly it binds


@dataclass(frozen=True)
class Term:
    """number * product(above) / product(below); nodes with their powers."""

    number: Fraction
    above: Counter[int]
    below: Counter[int]


@dataclass(frozen=True)
class Formulas:
    """Lines of MathML: the definitions of what is shared, then one line an output; none where it is too large."""

    operations: int
    definitions: tuple[str, ...]
    lines: tuple[str, ...]

    @property
    def readable(self) -> bool:
        """Whether anybody would read them."""
        return self.operations <= LARGEST


def formulas(program: Program, names: Callable[[str, int], str]) -> Formulas:
    """The outputs of a program, matrices as such.

    names: (input, index) -> its name in the user's words.
    """
    operations = program.operations()["total"]
    if operations > LARGEST:
        return Formulas(operations, (), ())
    writer = _Writer(program, names)
    shared = writer.shared()
    definitions = tuple(math(writer.named[k], mo("="), writer.written(k)) for k in shared)
    lines = [_line(writer, o) for o in program.outputs]
    return Formulas(operations, definitions, tuple(lines))


def _line(writer: "_Writer", output: Output) -> str:
    entries = [writer.text(n)[0] for n in output.nodes]
    rows = [entries[k : k + output.columns] for k in range(0, len(entries), output.columns)]
    return math(symbol(output.name), mo("="), matrix(rows))


class _Writer:
    """Writes the values of one program; what is named is written once."""

    def __init__(self, program: Program, names: Callable[[str, int], str]) -> None:
        self._instrs = program.instrs
        self._outputs = program.outputs
        self._program = program
        self._names = names
        ordered = sorted(program.inputs, key=lambda i: i.kind == "input")  # what is known early goes first
        self._order = {i.name: sum(before.size for before in ordered[:k]) for k, i in enumerate(ordered)}
        self._known: dict[int, Text] = {}
        self.named: dict[int, str] = {}

    def shared(self) -> list[int]:
        """What gets a name, in the order of computation: used more than once and worth it."""
        alive = sorted(live(self._program, (n for o in self._outputs for n in o.nodes)))
        uses = Counter(a for k in alive for a in self._instrs[k].args)
        uses += Counter(n for o in self._outputs for n in o.nodes)
        size: dict[int, int] = {}
        for k in alive:
            size[k] = sum(size[a] for a in self._instrs[k].args) + (self._instrs[k].const is None)
        if sum(size[n] for o in self._outputs for n in o.nodes) <= INLINE:
            return []
        chosen: list[int] = []
        for k in alive:
            own = sum(size[a] for a in self._instrs[k].args) + (self._instrs[k].const is None)
            size[k] = own
            if own >= SHARED and uses[k] > 1 and self._instrs[k].op != "neg":
                chosen.append(k)
                size[k] = 0
                self.named[k] = tag("msub", mi("w"), mn(str(len(chosen))))
        return chosen

    def text(self, k: int) -> Text:
        if k in self.named:
            return self.named[k], _ATOM
        if k not in self._known:
            self._known[k] = self._write(k)
        return self._known[k]

    def written(self, k: int) -> str:
        """The value of what has a name, in full."""
        return self._write(k)[0]

    def _write(self, k: int) -> Text:
        instr = self._instrs[k]
        if isinstance(instr.const, Fraction):
            return _number(instr.const)
        if instr.const is not None:
            return symbol(self._names(*instr.const)), _ATOM
        whole = instr.op == "pow" and self._factors(k, True) != [(True, k)]
        return self._sum(k) if whole or instr.op in ("add", "sub", "neg", "mul", "div") else self._function(k)

    # ---- sums ----

    def _terms(self, k: int, number: Fraction, first: bool = True) -> list[Term]:
        """A value times a number as terms: inner sums are opened, and halves and thirds of them too."""
        instr = self._instrs[k]
        if k in self.named and not first:
            return [Term(number, Counter({k: 1}), Counter())]
        if instr.op in ("add", "sub"):
            second = number if instr.op == "add" else -number
            return self._terms(instr.args[0], number, False) + self._terms(instr.args[1], second, False)
        if instr.op == "neg":
            return self._terms(instr.args[0], -number, False)
        term = self._term(k, number, first)
        alone = next(iter(term.above)) if term.above.total() == 1 and not term.below else None
        if alone is not None and alone != k and term.number.denominator != 1 and self._is_sum(alone):
            return self._terms(alone, term.number, False)
        return [term]

    def _is_sum(self, k: int) -> bool:
        return self._instrs[k].op in ("add", "sub", "neg") and k not in self.named

    def _sum(self, k: int) -> Text:
        terms = _collected(self._terms(k, Fraction(1)))
        if not terms:
            return mn("0"), _ATOM
        if len(terms) == 1:
            negative, text, binding = self._written_term(terms[0])
            return (row(mo("−"), text), _SUM) if negative else (text, binding)
        if terms[0].number < 0:  # not with a minus if it need not
            terms = sorted(terms, key=lambda t: t.number < 0)
        parts: list[str] = []
        for place, term in enumerate(terms):
            negative, text, binding = self._written_term(term)
            if place or negative:
                parts.append(mo("−" if negative else "+"))
            parts.append(text if binding > _SUM else bracketed(text))
        return row(*parts), _SUM

    # ---- products ----

    def _factors(self, k: int, up: bool, first: bool = True) -> list[tuple[bool, int]]:
        """(above the line, node) of a product, its inner products, quotients and whole powers opened; -1 is a minus."""
        instr = self._instrs[k]
        if k in self.named and not first:
            return [(up, k)]
        if instr.op == "neg":
            return [(up, -1), *self._factors(instr.args[0], up, False)]
        if instr.op in ("mul", "div"):
            second = up if instr.op == "mul" else not up
            return self._factors(instr.args[0], up, False) + self._factors(instr.args[1], second, False)
        exponent = self._instrs[instr.args[1]].const if instr.op == "pow" else None
        if isinstance(exponent, Fraction) and exponent.denominator == 1 and 0 < abs(exponent) < 10:
            return [(up == (exponent > 0), instr.args[0])] * abs(int(exponent))
        return [(up, k)]

    def _term(self, k: int, number: Fraction, first: bool) -> Term:
        """A value times a number as one term; what stands above and below the line goes out."""
        above: Counter[int] = Counter()
        below: Counter[int] = Counter()
        for up, node in self._factors(k, True, first):
            const = Fraction(-1) if node < 0 else self._instrs[node].const
            if isinstance(const, Fraction) and const != 0:
                number = number * const if up else number / const
            else:
                (above if up else below)[node] += 1
        return Term(number, above - below, below - above)

    def _written_term(self, term: Term) -> tuple[bool, str, int]:
        """Whether a minus goes before it, its text and binding."""
        number = _as_fraction(abs(term.number))
        top, bottom = self._powers(term.above), self._powers(term.below)
        negative = term.number < 0
        if number.denominator > _SHORT or _is_decimal(number):
            top.insert(0, _number(number))
            number = Fraction(1)
        over, under = mn(str(number.numerator)), mn(str(number.denominator))
        if number.denominator != 1 and not bottom and len(top) > 1:
            small = tag("mfrac", over, under, displaystyle="false")
            return negative, _juxtaposed([(small, _ATOM), *top]), _PRODUCT
        if number.numerator != 1 or not top:
            top.insert(0, (over, _ATOM))
        if number.denominator != 1:
            bottom.insert(0, (under, _ATOM))
        if not bottom:
            return negative, _juxtaposed(top), _PRODUCT if len(top) > 1 else top[0][1]
        return negative, tag("mfrac", _juxtaposed(top), _juxtaposed(bottom)), _PRODUCT

    def _powers(self, factors: Counter[int]) -> list[Text]:
        ordered = sorted(factors, key=self._place)
        return [self._power(node, count) for node, count in ((n, factors[n]) for n in ordered)]

    def _place(self, node: int) -> tuple[int, int]:
        """Parameters first, as the user declared them, then the other inputs, what has a name, functions, and sums in
        brackets last."""
        instr = self._instrs[node]
        if node in self.named:
            return 1, 0
        if isinstance(instr.const, tuple):
            name, index = instr.const
            return 0, self._order[name] + index
        return (3 if self._is_sum(node) else 2), 0

    def _power(self, node: int, count: int) -> Text:
        if count == 1:
            return self.text(node)
        instr = self._instrs[node]
        if instr.op in ("sin", "cos", "tan") and node not in self.named:
            return self._trigonometric(instr.op, instr.args[0], count), _PRODUCT
        text, binding = self.text(node)
        if text.startswith("<msub>"):  # the power above the index
            return f"<msubsup>{text[len('<msub>') : -len('</msub>')]}{mn(str(count))}</msubsup>", _ATOM
        return tag("msup", text if binding == _ATOM else bracketed(text), mn(str(count))), _ATOM

    # ---- functions ----

    def _function(self, k: int) -> Text:
        instr = self._instrs[k]
        arguments = [self.text(a) for a in instr.args]
        texts = [text for text, _ in arguments]
        if instr.op == "sqrt":
            return tag("msqrt", texts[0]), _ATOM
        if instr.op == "fabs":
            return row(mo("|"), texts[0], mo("|")), _ATOM
        if instr.op == "pow":
            base = texts[0] if arguments[0][1] == _ATOM else bracketed(texts[0])
            return tag("msup", base, texts[1]), _PRODUCT
        if instr.op == "exp":
            return tag("msup", mi("e", upright=True), texts[0]), _PRODUCT
        if instr.op in ("sin", "cos", "tan"):
            return self._trigonometric(instr.op, instr.args[0], 1), _PRODUCT
        if instr.op in _SIGNS:
            return row(_closed(arguments[0]), mo(_SIGNS[instr.op]), _closed(arguments[1])), _SUM
        inner = [part for place, text in enumerate(texts) for part in (mo(",") if place else "", text)]
        return row(mi(_WORDS.get(instr.op, instr.op)), bracketed("".join(inner))), _ATOM

    def _trigonometric(self, op: str, argument: int, power: int) -> str:
        name = mi(op) if power == 1 else tag("msup", mi(op), mn(str(power)))
        text, binding = self.text(argument)
        space = tag("mspace", width="0.17em")
        return row(name, *((space, text) if binding == _ATOM else (bracketed(text),)))


def _collected(terms: Sequence[Term]) -> list[Term]:
    """Terms of the same factors added up; what adds up to nothing is gone."""
    numbers: dict[Any, Fraction] = {}
    first: dict[Any, Term] = {}
    for term in terms:
        key = frozenset(term.above.items()), frozenset(term.below.items())
        numbers[key] = numbers.get(key, Fraction(0)) + term.number
        first.setdefault(key, term)
    return [replace(first[key], number=number) for key, number in numbers.items() if number != 0]


def _juxtaposed(factors: Sequence[Text]) -> str:
    """Factors side by side; a number between others gets a dot."""
    if not factors:
        return mn("1")
    if len(factors) == 1:
        return factors[0][0]
    parts: list[str] = []
    for place, (text, binding) in enumerate(factors):
        if place:
            digit = text.startswith("<mn>")
            parts.append(mo("·") if digit else tag("mspace", width="0.17em"))
        parts.append(text if binding > _SUM else bracketed(text))
    return row(*parts)


def _closed(operand: Text) -> str:
    text, binding = operand
    return text if binding > _SUM else bracketed(text)


def _is_decimal(value: Fraction) -> bool:
    """Whether one writes 0.3 or 1.25 rather than a fraction; halves, quarters and eighths are fractions."""
    return value.denominator not in (1, 2, 4, 8) and len(f"{float(value):.15g}") <= 6


def _as_fraction(value: Fraction) -> Fraction:
    """One twelfth for 0.08333333333333333; what has a short decimal is no fraction, but for the simplest."""
    near = value.limit_denominator(_SHORT)
    short = len(f"{float(value):.15g}") <= 6 and near.denominator not in (1, 2, 3, 4, 6, 8)
    return near if not short and abs(near - value) <= abs(value) / 10**15 else value


def _number(value: Fraction) -> Text:
    """As a fraction where that is short, else the shortest decimal."""
    if value < 0:
        return row(mo("−"), _number(-value)[0]), _SUM
    if value.denominator == 1 and value.numerator < 10**6:
        return mn(str(value.numerator)), _ATOM
    text = f"{float(value):.12g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        digits = mn(str(abs(int(exponent))))
        power = tag("msup", mn("10"), row(mo("−"), digits) if int(exponent) < 0 else digits)
        return (power, _PRODUCT) if mantissa == "1" else (row(mn(mantissa), mo("·"), power), _PRODUCT)
    return mn(text), _ATOM
