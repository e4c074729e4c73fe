"""Budgets: the accepted costs of scenes on boards, in a budget.toml beside the scene.

    [double_pendulum_energy.cortex-m4.float32]
    flash = 3000                           # bytes of the package's code and constants
    stack = 300                            # bytes, the deepest entry point
    instructions = { control = 1300 }      # the worst call seen

A figure more than SLACK above its budget fails; a figure without a budget is free. `servogen certify` names what has
no entry, and writes the measured figures with --accept.
"""

import tomllib
from pathlib import Path
from typing import Any

from servogen.errors import SceneError
from servogen.verify.board_certificate import BoardCertificate

SLACK = 0.03
FILE = "budget.toml"


def read(path: Path) -> dict[str, Any]:
    """All budgets of a file; none if it does not exist. SceneError where it is not TOML."""
    if not path.is_file():
        return {}
    try:
        return tomllib.loads(path.read_text())
    except tomllib.TOMLDecodeError as problem:
        raise SceneError(f"{path}: {problem}") from problem


def figures(certificate: BoardCertificate) -> dict[str, Any]:
    """What a budget can limit."""
    return {
        "flash": certificate.flash,
        "stack": certificate.stack,
        "instructions": {e.name: e.instructions for e in certificate.entries},
    }


def name_of(certificate: BoardCertificate) -> str:
    """The header of its table: scene.board.scalar."""
    return f"{certificate.scene}.{certificate.target}.{certificate.scalar}"


def limits_of(certificate: BoardCertificate, budgets: dict[str, Any]) -> dict[str, Any]:
    """What the budgets limit of it; nothing where they have no entry."""
    limits: dict[str, Any] = budgets.get(certificate.scene, {}).get(certificate.target, {}).get(certificate.scalar, {})
    return limits


def exceeded(certificate: BoardCertificate, budgets: dict[str, Any]) -> list[str]:
    """What is more than SLACK above its budget; a limit on something that was not measured, too."""
    where = name_of(certificate)
    measured = _flat(figures(certificate))
    problems = []
    for name, limit in _flat(limits_of(certificate, budgets)).items():
        value = measured.get(name)
        if value is None:
            problems.append(f"{where}.{name}: there is a budget, and nothing of that name was measured")
        elif value > limit * (1 + SLACK):
            problems.append(f"{where}.{name}: {value}, {value / limit - 1:+.1%} of the budget {limit}")
    return problems


def accept(path: Path, certificates: list[BoardCertificate]) -> None:
    """Write the measured figures into the file; budgets of other scenes and boards stay."""
    budgets = read(path)
    for c in certificates:
        budgets.setdefault(c.scene, {}).setdefault(c.target, {})[c.scalar] = figures(c)
    lines = ["# Accepted costs, written by `servogen certify --accept`: bytes of flash and stack, instructions a call."]
    for scene in sorted(budgets):
        for target in sorted(budgets[scene]):
            for scalar, limits in sorted(budgets[scene][target].items()):
                lines += ["", f"[{scene}.{target}.{scalar}]"]
                lines += [f"{key} = {_toml(value)}" for key, value in limits.items()]
    try:
        path.write_text("\n".join(lines) + "\n")
    except PermissionError as error:
        raise SceneError(f"{path}: {error.strerror}; name a file that you may write with --budget") from error


def _flat(limits: dict[str, Any]) -> dict[str, int]:
    """flash, stack, instructions.control, ..."""
    found: dict[str, int] = {}
    for key, value in limits.items():
        found |= {f"{key}.{k}": v for k, v in value.items()} if isinstance(value, dict) else {key: value}
    return found


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {v}" for k, v in value.items()) + " }"
    return str(value)
