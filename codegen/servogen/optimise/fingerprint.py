"""Every value of a program at random points of a prime field: equal fingerprints mean equal expressions.

Ring operations and division are those of the field. An angle is a point of the circle x^2 + y^2 = 1, so that sines and
cosines obey the group law: angles are taken apart into rational multiples of base angles, each of which has a random
half-angle tangent. Every other operation is opaque: a random value for the operation and its operands' fingerprints,
so that |x|, sqrt(x^2) and x differ, and equal operations on equal operands agree. Division by zero is opaque too.
"""

from collections.abc import Sequence
from fractions import Fraction

from servogen.ir.field import POINTS, PRIME, Residue, as_rational, inverse, negative, random_residue, rational, unsigned
from servogen.ir.ops import COMMUTATIVE, OPS
from servogen.ir.program import Instr, Leaf, Program

ANGLE_FUNCTIONS = ("sin", "cos", "tan")

_UNIT = 2**6 * 3**2 * 5**6 * 7
"""Base angles are atoms over this number: halves, thirds, sevenths and decimals of six places are whole multiples."""

_ONE_RADIAN = random_residue("one radian")
_HUGE = 1 << 200  # a degree beyond any that could be trusted

Linear = dict[Residue, Fraction]
"""An angle as a rational combination of atoms, each known by its fingerprint up to sign."""

Circle = tuple[tuple[int, int], ...]
"""(cosine, sine) at each point."""


class Fingerprints:
    """Fingerprints of a program's instructions in `values`; `of` gives those of operations to come.

    `degree` bounds the degree, numerator and denominator together, of every value as a function of the random numbers.
    """

    def __init__(self, program: Program) -> None:
        self.degree = 1
        self._degrees: dict[Residue, int] = {}
        self._linear: dict[Residue, Linear] = {}
        self._made: dict[Residue, tuple[str, tuple[Residue, ...]]] = {}  # sums and products: how they first came about
        self._circles: dict[Residue, Circle] = {}
        self._memo: dict[tuple[str, tuple[Residue, ...]], Residue] = {}
        self.values: list[Residue] = []
        for instr in program.instrs:
            self.values.append(self.of_instr(instr, [self.values[a] for a in instr.args]))

    def of_instr(self, instr: Instr, operands: Sequence[Residue]) -> Residue:
        if isinstance(instr.const, Fraction):
            return self.constant(instr.const)
        return self.leaf(instr.const) if instr.const is not None else self.of(instr.op, *operands)

    def constant(self, value: Fraction) -> Residue:
        found = rational(value.numerator, value.denominator)
        return random_residue("constant", str(value)) if found is None else found

    def leaf(self, leaf: Leaf) -> Residue:
        value = random_residue("input", *leaf)
        self._degrees[value] = 1
        return value

    def of(self, op: str, *operands: Residue) -> Residue:
        """The fingerprint of an operation on operands with these fingerprints."""
        if op in COMMUTATIVE and operands[1] < operands[0]:
            operands = operands[::-1]
        key = (op, operands)
        value = self._memo.get(key)
        if value is None:
            value = self._memo[key] = self._compute(op, operands)
            self._note_degree(op, operands, value)
        return value

    def _compute(self, op: str, operands: tuple[Residue, ...]) -> Residue:
        row = OPS[op]
        if op in ANGLE_FUNCTIONS:
            return self._of_angle(op, operands[0])
        if row.field is None:
            return _opaque(op, operands)
        try:
            value = tuple(map(row.field, *operands))
        except ZeroDivisionError:
            return _opaque(op, operands)
        self._made.setdefault(value, (op, operands))
        return value

    # ---- angles ----

    def linear(self, value: Residue) -> Linear:
        """A value as a combination of atoms: itself, unless sums and rational multiples made it."""
        stack = [value]
        while stack:
            top = stack[-1]
            missing = [] if top in self._linear else [o for o in self._parts(top) if o not in self._linear]
            if missing:
                stack += missing
                continue
            if top not in self._linear:
                self._linear[top] = self._combined(top)
            stack.pop()
        return self._linear[value]

    def _parts(self, value: Residue) -> tuple[Residue, ...]:
        """The operands through which a value is linear."""
        op, operands = self._made.get(value, ("", ()))
        if op in ("add", "sub", "neg"):
            return operands
        if op == "mul" and _small_constant(operands[0]):
            return operands[1:]
        if op in ("mul", "div") and _small_constant(operands[1]):
            return operands[:1]
        return ()

    def _combined(self, value: Residue) -> Linear:
        constant = _small_constant(value)
        if constant is not None:
            return {_ONE_RADIAN: constant} if constant else {}
        parts = [self._linear[o] for o in self._parts(value)]
        if not parts:
            atom, flipped = unsigned(value)
            return {atom: Fraction(-1 if flipped else 1)}
        op, operands = self._made[value]
        if len(parts) == 2:
            return _combine(parts[0], parts[1], -1 if op == "sub" else 1)
        if op == "neg":
            scale: Fraction | None = Fraction(-1)
        elif op == "mul":
            scale = _small_constant(operands[0]) or _small_constant(operands[1])
        else:
            scale = 1 / (_small_constant(operands[1]) or Fraction(1))
        assert scale is not None
        return {atom: scale * c for atom, c in parts[0].items()}

    def _of_angle(self, op: str, angle: Residue) -> Residue:
        circle: Circle = ((1, 0),) * POINTS
        for atom, coefficient in sorted(self.linear(angle).items()):
            circle = _turn(circle, self._multiple(atom, coefficient))
        if op == "tan":
            try:
                return tuple(s * inverse(c) % PRIME for c, s in circle)
            except ZeroDivisionError:
                return _opaque(op, (angle,))
        return tuple(point[0] if op == "cos" else point[1] for point in circle)

    def _multiple(self, atom: Residue, coefficient: Fraction) -> Circle:
        """The point at `coefficient` times the atom's angle."""
        times = coefficient * _UNIT
        if times.denominator != 1:  # no whole multiple of the base: a base of its own
            flip = coefficient < 0
            own = random_residue("angle", atom, str(abs(coefficient)))
            circle = self._base(own)
            return tuple((c, -s % PRIME) for c, s in circle) if flip else circle
        return tuple(_power(point, times.numerator) for point in self._base(atom))

    def _base(self, atom: Residue) -> Circle:
        if atom not in self._circles:
            points = []
            for h in random_residue("half-angle tangent", atom):
                scale = inverse(1 + h * h)
                points.append(((1 - h * h) * scale % PRIME, 2 * h * scale % PRIME))
            self._circles[atom] = tuple(points)
        return self._circles[atom]

    # ---- degrees ----

    def degree_of(self, value: Residue) -> int:
        return self._degrees.get(value, 1)

    def _note_degree(self, op: str, operands: tuple[Residue, ...], value: Residue) -> None:
        if op in ANGLE_FUNCTIONS:
            combination = self.linear(operands[0]).values()
            degree = sum(2 * abs((c * _UNIT).numerator) if (c * _UNIT).denominator == 1 else 2 for c in combination)
        elif OPS[op].field is None:
            degree = 1
        else:
            degree = sum(self.degree_of(o) for o in operands)
        self._degrees[value] = min(max(degree, self._degrees.get(value, 1)), _HUGE)
        self.degree = max(self.degree, self._degrees[value])

    def false_equality(self, count: int) -> float:
        """A bound on the chance that any comparison among `count` values finds unequal expressions equal.

        Two of degree d agree at a random point with chance at most 2 d / p (Schwartz 1980), so at all of them
        with that to the power POINTS; value numbering and resubstitution compare fewer than 64 count^3 pairs.
        """
        if 2 * self.degree >= PRIME:
            return 1.0
        return min(1.0, 64.0 * float(max(count, 1)) ** 3 * (2.0 * self.degree / PRIME) ** POINTS)


def _opaque(op: str, operands: tuple[Residue, ...]) -> Residue:
    """The value of an opaque operation: random, and with its symmetry in the sign of the last operand."""
    parity = OPS[op].parity
    if not parity:
        return random_residue(op, *operands)
    last, flipped = unsigned(operands[-1])
    value = random_residue(op, *operands[:-1], last)
    return negative(value) if flipped and parity == "odd" else value


def _small_constant(value: Residue) -> Fraction | None:
    if value.count(value[0]) != POINTS:
        return None
    found = as_rational(value, 2**60)
    return None if found is None else Fraction(*found)


def _combine(a: Linear, b: Linear, sign: int) -> Linear:
    total = dict(a)
    for atom, c in b.items():
        total[atom] = total.get(atom, Fraction(0)) + sign * c
        if not total[atom]:
            del total[atom]
    return total


def _turn(a: Circle, b: Circle) -> Circle:
    return tuple(
        ((x * u - y * v) % PRIME, (x * v + y * u) % PRIME) for (x, y), (u, v) in zip(a, b, strict=True)
    )  # fmt: skip


def _power(point: tuple[int, int], times: int) -> tuple[int, int]:
    x, y = point if times >= 0 else (point[0], -point[1] % PRIME)
    times = abs(times)
    c, s = 1, 0
    while times:
        if times & 1:
            c, s = (c * x - s * y) % PRIME, (c * y + s * x) % PRIME
        x, y = (x * x - y * y) % PRIME, 2 * x * y % PRIME
        times >>= 1
    return c, s
