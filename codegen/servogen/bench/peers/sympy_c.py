"""What SymPy makes of a scene: its common subexpressions and its C printer, as PyDy's code generation does."""

from typing import Any

import casadi as ca

from servogen.bench import user
from servogen.bench.contenders import Call, CContender, keep_states
from servogen.bench.inputs import Inputs
from servogen.bench.results import Output
from servogen.ir.lower import lower_expressions
from servogen.ir.program import Input, Program
from servogen.render.render import SourceFile
from servogen.scene.scene import Scene
from servogen.tools import ToolMissing

MOST_INSTRUCTIONS = 1500
"""Of a scene; SymPy's trees grow with every shared value, and take hours beyond."""


def sympy_c(scene: Scene, inputs: Inputs, capacity: int) -> CContender:
    """The user's S and z: `sympy.cse`, then `sympy.ccode`. ToolMissing where it is not installed or cannot."""
    try:
        import sympy
    except ImportError:
        raise ToolMissing("SymPy is not installed; pip install 'servogen[peers]'") from None
    matrix, right = (user.expressions(scene)[o] for o in (Output.MATRIX, Output.RIGHT))
    arguments = user.arguments(scene)
    fields = [(Input(name, symbol.size1()), symbol) for name, symbol in arguments]
    program = lower_expressions("sympy", fields, [("out", ca.vertcat(ca.vec(matrix.T), right))])
    if len(program.instrs) > MOST_INSTRUCTIONS:
        raise ToolMissing(
            f"SymPy's code is left out: {len(program.instrs)} instructions are beyond what it can expand in minutes"
        )
    entries = _expressions(program, sympy)
    shared, results = sympy.cse(entries)
    lines = [f"    const double {name} = {sympy.ccode(value)};" for name, value in shared]
    lines += [f"    out[{k}] = {sympy.ccode(value)};" for k, value in enumerate(results)]
    names = [name for name, _ in arguments]
    signature = ", ".join([*(f"const double *{name}_" for name in names), "double *out"])
    unused = "\n".join(f"    (void){name}_;" for name in names)
    text = f"#include <math.h>\n\nvoid sympy_system({signature});\n\nvoid sympy_system({signature})\n{{\n"
    text += unused + "\n" + "\n".join(lines) + "\n}\n"
    width = inputs.states.shape[1]
    given = [f"kept_states + {width} * k + {s.start}" for s in inputs.slices.values()] + ["kept_parameters", "out"]
    declarations = f"""{keep_states(inputs, capacity, "double")}
void sympy_system({signature});

static int call_system(long k, double *out)
{{
    sympy_system({", ".join(given)});
    return 0;
}}"""
    calls = {Output.SYSTEM: Call("call_system(k, out)", "sympy_system")}
    return CContender("SymPy cse", "sympy", "float64", False, (SourceFile("sympy.c", text),), declarations, calls)


def _expressions(program: Program, sympy: Any) -> list[Any]:
    """Every output entry as a SymPy expression."""
    binary = {
        "add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b, "div": lambda a, b: a / b,
        "pow": lambda a, b: a**b, "atan2": sympy.atan2,
    }  # fmt: skip
    unary = {"neg": lambda a: -a, "sqrt": sympy.sqrt, "sin": sympy.sin, "cos": sympy.cos, "tan": sympy.tan,
             "exp": sympy.exp, "log": sympy.log, "fabs": sympy.Abs}  # fmt: skip
    values: list[Any] = []
    for instr in program.instrs:
        if isinstance(instr.const, tuple):
            name, k = instr.const
            values.append(sympy.Symbol(f"{name}_[{k}]", real=True))
        elif instr.const is not None:
            values.append(sympy.Float(float(instr.const), 17))
        elif instr.op in unary or instr.op in binary:
            values.append((unary.get(instr.op) or binary[instr.op])(*(values[a] for a in instr.args)))
        else:
            raise ToolMissing(f"SymPy's code is left out: it has no {instr.op}")
    return [values[n] for o in program.outputs for n in o.nodes]
