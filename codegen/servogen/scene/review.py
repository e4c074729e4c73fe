"""What is odd about a scene as it is written, and yet no error: said when it is built (remarks.py)."""

import casadi as ca

from servogen.errors import SceneError
from servogen.ir.ops import operations
from servogen.scene.constraints import ControlsInvolved, check_hurwitz, decay_of, theta_parts
from servogen.scene.scene import Scene, expressions
from servogen.scene.symbols import chains

_JUMPS = {
    "sign": "sign",
    "floor": "floor",
    "ceil": "ceil",
    "fmod": "fmod",
    "remainder": "remainder",
    "copysign": "copysign",
    "if_else_zero": "if_else",
} | dict.fromkeys(("lt", "le", "eq", "ne", "not", "and", "or"), "a comparison")
"""Operation of the table -> what a user calls it."""


def review(scene: Scene) -> tuple[str, ...]:
    """Remarks, each with the scene's name and the remedy."""
    found = [*_rows_beyond_controls(scene), *_theta_at_defaults(scene), *_jumps(scene), *_unused(scene)]
    return tuple(f"scene {scene.name!r}: {text}" for text in found)


def _rows_beyond_controls(scene: Scene) -> list[str]:
    if scene.rows <= scene.controls or scene.kind == "ideal" or scene.cascaded:
        return []  # of priorities, that is what they are for
    names = ", ".join(repr(c.name) for c in scene.constraints)
    return [
        f"{scene.rows} rows of constraints ({names}) for {scene.controls} controls can never be independent; "
        "the answer will be the least-squares one"
    ]


def _theta_at_defaults(scene: Scene) -> list[str]:
    """A Theta of parameters can only be judged at their defaults."""
    found = []
    symbols = [f.symbol for f in scene.parameters]
    defaults = [ca.DM(f.default) for f in scene.parameters]
    for c in scene.constraints:
        parts = theta_parts(c)
        if all(theta.is_constant() for theta in parts.values()):
            continue
        value = ca.Function("theta", symbols, [decay_of(c)])(*defaults)
        if isinstance(c, ControlsInvolved) and value.is_zero():
            continue
        try:
            check_hurwitz(value, f"constraint {c.name!r}: {' and '.join(parts)} at the parameters' defaults")
        except SceneError as unstable:
            found.append(str(unstable))
    return found


def _jumps(scene: Scene) -> list[str]:
    found = []
    for what, expression in expressions(scene).items():
        names = dict.fromkeys(_JUMPS[op] for op in operations(expression) if op in _JUMPS)
        if "if_else" in names:
            names.pop("a comparison", None)  # its condition
        if names:
            differentiated = what.endswith((": psi", ": phi"))
            cost = "the derivatives taken of it do not see a jump" if differentiated else "the answer jumps with it"
            found.append(
                f"{what} holds {' and '.join(names)}, which may jump: {cost}; write a smooth step, say tanh(x / width)"
            )
    return found


def _unused(scene: Scene) -> list[str]:
    used = {s.__hash__() for e in expressions(scene).values() for s in ca.symvar(e)}
    named = [("parameter", f.name, [f.symbol]) for f in scene.parameters]
    named += [("reference", r.chain[0].name, [f.symbol for f in r.chain]) for r in chains(scene.references)]
    return [
        f"{kind} {name!r} is in no expression; use it, or leave it out"
        for kind, name, symbols in named
        if not any(s.__hash__() in used for symbol in symbols for s in symbol.nonzeros())
    ]
