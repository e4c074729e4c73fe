"""Floating-point operations of a solver: what its ladder takes, step by step."""

from servogen.plan.solver import SolverPlan

Operations = dict[str, int]
"""total, add, mul, div and sqrt -> how many."""


def solver_operations(plan: SolverPlan) -> dict[str, Operations]:
    """Floating-point operations of `solve` with y, without info; exact scalings by powers of two left out.

    "closed_form" for one row or column (the usual case, no damping); else one entry a step of the ladder, each with
    what the steps before it spent in vain: "normal", "qr" and "svd", the last with every loop at its cap.
    """
    m, l, n = plan.m, plan.l, plan.count
    with_y = int(l != m)  # at full rank of a square S tau is determined without
    if plan.form == "row":
        rest = _total(add=l, mul=l)
        return {"closed_form": _sum((1, _dot(l)), (with_y, rest), (1, _total(div=1)), (1, _total(with_y * l, l)))}
    residual = _total(add=m * l, mul=m * l)
    if plan.form == "column":  # applied twice: the second is the refinement
        apply = _sum((1, _dot(m)), (1, _total(div=2)), (1, _total(add=1, mul=1)))
        return {"closed_form": _sum((1, _dot(m)), (1, _total(add=4, sqrt=1)), (2, residual), (2, apply))}
    long, stride = plan.width, plan.stride
    gram = _sum((n * (n + 1) // 2, _dot(long)))
    triangle = n * (n - 1) // 2
    cubic = n * (n - 1) * (n - 2) // 6
    factor = _sum((cubic, _total(add=1, mul=1)), (triangle, _total(add=1, mul=2)), (n, _total(div=1)))
    bound = _sum((cubic, _total(add=1, mul=1)), (triangle, _total(add=1, mul=2)), (n, _total(add=1, mul=1)))
    substitute = _sum((2 * triangle, _total(add=1, mul=1)), (n, _total(mul=1)))
    normal = _sum((1, gram), (1, factor), (1, bound), (2, substitute), (2 * n, _total(long, long)), (1, residual))
    normal = _sum((1, normal), (with_y, residual), (1, _total(add=(1 + with_y) * long, mul=long)))
    project = _sum((1, _dot(long)), (1, _total(mul=1)), (1, _total(long, long)), (1, _dot(long)))
    cross = _sum((triangle, _dot(long)))
    qr = _sum((n, _dot(long)), (triangle, project), (n, _total(div=1)), (int(plan.wide), cross))
    apply = _sum((triangle, _total(add=1, mul=1)), (n, _total(mul=1)), (n, _total(long, long)))
    careful = _sum((triangle, _total(add=1, mul=1))) if plan.wide else _sum((n, _total(long, long)))
    certified = _sum(
        (1, qr), (1, bound), (2, apply), (1, careful), (1 + with_y, residual), (1, _total(add=(1 + with_y) * long))
    )
    if n == 2:
        svd = _total(add=9, mul=10, div=10, sqrt=5)
    else:
        rotation = _sum((3, _dot(stride)), (stride, _total(add=4, mul=4)), (1, _total(5, 12, 4, 4)))
        sweep = _sum((triangle, rotation))
        svd = _sum((plan.sweep_cap, sweep), (n, _dot(stride)), (n, _total(sqrt=2)), (n * stride, _total(div=1)))
    unit = _sum((1, _dot(long)), (1, _total(mul=long, div=2, sqrt=1)))
    vectors = _sum((n * n + triangle, _total(long, long)), (triangle, _dot(long)), (n, unit))
    decompose = _sum((1, qr), (1, svd), (1, vectors))
    weigh = _sum(
        (m * n, _total(2 * m, 2 * m)), (n * n, _total(m, m)), (m * n, _total(n, n, 1)), (n, _total(div=1, sqrt=1))
    )
    runs = 1 + (plan.rank == "scaled" and (not plan.wide or plan.damping is not None))
    apply = _sum((n, _total(m + l, m + l + 1)))
    steps = [(runs, decompose), (2, apply), (2, residual), (1, _total(add=3 * l)), (int(plan.rank == "scaled"), weigh)]
    counts = {"svd": _sum(*steps)}
    if plan.method == "auto":
        counts = {
            "normal": normal,
            "qr": _sum((1, normal), (1, certified)),
            "svd": _sum((1, normal), (1, certified), *steps),
        }
    return counts


def known_operations(solver: SolverPlan, free: bool) -> dict[str, Operations]:
    """Floating-point operations of tau = y + S+ (z - S y) with S+ at hand; free: whether there is a y."""
    m, l = solver.m, solver.l
    add, mul = l * (m - 1) + free * (m * l + l), l * m * (1 + free)
    return {"apply": {"total": add + mul, "add": add, "mul": mul, "div": 0, "sqrt": 0}}


def _total(add: int = 0, mul: int = 0, div: int = 0, sqrt: int = 0) -> Operations:
    return {"total": add + mul + div + sqrt, "add": add, "mul": mul, "div": div, "sqrt": sqrt}


def _sum(*terms: tuple[int, Operations]) -> Operations:
    return {key: sum(times * counts[key] for times, counts in terms) for key in terms[0][1]}


def _dot(n: int) -> Operations:
    return _total(add=n - 1, mul=n)
