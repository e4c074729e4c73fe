"""What a stress run found: one row a family, scalar and quantity, each beside its bar."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Any

from servogen.verify.fuzz import Fuzzed
from servogen.verify.stress.bars import BARS, Figure
from servogen.verify.stress.bench import Task


@dataclass(frozen=True)
class StressRow:
    """The largest figure of one quantity over one family. shapes: the largest of each; worst: the task that had it."""

    family: str
    scalar: str
    quantity: str
    bar: float
    largest: float
    shape: str
    systems: int
    passed: bool
    shapes: dict[str, float]
    worst: str


@dataclass(frozen=True)
class StressReport:
    """systems: asked for, per family and scalar."""

    seed: int
    systems: int
    rows: tuple[StressRow, ...]
    fuzzed: tuple[Fuzzed, ...] = field(default=())

    @property
    def passed(self) -> bool:
        return all(row.passed for row in self.rows) and all(one.passed for one in self.fuzzed)

    def to_json(self) -> dict[str, Any]:
        return {
            "seed": self.seed,
            "systems": self.systems,
            "passed": self.passed,
            "rows": [asdict(row) for row in self.rows],
            "fuzzed": [one.to_json() for one in self.fuzzed],
        }


def rows(results: Iterable[tuple[Task, list[Figure]]]) -> tuple[StressRow, ...]:
    """The figures of all tasks, in the order of the tasks."""
    grouped: dict[tuple[str, str, str], list[tuple[Task, Figure]]] = {}
    for task, figures in results:
        for one in figures:
            if one.systems:
                grouped.setdefault((task.family, task.scalar, one.quantity), []).append((task, one))
    return tuple(_row(key, parts) for key, parts in grouped.items())


def _row(key: tuple[str, str, str], parts: list[tuple[Task, Figure]]) -> StressRow:
    family, scalar, quantity = key
    shapes: dict[str, float] = {}
    for task, one in parts:
        shape = f"{task.m}x{task.l}"
        shapes[shape] = max(shapes.get(shape, 0.0), one.largest)
    task, worst = max(parts, key=lambda part: part[1].largest)
    return StressRow(
        family=family,
        scalar=scalar,
        quantity=quantity,
        bar=BARS[quantity],
        largest=worst.largest,
        shape=f"{task.m}x{task.l}",
        systems=sum(one.systems for _, one in parts),
        passed=worst.largest <= BARS[quantity],
        shapes=shapes,
        worst=str(task),
    )
