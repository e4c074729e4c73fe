"""The variables of a unit: what modelDescription.xml says of each, and where it lies in the C."""

from dataclasses import dataclass
from typing import Literal

from servogen.package import Package
from servogen.plan.module import StructField
from servogen.render.literals import literal
from servogen.results import Path

Settable = Literal["ALWAYS", "BEFORE_STEPS", "NEVER"]

C_TYPES = {"Float64": "double", "Float32": "float", "Int32": "int32_t", "Int64": "int64_t"}
"""FMI's types that a unit's variables can have; Int64 is that of an enumeration's items."""


@dataclass(frozen=True)
class Variable:
    """One variable. pointer: in C, to its first entry in unit_state *s. start: entries, none of what is computed."""

    reference: int
    name: str
    type: str
    size: int
    causality: str
    variability: str
    pointer: str
    text: str = ""
    unit: str = ""
    initial: str = ""
    start: tuple[float, ...] = ()
    enumeration: str = ""

    @property
    def c_type(self) -> str:
        return C_TYPES[self.type]

    @property
    def settable(self) -> Settable:
        """Inputs and tunable parameters at any time; what has a start before the first step; the rest never."""
        if self.causality == "input" or self.variability == "tunable":
            return "ALWAYS"
        return "BEFORE_STEPS" if self.start else "NEVER"

    @property
    def literals(self) -> tuple[str, ...]:
        if self.type.startswith("Float"):
            return tuple(literal(x, "float64" if self.type == "Float64" else "float32") for x in self.start)
        return tuple(str(int(x)) for x in self.start)

    @property
    def start_text(self) -> str:
        """The numbers of `start` as XML has them: no C suffix."""
        return " ".join(text.rstrip("f") for text in self.literals)


class Variables:
    """Collects variables and numbers them."""

    def __init__(self, scalar: str) -> None:
        self.real = "Float64" if scalar == "float64" else "Float32"
        self.all: list[Variable] = [
            Variable(0, "t", "Float64", 1, "independent", "continuous", "&s->t", "time", "s"),
        ]

    def add(
        self, name: str, type: str, size: int, causality: str, variability: str, pointer: str, text: str, **more: object
    ) -> None:
        self.all.append(Variable(len(self.all), name, type, size, causality, variability, pointer, text, **more))  # type: ignore[arg-type]


def interface(
    package: Package, starts: dict[str, tuple[float, ...]], parameters: dict[str, tuple[float, ...]]
) -> Variables:
    """Time, the parameters, and the inputs that come from outside: not t, and not what the unit keeps itself."""
    module = package.module
    found = Variables(module.target.scalar)
    for f in module.parameters:
        found.add(
            f.name,
            found.real,
            f.size,
            "parameter",
            "tunable",
            _member("params", f),
            f.text,
            unit=f.unit,
            initial="exact",
            start=parameters[f.name],
        )
    for f in module.inputs:
        if f.name in starts:
            _add_input(found, f, starts[f.name])
    return found


def _member(struct: str, f: StructField) -> str:
    """A scalar is no array in the package's structs."""
    return f"{'&' if f.size == 1 else ''}s->{struct}.{f.name}"


def _add_input(found: Variables, f: StructField, start: tuple[float, ...]) -> None:
    found.add(f.name, found.real, f.size, "input", "continuous", _member("in", f), f.text, unit=f.unit, start=start)


def add_controller(
    found: Variables, controls: int, constraint: str, rows: int, first: tuple[float, ...] | None, said: str
) -> None:
    """tau, what is known of it, and when it is computed.

    first: tau at the start, where the unit integrates it. said: the statuses there are.
    """
    if first is not None:
        found.add(
            "start.tau",
            found.real,
            controls,
            "parameter",
            "fixed",
            "s->first",
            f"the controls at the start, before the nearest with {constraint} = 0 is taken",
            initial="exact",
            start=first,
        )
    found.add(
        "settings.hold",
        "Float64",
        1,
        "parameter",
        "fixed",
        "&s->hold",
        "seconds between two ticks; 0: a tick at each communication point",
        unit="s",
        initial="exact",
        start=(0.0,),
    )

    def at_tick(name: str, type_: str, size: int, field: str, text: str) -> None:
        found.add(name, type_, size, "output", "discrete", field, text, initial="calculated")

    at_tick("tau", found.real, controls, "s->tau", "the controls, computed at the step's start and held")
    at_tick(f"info.{constraint}", found.real, rows, f"s->{constraint}", f"{constraint} at the last tick")
    paths = ", ".join(f"{int(p)} {p.name}" for p in Path)
    for name, text in (
        ("status", f"of the last tick: {said}; where it is negative tau stays as it was"),
        ("path", f"how the answer was found: {paths}"),
        ("rank", "singular values that count as nonzero"),
        ("sweeps", "of the longest Jacobi iteration"),
    ):
        at_tick(f"info.{name}", "Int32", 1, f"&s->info.{name}", text)
    for name, text in (
        ("sigma_min", "the smallest singular value; where no SVD was needed, a lower bound of it"),
        ("residual", "2-norm of what is left of the equations"),
    ):
        at_tick(f"info.{name}", found.real, 1, f"&s->info.{name}", text)


def add_plant(
    found: Variables, q: tuple[float, ...], u: tuple[float, ...], methods: tuple[str, ...], method: str, substeps: int
) -> None:
    """The state, which is the output, and how it is integrated."""
    found.add(
        "settings.substeps",
        "Int32",
        1,
        "parameter",
        "fixed",
        "&s->substeps",
        "steps of the integrator in a communication step, at least 1",
        initial="exact",
        start=(substeps,),
    )
    found.add(
        "settings.method",
        "Int64",
        1,
        "parameter",
        "fixed",
        "&s->method",
        "the integrator",
        initial="exact",
        start=(methods.index(method),),
        enumeration="Method",
    )
    state = {"initial": "exact"}
    found.add("q", found.real, len(q), "output", "continuous", "s->x", "configuration", start=q, **state)
    found.add(
        "u", found.real, len(u), "output", "continuous", f"s->x + {len(q)}", "velocity parameters", start=u, **state
    )
