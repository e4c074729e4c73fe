"""Floating-point operations of a solver: what its ladder takes, step by step."""

from servogen.plan.cascade import CascadePlan
from servogen.plan.solver import SolverPlan

Operations = dict[str, int]
"""total, add, mul, div and sqrt -> how many."""


def solver_operations(plan: SolverPlan) -> dict[str, Operations]:
    """Floating-point operations of `solve` with y, without info; exact scalings by powers of two left out.

    "closed_form" for one row or column (the usual case, no damping); else one entry a step of the ladder, each with
    what the steps before it spent in vain: "normal", "qr" and "svd", the last with every loop at its cap. Of
    method "cod": "qr" at full rank, "cod" below.
    """
    if plan.form == "row":
        return {"closed_form": _row(plan)}
    if plan.form == "column":
        return {"closed_form": _column(plan)}
    svd = _svd(plan)
    if plan.method == "svd":
        return {"svd": svd}
    normal, qr = _normal(plan), _qr(plan)
    if plan.method == "cod":
        return {"qr": qr, "cod": _cod(plan)}
    return {"normal": normal, "qr": _sum((1, normal), (1, qr)), "svd": _sum((1, normal), (1, qr), (1, svd))}


def cascade_operations(cascade: CascadePlan, solver: SolverPlan) -> dict[str, Operations]:
    """The same of priorities, where every row gives a direction as long as any is left: "qr", and "svd" with the SVD of
    every level that has two rows, at its cap of sweeps."""
    l, spanned, steps = cascade.l, 0, list[tuple[int, Operations]]()
    turns: list[tuple[int, Operations]] = []
    dot, add = _dot(l), _total(l, l)
    for level in cascade.levels:
        rows = len(level)
        own = min(rows, l - spanned)
        steps.append((rows * (2 if spanned else 1), dot))
        steps.append((2 * rows * spanned, _sum((1, dot), (1, add))))
        for k in range(own):
            steps.append((spanned + k, _sum((1, dot), (1, add))))
            steps.append((1, _sum((1, dot), (1, _total(div=l, sqrt=1)))))
            steps.append((rows - 1 - k, _sum((2, dot), (1, add))))
        steps.append((_triples(own + 1), _total(add=1, mul=1)))
        steps.append((_pairs(own + 1), _total(add=1, mul=1, div=1)))
        steps.append((rows * own, _total(add=1, mul=1)))
        move = _sum((rows, _sum((1, dot), (1, _total(add=1)))), (own, add))
        if rows == own:
            move = _sum((1, move), (_pairs(own), _total(add=1, mul=1)), (own, _total(div=1)))
        else:
            steps += [
                (rows * own, _total(add=1, mul=4)),
                (own, _total(div=1)),
                (_triples(own + 1), _total(add=1, mul=2)),
            ]
            steps += [(rows * _pairs(own), _total(add=2, mul=2)), (rows * _triples(own + 1), _total(add=1, mul=2))]
            move = _sum((1, move), (own * rows, _total(2, 2)), (_pairs(own), _total(add=1, mul=1)))
        steps.append((2, move))
        product, rotation = _total(rows, 2 * rows), _total(4 * (rows + l), 4 * (rows + l))
        turn = _sum((3, product), (1, rotation), (1, _total(add=5, mul=10, div=3, sqrt=2)))
        turns.append((cascade.sweep_cap * _pairs(own), turn))
        spanned += own
    qr = _sum(*steps)
    if not cascade.turns:
        return {"qr": qr}
    svd = _sum((1, qr), *turns)
    return {"svd": svd} if solver.method == "svd" else {"qr": qr, "svd": svd}


def known_operations(solver: SolverPlan, free: bool) -> dict[str, Operations]:
    """Floating-point operations of tau = y + S+ (z - S y) with S+ at hand; free: whether there is a y."""
    m, l = solver.m, solver.l
    add, mul = l * (m - 1) + free * (m * l + l), l * m * (1 + free)
    return {"apply": {"total": add + mul, "add": add, "mul": mul, "div": 0, "sqrt": 0}}


def _row(plan: SolverPlan) -> Operations:
    """tau = y + s^T (z - s y) / (s s^T)."""
    l, with_y = plan.l, _with_y(plan)
    residual = _total(add=l, mul=l)
    return _sum((1, _dot(l)), (with_y, residual), (1, _total(div=1)), (1, _total(with_y * l, l)))


def _column(plan: SolverPlan) -> Operations:
    """A quotient of sums, applied twice: the second is the refinement."""
    m = plan.m
    apply = _sum((1, _dot(m)), (1, _total(div=2)), (1, _total(add=1, mul=1)))
    return _sum((1, _dot(m)), (1, _total(add=4, sqrt=1)), (2, _residual(plan)), (2, apply))


def _normal(plan: SolverPlan) -> Operations:
    """LDL^T of S S^T, its certificate, two substitutions."""
    n, long, with_y = plan.count, plan.width, _with_y(plan)
    gram = _sum((n * (n + 1) // 2, _dot(long)))
    factor = _sum((_triples(n), _total(add=1, mul=1)), (_pairs(n), _total(add=1, mul=2)), (n, _total(div=1)))
    substitute = _sum((2 * _pairs(n), _total(add=1, mul=1)), (n, _total(mul=1)))
    return _sum(
        (1, gram),
        (1, factor),
        (1, _bound(n)),
        (2, substitute),
        (2 * n, _total(long, long)),
        (1 + with_y, _residual(plan)),
        (1, _total(add=(1 + with_y) * long, mul=long)),
    )


def _qr(plan: SolverPlan) -> Operations:
    """Gram-Schmidt with pivots, its certificate, the answer and its refinement."""
    n, long, with_y = plan.count, plan.width, _with_y(plan)
    apply = _sum((_pairs(n), _total(add=1, mul=1)), (n, _total(mul=1)), (n, _total(long, long)))
    careful = _sum((_pairs(n), _total(add=1, mul=1))) if plan.wide else _sum((n, _total(long, long)))
    rest = _total(add=(1 + with_y) * long)
    steps = [(1, _gram_schmidt(plan)), (1, _bound(n)), (2, apply), (1, careful)]
    return _sum(*steps, (1 + with_y, _residual(plan)), (1, rest))


def _svd(plan: SolverPlan) -> Operations:
    """The QR, the SVD of its triangle with all sweeps there may be, and what the answer takes from there."""
    scaled = plan.rank == "scaled"
    decompose = _sum((1, _gram_schmidt(plan)), (1, _jacobi(plan)), (1, _vectors(plan)))
    runs = 1 + (scaled and (not plan.wide or plan.damping is not None))
    return _sum((runs, decompose), (1, _from_factors(plan)), (int(scaled), _weigh(plan)))


def _cod(plan: SolverPlan) -> Operations:
    """The QR, its pivots made orthonormal once more, and for a tall S the other side too."""
    n = plan.count
    unit = _sum((_pairs(n), _sum((2, _dot(plan.width)), (1, _total(plan.width, plan.width)))), (n, _dot(plan.width)))
    other = _sum((2 * _pairs(n), _sum((1, _dot(n)), (1, _total(n + 1, n)))), (n, _dot(n)), (n, _total(n, n, n, 1)))
    join = _sum((_pairs(n) + n, _total(plan.width, plan.width)))
    runs = 1 + (not plan.wide and plan.rank == "scaled")
    return _sum(
        (runs, _gram_schmidt(plan)),
        (1, unit),
        (n, _total(div=plan.width, sqrt=1)),
        (int(not plan.wide), _sum((1, other), (1, join))),
        (1, _weigh(plan)),
        (1, _from_factors(plan)),
    )


def _weigh(plan: SolverPlan) -> Operations:
    """The inverse of a tall triangle by reflections."""
    m, n = plan.m, plan.count
    return _sum(
        (m * n, _total(2 * m, 2 * m)), (n * n, _total(m, m)), (m * n, _total(n, n, 1)), (n, _total(div=1, sqrt=1))
    )


def _from_factors(plan: SolverPlan) -> Operations:
    """The answer and its refinement, from factors of both sides."""
    apply = _sum((plan.count, _total(plan.m + plan.l, plan.m + plan.l + 1)))
    return _sum((2, apply), (2, _residual(plan)), (1, _total(add=3 * plan.l)))


def _gram_schmidt(plan: SolverPlan) -> Operations:
    n, long = plan.count, plan.width
    project = _sum((1, _dot(long)), (1, _total(mul=1)), (1, _total(long, long)), (1, _dot(long)))
    cross = _sum((_pairs(n), _dot(long)))
    return _sum((n, _dot(long)), (_pairs(n), project), (n, _total(div=1)), (int(plan.wide), cross))


def _jacobi(plan: SolverPlan) -> Operations:
    n, stride = plan.count, plan.stride
    if n == 2:
        return _total(add=9, mul=10, div=10, sqrt=5)
    rotation = _sum((3, _dot(stride)), (stride, _total(add=4, mul=4)), (1, _total(5, 12, 4, 4)))
    sweep = _sum((_pairs(n), rotation))
    return _sum((plan.sweep_cap, sweep), (n, _dot(stride)), (n, _total(sqrt=2)), (n * stride, _total(div=1)))


def _vectors(plan: SolverPlan) -> Operations:
    n, long = plan.count, plan.width
    unit = _sum((1, _dot(long)), (1, _total(mul=long, div=2, sqrt=1)))
    return _sum((n * n + _pairs(n), _total(long, long)), (_pairs(n), _dot(long)), (n, unit))


def _bound(n: int) -> Operations:
    """Of ||M(R)^-1||_F, the certificate of both steps."""
    return _sum((_triples(n), _total(add=1, mul=1)), (_pairs(n), _total(add=1, mul=2)), (n, _total(add=1, mul=1)))


def _residual(plan: SolverPlan) -> Operations:
    return _total(add=plan.m * plan.l, mul=plan.m * plan.l)


def _with_y(plan: SolverPlan) -> int:
    """Whether y is read: at full rank of a square S tau is determined without."""
    return int(plan.l != plan.m)


def _pairs(n: int) -> int:
    return n * (n - 1) // 2


def _triples(n: int) -> int:
    return n * (n - 1) * (n - 2) // 6


def _total(add: int = 0, mul: int = 0, div: int = 0, sqrt: int = 0) -> Operations:
    return {"total": add + mul + div + sqrt, "add": add, "mul": mul, "div": div, "sqrt": sqrt}


def _sum(*terms: tuple[int, Operations]) -> Operations:
    return {key: sum(times * counts[key] for times, counts in terms) for key in terms[0][1]}


def _dot(n: int) -> Operations:
    return _total(add=n - 1, mul=n)
