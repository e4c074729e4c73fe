"""The op table: one row gives an operation's arity, CasADi id, evaluators, derivatives and C form.

Lowering, interpreter, rounding analysis, optimiser, printer and tests all read this one table; a new operation is one
new row. Semantics are C99's (<math.h>); truth values are 0 and 1.
"""

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
from flint import arb

from servogen.ir.balls import NAN, ZERO, Ball, ball, middle
from servogen.ir.field import PRIME, inverse

Evaluator = Callable[..., Any]


@dataclass(frozen=True)
class Op:
    """One operation.

    c: its C form; {0}, {1} are the operands, {f} the suffix of <math.h> names ("" or "f"), {real} the type.
    numpy: on arrays of float64 or float32.
    ball: on balls (balls.py), at the working precision; what jumps is decided by the midpoints.
    exact: on Fractions, or None where the result is irrational in general.
    partials: (operands..., value) -> derivative with respect to each operand, on arrays.
    rounding: its largest error in units in the last place (0.5: correctly rounded; 0: exact).
    telling: the operands whose NaN or infinity no value of the others can hide: the result is then not finite either.
    field: on residues of ir/field.py; None where no formula over a field gives the operation (it is opaque there), and
    for division by zero. parity: "odd" or "even" in the last operand where opaque ones have a symmetry.
    """

    name: str
    arity: int
    casadi_id: int
    c: str
    numpy: Evaluator
    ball: Evaluator
    exact: Evaluator | None
    partials: Evaluator
    rounding: float
    commutative: bool = False
    field: Evaluator | None = None
    parity: str = ""
    telling: tuple[int, ...] = ()

    @property
    def needs_libm(self) -> bool:
        """Whether the C form calls a function of <math.h>."""
        return "{f}(" in self.c


def _truth(test: Evaluator) -> Evaluator:
    """A comparison on arrays, its result in the operands' type."""
    return lambda *a: test(*a).astype(np.result_type(*a))


def _exact_pow(a: Fraction, b: Fraction) -> Fraction | None:
    if b.denominator != 1 or (a == 0 and b < 0) or abs(b) > 64:
        return None
    return Fraction(a**b.numerator)


def _exact_sqrt(a: Fraction) -> Fraction | None:
    if a < 0:
        return None
    n, d = math.isqrt(a.numerator), math.isqrt(a.denominator)
    return Fraction(n, d) if n * n == a.numerator and d * d == a.denominator else None


def _at_zero(value: int) -> Evaluator:
    """Exact at 0 only, as sin(0) = 0."""
    return lambda a: Fraction(value) if a == 0 else None


def _zero(*operands: Any) -> tuple[Any, ...]:
    return tuple(np.zeros_like(a) for a in operands[:-1])


def _safe(numerator: Any, denominator: Any) -> Any:
    return numerator / np.where(denominator == 0, np.nan, denominator)


def _pow_partials(a: Any, b: Any, v: Any) -> tuple[Any, Any]:
    return b * np.power(a, b - 1), v * np.log(np.where(a > 0, a, 1.0))


def _root(a: Ball) -> Ball:
    """The square root; of a ball around zero whose midpoint is not negative, that of its part from zero on."""
    return a.nonnegative_part().sqrt() if a.mid() >= 0 else NAN


def _less_multiples(whole: Evaluator) -> Evaluator:
    """a less the whole number of b's that the quotient of the midpoints, which is exact, comes to."""
    return lambda a, b: a - b * ball(Fraction(whole(middle(a) / middle(b))))


def _least(a: Ball, b: Ball) -> Ball:
    return b if a.is_nan() or b.mid() < a.mid() else a


def _greatest(a: Ball, b: Ball) -> Ball:
    return b if a.is_nan() or b.mid() > a.mid() else a


def _decided(test: Evaluator) -> Evaluator:
    """A comparison of midpoints, its result 0 or 1, or NaN where an operand does not exist."""
    return lambda *operands: NAN if any(a.is_nan() for a in operands) else arb(int(test(*(a.mid() for a in operands))))


def _guarded(a: Ball, b: Ball) -> Ball:
    return NAN if a.is_nan() else b if a.mid() != 0 else ZERO


# One row an operation, kept as a table.
# fmt: off
def _remainder(a: Any, b: Any) -> Any:
    """C's remainder, which is exact; numpy has none."""
    one = np.vectorize(lambda x, y: math.nan if math.isinf(x) or y == 0 else math.remainder(x, y), otypes=[float])
    return one(a, b).astype(np.result_type(a, b))


def _erf(a: Any) -> Any:
    """C's erf; numpy has none."""
    return np.vectorize(math.erf, otypes=[float])(a).astype(np.asarray(a).dtype)


_ROWS = (
    Op("add", 2, ca.OP_ADD, "{0} + {1}", np.add, lambda a, b: a + b, lambda a, b: a + b,
       lambda a, b, v: (np.ones_like(a), np.ones_like(b)), 0.5, commutative=True,
       field=lambda a, b: (a + b) % PRIME, telling=(0, 1)),
    Op("sub", 2, ca.OP_SUB, "{0} - {1}", np.subtract, lambda a, b: a - b, lambda a, b: a - b,
       lambda a, b, v: (np.ones_like(a), -np.ones_like(b)), 0.5, field=lambda a, b: (a - b) % PRIME, telling=(0, 1)),
    Op("mul", 2, ca.OP_MUL, "{0} * {1}", np.multiply, lambda a, b: a * b, lambda a, b: a * b, lambda a, b, v: (b, a),
       0.5, commutative=True, field=lambda a, b: a * b % PRIME, telling=(0, 1)),
    Op("div", 2, ca.OP_DIV, "{0} / {1}", np.divide, lambda a, b: a / b, lambda a, b: a / b if b else None,
       lambda a, b, v: (_safe(1.0, b), -_safe(v, b)), 0.5, field=lambda a, b: a * inverse(b) % PRIME, telling=(0,)),
    Op("neg", 1, ca.OP_NEG, "-{0}", np.negative, lambda a: -a, lambda a: -a, lambda a, v: (-np.ones_like(a),), 0.0,
       field=lambda a: -a % PRIME, telling=(0,)),
    Op("sqrt", 1, ca.OP_SQRT, "sqrt{f}({0})", np.sqrt, _root, _exact_sqrt, lambda a, v: (_safe(0.5, v),), 0.5,
       telling=(0,)),
    Op("fabs", 1, ca.OP_FABS, "fabs{f}({0})", np.fabs, abs, abs, lambda a, v: (np.sign(a),), 0.0,
       parity="even", telling=(0,)),
    Op("sin", 1, ca.OP_SIN, "sin{f}({0})", np.sin, arb.sin, _at_zero(0), lambda a, v: (np.cos(a),), 1.0, telling=(0,)),
    Op("cos", 1, ca.OP_COS, "cos{f}({0})", np.cos, arb.cos, _at_zero(1), lambda a, v: (-np.sin(a),), 1.0, telling=(0,)),
    Op("tan", 1, ca.OP_TAN, "tan{f}({0})", np.tan, arb.tan, _at_zero(0), lambda a, v: (1.0 + v * v,), 1.0,
       telling=(0,)),
    Op("asin", 1, ca.OP_ASIN, "asin{f}({0})", np.arcsin, arb.asin, _at_zero(0),
       lambda a, v: (_safe(1.0, np.sqrt(1.0 - a * a)),), 1.0, parity="odd", telling=(0,)),
    Op("acos", 1, ca.OP_ACOS, "acos{f}({0})", np.arccos, arb.acos, None,
       lambda a, v: (-_safe(1.0, np.sqrt(1.0 - a * a)),), 1.0, telling=(0,)),
    Op("atan", 1, ca.OP_ATAN, "atan{f}({0})", np.arctan, arb.atan, _at_zero(0), lambda a, v: (1.0 / (1.0 + a * a),),
       1.0, parity="odd"),
    Op("atan2", 2, ca.OP_ATAN2, "atan2{f}({0}, {1})", np.arctan2, arb.atan2, None,
       lambda a, b, v: (_safe(b, a * a + b * b), -_safe(a, a * a + b * b)), 1.0),
    Op("exp", 1, ca.OP_EXP, "exp{f}({0})", np.exp, arb.exp, _at_zero(1), lambda a, v: (v,), 1.0),
    Op("log", 1, ca.OP_LOG, "log{f}({0})", np.log, arb.log, lambda a: Fraction(0) if a == 1 else None,
       lambda a, v: (_safe(1.0, a),), 1.0, telling=(0,)),
    Op("expm1", 1, ca.OP_EXPM1, "expm1{f}({0})", np.expm1, arb.expm1, _at_zero(0), lambda a, v: (v + 1.0,), 1.0),
    Op("log1p", 1, ca.OP_LOG1P, "log1p{f}({0})", np.log1p, arb.log1p, _at_zero(0), lambda a, v: (_safe(1.0, 1.0 + a),),
       1.0, telling=(0,)),
    Op("sinh", 1, ca.OP_SINH, "sinh{f}({0})", np.sinh, arb.sinh, _at_zero(0), lambda a, v: (np.cosh(a),), 2.0,
       parity="odd", telling=(0,)),
    Op("cosh", 1, ca.OP_COSH, "cosh{f}({0})", np.cosh, arb.cosh, _at_zero(1), lambda a, v: (np.sinh(a),), 2.0,
       parity="even", telling=(0,)),
    Op("tanh", 1, ca.OP_TANH, "tanh{f}({0})", np.tanh, arb.tanh, _at_zero(0), lambda a, v: (1.0 - v * v,), 2.0,
       parity="odd"),
    Op("asinh", 1, ca.OP_ASINH, "asinh{f}({0})", np.arcsinh, arb.asinh, _at_zero(0),
       lambda a, v: (1.0 / np.sqrt(1.0 + a * a),), 2.0, parity="odd", telling=(0,)),
    Op("acosh", 1, ca.OP_ACOSH, "acosh{f}({0})", np.arccosh, arb.acosh, None,
       lambda a, v: (_safe(1.0, np.sqrt(a * a - 1.0)),), 2.0, telling=(0,)),
    Op("atanh", 1, ca.OP_ATANH, "atanh{f}({0})", np.arctanh, arb.atanh, _at_zero(0),
       lambda a, v: (_safe(1.0, 1.0 - a * a),), 2.0, parity="odd"),
    Op("erf", 1, ca.OP_ERF, "erf{f}({0})", _erf, arb.erf, _at_zero(0),
       lambda a, v: (2.0 / math.sqrt(math.pi) * np.exp(-a * a),), 1.0, parity="odd"),
    Op("pow", 2, ca.OP_POW, "pow{f}({0}, {1})", np.power, lambda a, b: a**b, _exact_pow, _pow_partials, 1.0),
    Op("hypot", 2, ca.OP_HYPOT, "hypot{f}({0}, {1})", np.hypot, lambda a, b: (a * a + b * b).sqrt(), None,
       lambda a, b, v: (_safe(a, v), _safe(b, v)), 1.0, commutative=True, telling=(0, 1)),
    Op("fmod", 2, ca.OP_FMOD, "fmod{f}({0}, {1})", np.fmod, _less_multiples(math.trunc), None,
       lambda a, b, v: (np.ones_like(a), -np.trunc(_safe(a, b))), 0.0, telling=(0,)),
    Op("remainder", 2, ca.OP_REMAINDER, "remainder{f}({0}, {1})", _remainder,
       _less_multiples(round), None, lambda a, b, v: (np.ones_like(a), -np.rint(_safe(a, b))), 0.0,
       telling=(0,)),
    Op("fmin", 2, ca.OP_FMIN, "fmin{f}({0}, {1})", np.fmin, _least, min,
       lambda a, b, v: ((a <= b) * 1.0, (a > b) * 1.0), 0.0, commutative=True),
    Op("fmax", 2, ca.OP_FMAX, "fmax{f}({0}, {1})", np.fmax, _greatest, max,
       lambda a, b, v: ((a >= b) * 1.0, (a < b) * 1.0), 0.0, commutative=True),
    Op("floor", 1, ca.OP_FLOOR, "floor{f}({0})", np.floor, lambda a: a.mid().floor(),
       lambda a: Fraction(math.floor(a)), _zero, 0.0),
    Op("ceil", 1, ca.OP_CEIL, "ceil{f}({0})", np.ceil, lambda a: a.mid().ceil(),
       lambda a: Fraction(math.ceil(a)), _zero, 0.0),
    Op("sign", 1, ca.OP_SIGN, "({real})(({0} > 0) - ({0} < 0))", np.sign, lambda a: a.mid().sgn(),
       lambda a: Fraction((a > 0) - (a < 0)), _zero, 0.0, parity="odd"),
    Op("copysign", 2, ca.OP_COPYSIGN, "copysign{f}({0}, {1})", np.copysign,
       lambda a, b: -abs(a) if b.mid() < 0 else abs(a), None,
       lambda a, b, v: (np.where(np.signbit(a) == np.signbit(b), 1.0, -1.0), np.zeros_like(b)), 0.0),
    Op("lt", 2, ca.OP_LT, "({real})({0} < {1})", _truth(np.less), _decided(operator.lt),
       lambda a, b: Fraction(a < b), _zero, 0.0),
    Op("le", 2, ca.OP_LE, "({real})({0} <= {1})", _truth(np.less_equal), _decided(operator.le),
       lambda a, b: Fraction(a <= b), _zero, 0.0),
    Op("eq", 2, ca.OP_EQ, "({real})({0} == {1})", _truth(np.equal), _decided(operator.eq),
       lambda a, b: Fraction(a == b), _zero, 0.0, commutative=True),
    Op("ne", 2, ca.OP_NE, "({real})({0} != {1})", _truth(np.not_equal), _decided(operator.ne),
       lambda a, b: Fraction(a != b), _zero, 0.0, commutative=True),
    Op("not", 1, ca.OP_NOT, "({real})({0} == 0)", _truth(np.logical_not), _decided(lambda a: a == 0),
       lambda a: Fraction(a == 0), _zero, 0.0),
    Op("and", 2, ca.OP_AND, "({real})({0} != 0 && {1} != 0)", _truth(np.logical_and),
       _decided(lambda a, b: a != 0 and b != 0), lambda a, b: Fraction(a != 0 and b != 0), _zero, 0.0,
       commutative=True),
    Op("or", 2, ca.OP_OR, "({real})({0} != 0 || {1} != 0)", _truth(np.logical_or),
       _decided(lambda a, b: a != 0 or b != 0), lambda a, b: Fraction(a != 0 or b != 0), _zero, 0.0,
       commutative=True),
    Op("if_else_zero", 2, ca.OP_IF_ELSE_ZERO, "({0} != 0 ? {1} : 0)",
       lambda a, b: np.where(a != 0, b, np.zeros_like(b)), _guarded,
       lambda a, b: b if a != 0 else Fraction(0), lambda a, b, v: (np.zeros_like(a), (a != 0) * 1.0), 0.0,
       parity="odd"),
)
# fmt: on


OPS: dict[str, Op] = {row.name: row for row in _ROWS}
COMMUTATIVE = frozenset(row.name for row in _ROWS if row.commutative)
BY_CASADI_ID: dict[int, Op] = {row.casadi_id: row for row in _ROWS}

# CasADi's abbreviations and structural instructions, which lowering expresses by the rows above.
ABBREVIATIONS = {ca.OP_ASSIGN, ca.OP_SQ, ca.OP_TWICE, ca.OP_INV, ca.OP_CONSTPOW}
STRUCTURAL = {ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_PARAMETER}

_CASADI_NAMES = {getattr(ca, k): k[3:].lower() for k in dir(ca) if k.startswith("OP_")}


def casadi_name(casadi_id: int) -> str:
    """CasADi's own name of an operation, in lower case."""
    return _CASADI_NAMES.get(casadi_id, "unknown")


def unsupported_operations(expression: Any) -> list[tuple[str, int]]:
    """(name, CasADi id) of every operation in an SX expression that the table has no row for."""
    function = _scan(expression)
    found: dict[int, str] = {}
    for k in range(function.n_instructions()):
        casadi_id = function.instruction_id(k)
        if casadi_id not in BY_CASADI_ID and casadi_id not in ABBREVIATIONS | STRUCTURAL:
            found[casadi_id] = casadi_name(casadi_id)
    return [(name, casadi_id) for casadi_id, name in found.items()]


def operations(expression: Any) -> list[str]:
    """The rows of the table that an SX expression uses, each once, in the order of its instructions."""
    function = _scan(expression)
    ids = [function.instruction_id(k) for k in range(function.n_instructions())]
    return list(dict.fromkeys(BY_CASADI_ID[k].name for k in ids if k in BY_CASADI_ID))


def constants(expression: Any) -> list[float]:
    """Every number in an SX expression."""
    function = _scan(expression)
    numbers = [k for k in range(function.n_instructions()) if function.instruction_id(k) == ca.OP_CONST]
    return [float(function.instruction_constant(k)) for k in numbers]


def _scan(expression: Any) -> Any:
    return ca.Function("scan", ca.symvar(expression), [expression], {"allow_free": True})
