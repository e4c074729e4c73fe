"""What the planner decides and the printer prints: every name, shape, literal and statement order of one package."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import groupby
from typing import Any, Literal

from servogen.ir.ops import OPS
from servogen.ir.program import Program
from servogen.ir.telling import told_inputs, watched_outputs
from servogen.law.law import Law
from servogen.law.steps import STATE, SYSTEM, Apply, Cascade, Limit, Solve
from servogen.plan.bounds import BoundPlan
from servogen.plan.cascade import CascadePlan
from servogen.plan.chunks import Chunks
from servogen.plan.mathematics import Math, Pairs, own_functions
from servogen.plan.solver import SolverPlan
from servogen.scalars import Scalar
from servogen.scene.system import System

SMALL = 60
"""Operations up to which a kernel is inlined wherever it is called."""


@dataclass(frozen=True)
class Target:
    """The number type of the C, the prefix of its names, where its sin, cos and sqrt come from, and the core that it
    shares with others, "" where it brings everything itself."""

    scalar: Scalar
    prefix: str
    math: Math = "own"
    core: str = ""

    @property
    def real(self) -> str:
        return "double" if self.scalar == "float64" else "float"


@dataclass(frozen=True)
class StructField:
    """One member of a C struct; `default` is given for parameters and references."""

    name: str
    size: int
    unit: str = ""
    text: str = ""
    default: tuple[float, ...] = ()


@dataclass(frozen=True)
class Result:
    """One output of an entry point: a row-major matrix with the equation it comes from."""

    name: str
    rows: int
    columns: int
    equation: str
    formula: str

    @property
    def size(self) -> int:
        return self.rows * self.columns


@dataclass(frozen=True)
class Kernel:
    """Straight-line code: (model, inputs) -> results, cut from the scene's one program.

    `guards` is the number of pivots that it hands to its caller for the test of SINGULAR_MASS, `joining` how many of
    them, the last, are of the passive constraints, for DEAD_CENTRE. `chunks` are the pieces of a kernel too long for
    one function; `pairs` the sines and cosines that one call computes.
    """

    name: str
    program: Program
    results: tuple[Result, ...]
    guards: int = 0
    joining: int = 0
    chunks: Chunks | None = None
    pairs: Pairs = ()

    def handed_out(self) -> Program:
        """The program with its results as only outputs: not the pivots."""
        results = {r.name for r in self.results}
        return replace(self.program, outputs=tuple(o for o in self.program.outputs if o.name in results))

    def watched(self) -> tuple[Result, ...]:
        """The results to be looked at: where these are finite, all are."""
        names = watched_outputs(self.handed_out())
        return tuple(r for r in self.results if r.name in names)

    @property
    def is_small(self) -> bool:
        """Whether a call, and results that pass through memory, cost as much as it does."""
        return self.chunks is None and self.program.operations()["total"] <= SMALL


@dataclass(frozen=True)
class EntryPoint:
    """A public function that evaluates one kernel and hands out its results."""

    name: str
    kernel: Kernel


@dataclass(frozen=True)
class KnownMatrix:
    """The matrix of the scene's system does not depend on the state, and its pseudo-inverse is at hand at each tick.

    name: of the quantity. when "generation": matrix and inverse are exact numbers, row by row. when "prepare":
    `kernel` computes the matrix from the model, and prepare its pseudo-inverse.
    """

    name: str
    when: Literal["generation", "prepare"]
    matrix: tuple[Fraction, ...] = ()
    inverse: tuple[Fraction, ...] = ()
    status: str = "OK"
    rank: int = 0
    sigma_min: float = 0.0
    kernel: Kernel | None = None


@dataclass(frozen=True)
class Prepare:
    """What depends on parameters alone: model fields by `program`, and the pivots that can be judged already; the last
    `joining` of these are of the passive constraints."""

    program: Program
    guards: int = 0
    joining: int = 0
    pairs: Pairs = ()


@dataclass(frozen=True)
class Module:
    """One package of C, ready to print.

    law: what happens between the kernels. system: the names of what it solves, None where it solves no scene's.
    solvers: the plans of the law's solvers, by name. known_matrix: how the matrix of an Apply is at hand.
    limits: the plan of the law's Limit. cascade: that of its Cascade.
    """

    scene: str
    target: Target
    scene_hash: str
    parameters: tuple[StructField, ...]
    model: tuple[StructField, ...]
    inputs: tuple[StructField, ...]
    prepare: Prepare
    kernels: tuple[Kernel, ...]
    entry_points: tuple[EntryPoint, ...]
    law: Law
    mass_tolerance: float
    system: System | None = None
    solvers: Mapping[str, SolverPlan] = field(default_factory=dict)
    known_matrix: KnownMatrix | None = None
    limits: BoundPlan | None = None
    cascade: CascadePlan | None = None
    skipped: dict[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def solver(self) -> SolverPlan | None:
        """The plan of the solver that `info` is about; of the only one where a package leaves that out."""
        return self.solvers.get(SYSTEM) or next(iter(self.solvers.values()), None)

    def kernel(self, names: Sequence[str]) -> Kernel:
        """The kernel that hands out these quantities. KeyError where there is none."""
        label = "_".join(names)
        for found in self.kernels:
            if found.name == label:
                return found
        raise KeyError(f"no kernel {label!r} in {self.scene}")

    @property
    def control(self) -> Kernel | None:
        """The kernel of the control function; None in a package that has no such function."""
        return self.kernel(self.law.routine("control").evaluated()) if self.law.has("control") else None

    @property
    def free(self) -> Literal["input", "expression"] | None:
        """Where y of the answer comes from in the user's words: weighted, an input is an expression to the solver."""
        answers = [s for s in self.law.steps() if isinstance(s, Solve | Cascade | Apply) and s.solver == SYSTEM]
        if self.system is None or not any(s.free for s in answers):
            return None
        return "input" if any(f.name == "y" for f in self.inputs) else "expression"

    @property
    def joins(self) -> bool:
        """Whether the mechanism has passive constraints, whose pivots are judged."""
        return self.prepare.joining > 0 or any(kernel.joining for kernel in self.kernels)

    @property
    def needs_libm(self) -> bool:
        """Whether anything of <math.h> is called."""
        programs: list[Program] = [self.prepare.program, *(k.program for k in self.kernels)]
        called = any(i.op in OPS and OPS[i.op].needs_libm for p in programs for i in p.instrs)
        return called or self.solver is not None

    @property
    def own_functions(self) -> tuple[str, ...]:
        """What the package brings itself of sqrt, reduce, sin, cos, sincos."""
        code = [(self.prepare.program, self.prepare.pairs), *((k.program, k.pairs) for k in self.kernels)]
        return own_functions(code, self.target.math, self.solver is not None)

    @property
    def looked_at(self) -> tuple[StructField, ...]:
        """The inputs that must be finite: all but limits, whose infinities mean none."""
        limits = {name for s in self.law.steps() if isinstance(s, Limit) for name in (s.lower, s.upper)}
        return tuple(f for f in self.inputs if STATE + f.name not in limits)

    def silent(self, kernel: Kernel) -> tuple[tuple[StructField, int, int], ...]:
        """(input, first, count) of every run of elements that may be NaN or infinite without a result being so."""
        told = told_inputs(kernel.handed_out())
        runs = []
        for f in self.looked_at:
            silent = [(f.name, k) not in told for k in range(f.size)]
            for quiet, places in groupby(range(f.size), silent.__getitem__):
                run = list(places)
                runs += [(f, run[0], len(run))] if quiet else []
        return tuple(runs)

    def context(self) -> dict[str, Any]:
        """What the templates call by name."""
        return {"module": self, "p": self.target.prefix, "P": self.target.prefix.upper(), "real": self.target.real}


def cost_of(operations: dict[str, int]) -> str:
    """Operation counts in words: "20 operations (9 mul, 8 add, 3 cos)"."""
    total = operations["total"]
    return f"{total} operation{'s' if total > 1 else ''} ({mix_of(operations)})" if total else "no operations"


def mix_of(operations: dict[str, int]) -> str:
    """The counts by kind, most first: "9 mul, 8 add, 3 cos"."""
    counted = sorted((item for item in operations.items() if item[0] != "total"), key=lambda item: (-item[1], item[0]))
    return ", ".join(f"{n} {op}" for op, n in counted)
