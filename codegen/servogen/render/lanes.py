"""Many states at once: which packages have a way by vectors, and what the templates of `<prefix>_batch` name.

A vector holds one state a lane, and goes the usual way of the scalar code, operation by operation: the same bits. Lanes
for which a test on the way says that the usual way does not do are left to the scalar code.
"""

from dataclasses import replace
from typing import Any

from servogen.ir.ops import OPS
from servogen.ir.program import Instr
from servogen.law.law import Routine
from servogen.law.steps import Evaluate, Multiply, Solve
from servogen.plan.mathematics import OWN_OPS
from servogen.plan.module import Module
from servogen.plan.solver import SolverPlan
from servogen.render.kernels import Printer, printed, printed_pieces

_IN_VECTORS = frozenset({"add", "sub", "mul", "div"})
"""Operations that C has for vectors as for numbers."""


def routine_of(module: Module) -> Routine | None:
    """What `<prefix>_batch` does for many: control of a scene, solve of a solver alone; None where there is neither."""
    return next((module.law.routine(name) for name in ("control", "solve") if module.law.has(name)), None)


def lanes_context(module: Module) -> dict[str, Any]:
    """What batch.c.j2 names beside the names of a package."""
    routine, plan = routine_of(module), module.solver
    assert routine is not None
    assert plan is not None
    of_a_state = bool(module.entry_points)
    steps = [s for s in routine.steps if not isinstance(s, Evaluate)]
    context = {
        "plan": plan,
        "of_a_state": of_a_state,
        "unknown": routine.result,
        "by_lanes": _goes_by_lanes(steps, plan),
        "in_lanes": lambda plan: replace(plan, root=f"{module.target.prefix}_lane_sqrt"),
        "turns": False,
        "parts": (),
    }
    if not (of_a_state and context["by_lanes"]):
        return context
    kernel, solve = module.control, steps[0]
    assert kernel is not None
    assert isinstance(solve, Solve)
    printer = _LanePrinter(kernel.program, module.target.scalar, module.target.prefix, kernel.pairs)
    if kernel.chunks:
        context["parts"], context["entries"] = printed_pieces(printer, kernel.chunks)
    else:
        context["lines"], context["entries"] = printed(printer)
    return context | {
        "kernel": kernel,
        "solve": solve,
        "multiply": next((s for s in steps if isinstance(s, Multiply)), None),
        "turns": any(i.op in ("sin", "cos") for i in kernel.program.instrs),
    }


def _goes_by_lanes(steps: list[Any], plan: SolverPlan) -> bool:
    """A solve of the system, and perhaps a product behind it, by a form whose usual way has no choices."""
    ladder = plan.form == "full" and plan.method == "auto" and plan.tells_bound
    usual = plan.row_range is not None if plan.form == "row" else ladder
    kinds = tuple(type(s) for s in steps)
    return kinds in ((Solve,), (Solve, Multiply)) and plan.wide and plan.damping is None and usual


class _LanePrinter(Printer):
    """The statements of the scalar code on vectors."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.real = f"{self.own}_lanes"
        self.all = f"{self.own.upper()}_ALL"
        self.lane = f"{self.own}_lane"

    def same_for_all(self, text: str) -> str:
        return f"{self.all}({text})"

    def declared(self, name: str, instr: Instr, operands: list[str], paired: bool) -> str:
        if paired:
            return f"const {self.lane}_pair {name} = {self.lane}_sincos({operands[0]}, fits);"
        if instr.op in OWN_OPS:
            more = "" if instr.op == "sqrt" else ", fits"
            return f"const {self.real} {name} = {self.lane}_{instr.op}({operands[0]}{more});"
        row = OPS[instr.op]
        if instr.op in _IN_VECTORS:
            return f"const {self.real} {name} = {row.c.format(*operands)};"
        given = ", ".join(f"x{k} = {text}" for k, text in enumerate(operands))
        real = "double" if self.scalar == "float64" else "float"
        each = row.c.format(*(f"x{k}[lane]" for k in range(len(operands))), f=self.suffix, real=real)
        return (
            f"{self.real} {name}; {{ const {self.real} {given}; int lane; "
            f"for (lane = 0; lane < {self.own.upper()}_LANES; ++lane) {{ {name}[lane] = {each}; }} }}"
        )
