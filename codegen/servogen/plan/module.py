"""What the planner decides and the printer prints: every name, shape, literal and statement order of one package."""

from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import groupby
from typing import Any, Literal

from servogen.ir.ops import OPS
from servogen.ir.program import Program
from servogen.ir.telling import told_inputs, watched_outputs
from servogen.plan.chunks import Chunks
from servogen.plan.mathematics import Math, Pairs, own_functions
from servogen.plan.solver import SolverPlan
from servogen.scalars import Scalar
from servogen.scene.system import System

SMALL = 60
"""Operations up to which a kernel is inlined wherever it is called."""


@dataclass(frozen=True)
class Target:
    """The number type of the C, the prefix of its names, and where its sin, cos and sqrt come from."""

    scalar: Scalar
    prefix: str
    math: Math = "own"

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

    `guards` is the number of pivots of Q that it hands to its caller for the test of SINGULAR_MASS. `chunks` are the
    pieces of a kernel too long for one function; `pairs` the sines and cosines that one call computes.
    """

    name: str
    program: Program
    results: tuple[Result, ...]
    guards: int = 0
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
class Known:
    """The matrix to solve with does not depend on the state, and its pseudo-inverse is at hand at each tick.

    when "generation": matrix and inverse are exact numbers, row by row. when "prepare": `kernel` computes the matrix
    from the model, and prepare its pseudo-inverse.
    """

    when: Literal["generation", "prepare"]
    matrix: tuple[Fraction, ...] = ()
    inverse: tuple[Fraction, ...] = ()
    status: str = "OK"
    rank: int = 0
    sigma_min: float = 0.0
    kernel: Kernel | None = None


@dataclass(frozen=True)
class Reaction:
    """R = J^T reaction_matrix^+ reaction_right, Eq. (17): what an ideal passive constraint would do."""

    kernel: Kernel
    solver: SolverPlan
    size: int  # n


@dataclass(frozen=True)
class ControlPlan:
    """control, and for controls-involved scenes project and step.

    system: the names. matrix: what the solver gets for system.matrix (S_w where there is a weight).
    y: None, "expression" (from the kernel, by the name `free`) or "input".
    recover: with a weight, per row of L^-T the (place in the kernel's `recover`, column) of its nonzeros.
    known: the matrix does not depend on the state. reaction: the right side is that of ideal control forces.
    projection: the kernel of phi, A and, where phi is not affine in tau, its second derivatives by tau, where project
    and step are asked for. curvature: the (row of phi, i, j <= i) of each of these.
    """

    kernel: Kernel
    system: System
    matrix: str
    y: str | None
    free: str = "y"
    recover: tuple[tuple[tuple[int, int], ...], ...] = ()
    known: Known | None = None
    reaction: Reaction | None = None
    projection: Kernel | None = None
    projection_cap: int = 0
    curvature: tuple[tuple[int, int, int], ...] = ()


@dataclass(frozen=True)
class Prepare:
    """What depends on parameters alone: model fields by `program`, and the pivots of Q that can be judged already."""

    program: Program
    guards: int = 0
    pairs: Pairs = ()


@dataclass(frozen=True)
class Module:
    """One package of C, ready to print."""

    scene: str
    target: Target
    scene_hash: str
    parameters: tuple[StructField, ...]
    model: tuple[StructField, ...]
    inputs: tuple[StructField, ...]
    prepare: Prepare
    kernels: tuple[Kernel, ...]
    entry_points: tuple[EntryPoint, ...]
    control: ControlPlan | None
    solver: SolverPlan | None
    mass_tolerance: float
    skipped: dict[str, tuple[str, ...]] = field(default_factory=dict)

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

    def silent(self, kernel: Kernel) -> tuple[tuple[StructField, int, int], ...]:
        """(input, first, count) of every run of elements that may be NaN or infinite without a result being so."""
        told = told_inputs(kernel.handed_out())
        runs = []
        for f in self.inputs:
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
