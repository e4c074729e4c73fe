"""The law of a scene: what happens between the kernels, as routines of steps; it prints, reads back and is checked."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

from servogen.law.steps import (
    STATE,
    STEPS,
    Advance,
    Apply,
    Call,
    Cascade,
    Evaluate,
    Invert,
    Limit,
    Pattern,
    Project,
    React,
    Shape,
    ShapeError,
    Solve,
    Step,
    handed_out,
    row_of,
)

_DECLARED = ("inputs", "quantities", "solvers")

Form = Literal["step", "limited", "evaluation", "tick"]
"""What a routine may be, for these are what C is printed for: one step; a solve and its limits; an evaluation and steps
on what it leaves, one of which is a solve that fills info (without info, one quiet step alone); a call, an input
advanced along its answer, and a call there."""


@dataclass(frozen=True)
class Routine:
    """A function of the state: arguments besides it, steps in order, and the name of its result.

    Its status is the greatest of its steps'; the first negative one ends it with its outputs untouched.
    info: whether it tells rank, margin and residual of the scene's own system.
    """

    name: str
    steps: tuple[Step, ...]
    result: str
    arguments: tuple[tuple[str, Shape], ...] = ()
    info: bool = True

    @property
    def form(self) -> Form | None:
        """How its C is put together; None where there is no C for its steps."""
        words = [row_of(step).places for step in self.steps]
        if len(words) == 1 and "alone" in words[0]:
            return "step" if self.info else None
        if self.info and len(self.steps) == 2 and "alone" in words[0] and "limiting" in words[1]:
            return "limited"
        if words and "first" in words[0]:
            return "evaluation" if _prints(self.steps[1:], self.info) else None
        return "tick" if self._is_tick() else None

    def _is_tick(self) -> bool:
        if not self.info or len(self.steps) != 3:
            return False
        first, advance, last = self.steps
        if not (isinstance(first, Call) and isinstance(advance, Advance) and isinstance(last, Call)):
            return False
        moved = (advance.of.removeprefix(STATE), advance.into)
        return first.moved is None and advance.of.startswith(STATE) and last.moved == moved and last.into == self.result

    def evaluated(self) -> tuple[str, ...]:
        """The quantities that its kernel hands out."""
        return next((s.into for s in self.steps if isinstance(s, Evaluate)), ())


@dataclass(frozen=True)
class Law:
    """inputs: what its steps read of the state themselves; quantities: what kernels hand out; solvers: their shapes.

    entries: functions that hand out quantities and do nothing else, each by the names of these. A law without routines
    belongs to a package that computes quantities alone, one without entries to a solver alone.
    """

    name: str
    inputs: tuple[tuple[str, Shape], ...] = ()
    quantities: tuple[tuple[str, Shape], ...] = ()
    solvers: tuple[tuple[str, Shape], ...] = ()
    entries: tuple[tuple[str, ...], ...] = ()
    routines: tuple[Routine, ...] = ()

    def routine(self, name: str) -> Routine:
        """The routine of that name. KeyError where there is none."""
        for found in self.routines:
            if found.name == name:
                return found
        raise KeyError(f"law {self.name} has no routine {name!r}")

    def has(self, name: str) -> bool:
        """Whether there is a routine of that name."""
        return any(r.name == name for r in self.routines)

    def steps(self) -> Iterator[Step]:
        """All steps, routine by routine."""
        for routine in self.routines:
            yield from routine.steps

    def advanced(self) -> tuple[str, ...]:
        """The inputs that steps move along their rates: what a controller carries from tick to tick."""
        return tuple(dict.fromkeys(s.of.removeprefix(STATE) for s in self.steps() if isinstance(s, Advance)))

    def matrix_of(self, solver: str) -> str:
        """The name of the quantity that a solver is given. KeyError where none of its steps names one."""
        for step in self.steps():
            if isinstance(step, Solve | Cascade | Apply | React) and step.solver == solver:
                return step.matrix
        raise KeyError(f"law {self.name} gives no matrix to the solver {solver!r}")

    def __str__(self) -> str:
        lines = [f"law {self.name}"]
        for kind in _DECLARED:
            lines += [f"{kind} {name} {rows}x{columns}" for name, (rows, columns) in getattr(self, kind)]
        lines += [f"entries {' '.join(names)}" for names in self.entries]
        for r in self.routines:
            arguments = " ".join(f"{name}[{rows}x{columns}]" for name, (rows, columns) in r.arguments)
            lines.append(f"routine {r.name}({arguments}) -> {r.result}{'' if r.info else ' without info'}")
            lines += [f"  {_printed(step)}" for step in r.steps]
        return "\n".join(lines) + "\n"


class IllegalLawError(AssertionError):
    """A stage broke the law: a defect of servogen, not of the scene."""


def check_legal(law: Law) -> Law:
    """Return `law`; IllegalLawError naming the first routine and step that are not in order."""
    declared = {kind: [name for name, _ in getattr(law, kind)] for kind in _DECLARED}
    for kind, names in (declared | {"routines": [r.name for r in law.routines]}).items():
        if len(set(names)) != len(names):
            raise IllegalLawError(f"law {law.name}: two {kind} share a name")
    for name in (n for names in law.entries for n in names if n not in declared["quantities"]):
        raise IllegalLawError(f"law {law.name}: an entry hands out {name}, which is no quantity")
    shapes(law)
    _check_forms(law)
    return law


def _check_forms(law: Law) -> None:
    """IllegalLawError naming the first routine whose C cannot be printed."""
    for routine in law.routines:
        place = f"law {law.name}, {routine.name}: {', '.join(row_of(step).word for step in routine.steps) or 'no step'}"
        if routine.form is None:
            without = "" if routine.info else " without info"
            raise IllegalLawError(
                f"{place}{without} cannot be printed; a routine is one step of its own, or a solve and its limits, or "
                "an evaluation with one solve and steps like multiply behind it, or a call, an advance and a call"
            )
        given = {name for name, _ in routine.arguments}
        if routine.form == "step" and not of_the_state(routine):
            for name in (n for step in routine.steps for n in row_of(step).reads(step) if n not in given):
                raise IllegalLawError(f"{place} cannot be printed: it takes no state, and {name} is no argument")
    for word in sorted({row_of(step).word for step in law.steps() if isinstance(step, React | Project)}):
        if len({step for step in law.steps() if row_of(step).word == word}) > 1:
            raise IllegalLawError(f"law {law.name} has two different steps {word}, whose functions in C share names")


def _prints(behind: tuple[Step, ...], info: bool) -> bool:
    """Whether there is C for these steps behind an evaluation: its status would be lost with a second solve."""
    places = [row_of(step).places for step in behind]
    if not info:
        return len(places) == 1 and "quiet" in places[0]
    solves = sum(isinstance(step, Solve | Cascade | Apply) for step in behind)
    return solves == 1 and all("behind" in place for place in places)


def shapes(law: Law) -> dict[str, Shape]:
    """The shape of every name: inputs with STATE before them, quantities, arguments, what steps leave, "routine()".

    IllegalLawError where a step reads what is not there, does not fit, or leaves a name again; a name that two routines
    leave has one shape.
    """
    quantities, solvers = dict(law.quantities), dict(law.solvers)
    given = {STATE + name: shape for name, shape in law.inputs}
    everything, results = quantities | given, dict[str, Shape]()
    for routine in law.routines:
        known, own = given | dict(routine.arguments) | results, dict[str, Shape]()
        for k, step in enumerate(routine.steps):
            place = f"law {law.name}, {routine.name}, step {k}: {row_of(step).word}"
            for name, shape in _written(step, known | own, quantities, solvers, place).items():
                if name in known or name in own:
                    raise IllegalLawError(f"{place} leaves {name} a second time")
                if everything.get(name, shape) != shape:
                    raise IllegalLawError(f"{place} leaves {name} of {shape}, which is {everything[name]} elsewhere")
                own[name] = shape
        if routine.result not in own:
            raise IllegalLawError(f"law {law.name}, {routine.name}: no step leaves its result {routine.result}")
        results[f"{routine.name}()"] = own[routine.result]
        everything |= dict(routine.arguments) | own
    return everything | results


def offered(law: Law) -> tuple[str, ...]:
    """The names of everything that a package with this law can be asked for: entries, then routines."""
    return (*("_".join(names) for names in law.entries), *(r.name for r in law.routines))


def restricted(law: Law, names: Collection[str]) -> Law:
    """The law with those entries and routines, the routines that these call, and the solvers that they use."""
    asked = set(names)
    for routine in reversed(law.routines):
        if routine.name in asked:
            asked |= {step.routine for step in routine.steps if isinstance(step, Call)}
    routines = tuple(r for r in law.routines if r.name in asked)
    read = {name for r in routines for step in r.steps for name in row_of(step).reads(step)}
    working = {step.solver for r in routines for step in r.steps if isinstance(step, _Solving)}
    return replace(
        law,
        inputs=tuple((name, shape) for name, shape in law.inputs if STATE + name in read),
        solvers=tuple((name, shape) for name, shape in law.solvers if name in working),
        entries=tuple(names for names in law.entries if "_".join(names) in asked),
        routines=routines,
    )


_Solving = Solve | Cascade | Apply | React | Limit | Invert | Project


def of_the_state(routine: Routine) -> bool:
    """Whether it takes the model and the state; else matrices that the caller gives."""
    return any(isinstance(step, Evaluate | Project | Call) for step in routine.steps)


def _written(
    step: Step, known: dict[str, Shape], quantities: dict[str, Shape], solvers: dict[str, Shape], place: str
) -> dict[str, Shape]:
    """Names and shapes of what a step leaves; IllegalLawError where it reads what is not there or does not fit."""
    row = row_of(step)
    for name in handed_out(step) if isinstance(step, Evaluate | Project) else ():
        if name not in quantities:
            raise IllegalLawError(f"{place} asks for {name}, which is no quantity")
    if isinstance(step, Evaluate):
        return {name: quantities[name] for name in step.into}
    for name in row.reads(step):
        if name not in known:
            raise IllegalLawError(f"{place} reads {name} before any step leaves it")
    # a matrix at hand is no step's, and a projection evaluates its quantities itself
    seen = quantities | known
    try:
        shape = row.shape(step, seen)
    except KeyError as missing:
        raise IllegalLawError(f"{place} needs {missing.args[0]}, which is not there") from None
    except ShapeError as problem:
        raise IllegalLawError(f"{place} does not fit: {problem}") from None
    if isinstance(step, _Solving) and solvers.get(step.solver) != seen[step.matrix]:
        takes = solvers.get(step.solver)
        raise IllegalLawError(f"{place}: {step.matrix} is {seen[step.matrix]}, its solver {step.solver} takes {takes}")
    return {step.into: shape}


def _printed(step: Step) -> str:
    """into = word, then fields by position; what is left out by default is left out."""
    if isinstance(step, Evaluate):
        return f"{' '.join(step.into)} = evaluate"
    words = [f"{step.into} = {row_of(step).word}"]
    for f in fields(step):
        value = getattr(step, f.name)
        if f.name != "into" and value not in ("", (), None):
            words.append(f"{f.name}={_text(f.name, value)}")
    return " ".join(words)


def _text(name: str, value: Any) -> str:
    if name == "pattern":
        return ";".join(",".join(f"{e}:{j}" for e, j in row) for row in value)
    if name in ("places", "levels"):
        return ";".join(":".join(str(x) for x in place) for place in value)
    if name == "switches":
        return ";".join(":".join((switch, *map(str, rows))) for switch, rows in value)
    if name in ("moved", "no_lower", "no_upper"):
        return ":".join(str(x) for x in value)
    return str(value)


def _value(name: str, text: str) -> Any:
    if name == "pattern":
        pattern: Pattern = tuple(
            tuple((int(pair.split(":")[0]), int(pair.split(":")[1])) for pair in row.split(",") if pair)
            for row in text.split(";")
        )
        return pattern
    if name in ("places", "levels"):
        return tuple(tuple(int(x) for x in place.split(":")) for place in text.split(";"))
    if name == "switches":
        parts = (part.split(":") for part in text.split(";"))
        return tuple((switch, tuple(map(int, rows))) for switch, *rows in parts)
    if name == "moved":
        return tuple(text.split(":"))
    if name in ("no_lower", "no_upper"):
        return tuple(int(x) for x in text.split(":"))
    return int(text) if name == "cap" else text


_TYPES = {row.word: kind for kind, row in STEPS.items()}


def _read_step(line: str) -> Step:
    into, _, rest = line.partition(" = ")
    word, *words = rest.split()
    if word == "evaluate":
        return Evaluate(tuple(into.split()))
    named = (text.partition("=") for text in words)
    step: Step = _TYPES[word](into=into, **{name: _value(name, text) for name, _, text in named})
    return step


def parse(text: str) -> Law:
    """The law that prints as `text`."""
    law = Law("")
    for line in text.splitlines():
        word, _, rest = line.partition(" ")
        if line.startswith("  "):
            last = law.routines[-1]
            routine = replace(last, steps=(*last.steps, _read_step(line.strip())))
            law = replace(law, routines=(*law.routines[:-1], routine))
        elif word == "law":
            law = replace(law, name=rest)
        elif word == "routine":
            name, _, rest = rest.partition("(")
            arguments, _, result = rest.partition(") -> ")
            info = not result.endswith(" without info")
            shapes = tuple(_read_shape(a[:-1].replace("[", " ")) for a in arguments.split())
            routine = Routine(name, (), result.removesuffix(" without info"), shapes, info)
            law = replace(law, routines=(*law.routines, routine))
        elif word == "entries":
            law = replace(law, entries=(*law.entries, tuple(rest.split())))
        else:
            declared: Any = {word: (*getattr(law, word), _read_shape(rest))}
            law = replace(law, **declared)
    return law


def _read_shape(text: str) -> tuple[str, Shape]:
    name, shape = text.split()
    rows, columns = shape.split("x")
    return name, (int(rows), int(columns))
