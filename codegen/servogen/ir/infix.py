"""A value of a program as a formula for comments: m_B * R^2 + I_D."""

from fractions import Fraction

from servogen.ir.program import Instr, Program, live

_SIGN = {"add": (" + ", 1), "sub": (" - ", 1), "mul": (" * ", 2), "div": (" / ", 2)}
_ATOM = 3

Text = tuple[str, int]  # a formula, and how tightly it binds


def infix(program: Program, node: int, longest: int = 80) -> str:
    """The formula of instruction `node`; empty where it would be longer than `longest` characters."""
    sizes = {i.name: i.size for i in program.inputs}
    known: dict[int, Text] = {}
    for k in sorted(live(program, [node])):
        text, binding = _formula(program.instrs[k], known, sizes)
        known[k] = (text[: longest + 1], binding)  # cut, so that shared terms cannot explode
    text = known[node][0]
    return text if len(text) <= longest else ""


def _formula(instr: Instr, known: dict[int, Text], sizes: dict[str, int]) -> Text:
    if isinstance(instr.const, Fraction):
        return f"{float(instr.const):.6g}", _ATOM
    if instr.const is not None:
        name, index = instr.const
        return (name if sizes[name] == 1 else f"{name}[{index}]"), _ATOM
    operands = [known[a] for a in instr.args]
    if instr.op == "mul" and instr.args[0] == instr.args[1]:
        return f"{_bracketed(operands[0], _ATOM)}^2", _ATOM
    if instr.op in _SIGN:
        sign, binding = _SIGN[instr.op]
        right = binding + 1 if instr.op in ("sub", "div") else binding
        return f"{_bracketed(operands[0], binding)}{sign}{_bracketed(operands[1], right)}", binding
    if instr.op == "neg":
        return f"-{_bracketed(operands[0], 2)}", 1
    return f"{instr.op}({', '.join(text for text, _ in operands)})", _ATOM


def _bracketed(operand: Text, binding: int) -> str:
    text, own = operand
    return text if own >= binding else f"({text})"
