"""The folders of servogen in layers: no two import each other, not even by way of others."""

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import servogen

ROOT = Path(servogen.__file__).parent


def test_no_cycle_of_folders() -> None:
    graph: dict[str, set[str]] = {}
    for file in ROOT.rglob("*.py"):
        folder = file.relative_to(ROOT).with_suffix("").parts[0]
        graph.setdefault(folder, set()).update(set(_imports(ast.parse(file.read_text()))) - {folder})
    order = list(TopologicalSorter(graph).static_order())  # CycleError names the cycle
    assert order.index("scene") < order.index("derive") < order.index("plan") < order.index("render")


def _imports(tree: ast.AST) -> Iterator[str]:
    """Folders (or files beside them) of servogen imported when a file is; imports inside functions come later."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("servogen"):
            parts = (node.module or "").split(".")
            yield from [parts[1]] if len(parts) > 1 else [name.name for name in node.names]
        elif isinstance(node, ast.Import):
            yield from (a.name.split(".")[1] for a in node.names if a.name.startswith("servogen."))
