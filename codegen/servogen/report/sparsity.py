"""Where a matrix is zero, a number, a value of parameters or a function of the state: a small picture in SVG."""

from collections.abc import Sequence
from html import escape
from typing import Literal

from servogen.ir.binding import depends_on_parameters_alone, is_constant
from servogen.ir.program import Program

Reach = Literal["zero", "number", "parameters", "state"]

COLOURS: dict[Reach, str] = {"zero": "#ffffff", "number": "#cfdbe6", "parameters": "#8aa9c4", "state": "#2f5578"}
WORDS: dict[Reach, str] = {
    "zero": "identically zero",
    "number": "a number",
    "parameters": "of parameters alone",
    "state": "of the state",
}
_CELL = 18


def kinds(program: Program, name: str) -> list[list[Reach]]:
    """What each entry of an output is."""
    output = program.output(name)
    early = depends_on_parameters_alone(program)

    def kind(k: int) -> Reach:
        if is_constant(program, k):
            return "zero" if program.instrs[k].const == 0 else "number"
        return "parameters" if early[k] else "state"

    flat = [kind(k) for k in output.nodes]
    return [flat[k : k + output.columns] for k in range(0, len(flat), output.columns)]


def picture(name: str, rows: Sequence[Sequence[Reach]]) -> str:
    """An SVG element; each cell says what it is to whoever points at it."""
    width, height = _CELL * len(rows[0]) + 2, _CELL * len(rows) + 2
    cells = [
        f'<rect x="{_CELL * j + 1}" y="{_CELL * i + 1}" width="{_CELL}" height="{_CELL}" fill="{COLOURS[kind]}" '
        f'stroke="#9aa6b2"><title>{escape(name)}[{i}][{j}]: {WORDS[kind]}</title></rect>'
        for i, row in enumerate(rows)
        for j, kind in enumerate(row)
    ]
    label = f"{name}, {len(rows)} rows and {len(rows[0])} columns"
    return f'<svg width="{width}" height="{height}" role="img" aria-label="{escape(label)}">{"".join(cells)}</svg>'
