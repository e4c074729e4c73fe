"""Calls of functions that CasADi leaves standing in an expression, written out."""

from typing import Any

import casadi as ca

from servogen.errors import SceneError

_REMEDIES = {
    "MXFunction": "make it with ca.SX.sym, or without never_inline and of operations that SX has",
    "LinearInterpolant": "write the lookup table as ca.pw_lin(x, grid, values)",
    "BSplineInterpolant": "write the lookup table as ca.pw_lin(x, grid, values), or fit a polynomial to it",
}
"""By the function's class."""


def without_calls(sx: Any, what: str) -> Any:
    """The same with each call (of a function with never_inline, say) replaced by that function's own operations.

    An expression without calls is returned as it is. SceneError for a function that is not made of such operations.
    """
    inputs = ca.symvar(sx)
    scan = ca.Function("scan", inputs, [sx])
    if not any(scan.instruction_id(k) == ca.OP_CALL for k in range(scan.n_instructions())):
        return sx
    (entries,) = _run(scan, [[symbol] for symbol in inputs], what)
    return ca.SX(sx.sparsity(), ca.vertcat(*entries))


def _run(function: Any, arguments: list[list[Any]], what: str) -> list[list[Any]]:
    """The nonzeros of each result of a function of SX, from those of each argument."""
    nodes = function.instructions_sx().elements()
    results: list[list[Any]] = [[None] * function.nnz_out(i) for i in range(function.n_out())]
    value: dict[int, Any] = {}
    for k in range(function.n_instructions()):
        into, out_of, op = function.instruction_output(k), function.instruction_input(k), function.instruction_id(k)
        if op == ca.OP_OUTPUT:
            results[into[0]][into[1]] = value[out_of[0]]
        elif op == ca.OP_INPUT:
            value[into[0]] = arguments[out_of[0]][out_of[1]]
        elif op == ca.OP_CONST:
            value[into[0]] = ca.SX(function.instruction_constant(k))
        elif op == ca.OP_CALL:
            entries = _call(nodes[k].which_function(), [value[slot] for slot in out_of], what)
            value |= {slot: entry for slot, entry in zip(into, entries, strict=True) if slot >= 0}
        else:
            build = ca.SX.unary if len(out_of) == 1 else ca.SX.binary
            value[into[0]] = build(op, *(value[slot] for slot in out_of))
    return results


def _call(function: Any, entries: list[Any], what: str) -> list[Any]:
    """The nonzeros of all results one after the other, from those of all arguments."""
    arguments, taken = [], 0
    for i in range(function.n_in()):
        arguments.append(entries[taken : taken + function.nnz_in(i)])
        taken += function.nnz_in(i)
    kind = function.class_name()
    if kind == "MXFunction":
        function = _expanded(function)
    if function.class_name() != "SXFunction":
        remedy = _REMEDIES.get(kind, "write it in SX operations")
        raise SceneError(f"{what} calls the function {function.name()!r} ({kind}), which is no SX; {remedy}")
    return [entry for result in _run(function, arguments, what) for entry in result]


def _expanded(function: Any) -> Any:
    """A function of MX as one of SX; as it is where that is none, for it has never_inline or operations without SX."""
    try:
        found = function.expand()
    except RuntimeError:
        return function
    itself = (function.name(), function.class_name())
    return function if itself in [(f.name(), f.class_name()) for f in found.find_functions()] else found
