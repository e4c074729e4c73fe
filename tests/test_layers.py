"""The folders of servogen in layers: no two import each other, not even by way of others."""

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
import servogen

ROOT = Path(servogen.__file__).parent


def test_no_cycle_of_folders() -> None:
    graph: dict[str, set[str]] = {}
    for file in ROOT.rglob("*.py"):
        folder = file.relative_to(ROOT).with_suffix("").parts[0]
        graph.setdefault(folder, set()).update(set(_imports(ast.parse(file.read_text()))) - {folder})
    order = list(TopologicalSorter(graph).static_order())  # CycleError names the cycle
    stages = ["scene", "derive", "survey", "plan", "render", "package", "compiler", "verify"]
    assert stages == sorted(stages, key=order.index)
    assert "optimise" not in graph["derive"]


@pytest.mark.parametrize(
    "text",
    [
        "from servogen.plan.module import Module",
        "import servogen.plan.module",
        "from servogen import plan",
        "def f():\n    from servogen.plan import module",
        "if TYPE_CHECKING:\n    from servogen.plan import module",
    ],
)
def test_an_import_counts_wherever_it_stands(text: str) -> None:
    assert list(_imports(ast.parse(text))) == ["plan"]


def _imports(tree: ast.AST) -> Iterator[str]:
    """Folders (or files beside them) of servogen that are imported anywhere in a file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("servogen"):
            parts = (node.module or "").split(".")
            yield from [parts[1]] if len(parts) > 1 else [name.name for name in node.names]
        elif isinstance(node, ast.Import):
            yield from (a.name.split(".")[1] for a in node.names if a.name.startswith("servogen."))


def test_the_reference_takes_nothing_from_the_code_it_judges() -> None:
    """Not even by way of others: what a scene means comes from scene and derive, every number from textbook."""
    waiting, reached = ["servogen.twins.reference"], set[str]()
    while waiting:
        module = waiting.pop()
        file = ROOT.parent / (module.replace(".", "/") + ".py")
        if module in reached or not file.exists():
            continue
        reached.add(module)
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module:
                waiting += [node.module, *(f"{node.module}.{name.name}" for name in node.names)]
    assert {"servogen.textbook.policy", "servogen.derive.servo"} <= reached
    ours = ("servogen.optimise.", "servogen.plan.", "servogen.render.", "servogen.survey.", "servogen.compiler")
    assert not [module for module in reached if module.startswith(ours)]
