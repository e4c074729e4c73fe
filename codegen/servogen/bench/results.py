"""What a bench says: frozen records, one Measurement a contender and output."""

import math
from dataclasses import dataclass
from enum import StrEnum

from servogen.scalars import Scalar
from servogen.scene.system import System


class Output(StrEnum):
    """What is timed and judged: the matrix, the right side, the two at once, and the answer of the system.

    The matrix G of ideal control forces is the user's own: it is not judged.
    """

    MATRIX = "matrix"
    RIGHT = "right"
    SYSTEM = "system"
    ANSWER = "answer"


def labels(system: System) -> dict[Output, str]:
    """What is judged of a system, by the paper's names: not a matrix that the user gave."""
    own = {Output.MATRIX: system.matrix, Output.RIGHT: system.right, Output.SYSTEM: f"{system.matrix}, {system.right}"}
    judged = {Output.RIGHT: system.right} if system.matrix_is_given else own
    return {**judged, Output.ANSWER: system.symbol}


@dataclass(frozen=True)
class Times:
    """Nanoseconds per call: median, best and 99.9th percentile over `batches` batches of calls.

    ratio: to the baseline's time in the same round, the median over the rounds; below 1 is faster.
    """

    median: float
    best: float
    p999: float
    batches: int
    ratio: float


@dataclass(frozen=True)
class Errors:
    """Against the 50-digit truth over `judged` states; of each state the worst entry, infinite where it is not finite.

    largest, median: absolute, in the output's unit. scale: the output's largest magnitude over the states.
    epsilon: of the contender's number type. nonfinite: states with a NaN or an infinity, or without an answer.
    """

    largest: float
    median: float
    scale: float
    epsilon: float
    judged: int
    nonfinite: int

    @property
    def largest_ulps(self) -> float:
        """In units of epsilon times scale."""
        return _over(self.largest, self.epsilon * self.scale)

    @property
    def median_ulps(self) -> float:
        return _over(self.median, self.epsilon * self.scale)

    @property
    def largest_relative(self) -> float:
        """In units of scale."""
        return _over(self.largest, self.scale)


def _over(value: float, unit: float) -> float:
    return value / unit if unit > 0 else (0.0 if value == 0 else math.inf)


@dataclass(frozen=True)
class Instructions:
    """Machine instructions per call, the callee's alone; `outside_libm` leaves out those spent in the maths library."""

    total: float
    outside_libm: float


@dataclass(frozen=True)
class Boundary:
    """Answers over the boundary states with finite inputs: each state is counted in one of the four.

    good: finite. remarked: finite, with a positive status. refused: a negative status, outputs untouched.
    nonfinite_at: a NaN or an infinity handed out without a word.
    """

    good: int
    remarked: int
    refused: int
    nonfinite_at: tuple[str, ...]

    @property
    def nonfinite(self) -> int:
        return len(self.nonfinite_at)

    @property
    def states(self) -> int:
        return self.good + self.remarked + self.refused + self.nonfinite


@dataclass(frozen=True)
class Measurement:
    """One contender and output. instructions: None for Python contenders and where valgrind is missing.

    aside: for the tables, not for the picture.
    """

    contender: str
    scalar: Scalar
    ours: bool
    output: Output
    label: str
    times: Times
    errors: Errors
    instructions: Instructions | None
    boundary: Boundary
    aside: bool = False


@dataclass(frozen=True)
class Built:
    """One contender's code as compiled: the compiler's seconds of processor time, bytes of instructions and constants.

    operations: of the matrix and the right side at once, counted as in the manifest; None where nobody can count.
    """

    contender: str
    seconds: float
    text: int
    operations: int | None


@dataclass(frozen=True)
class Bench:
    """One scene's measurements, all in one run on the same states.

    states: number of states; batch: calls a timed batch of C makes, each at another state. baseline: of the ratios.
    remarks: what was skipped and what to do about it; what the figures need to be read.
    """

    scene: str
    kind: str
    compiler: str
    flags: tuple[str, ...]
    states: int
    batch: int
    rounds: int
    seed: int
    baseline: str
    measurements: tuple[Measurement, ...]
    remarks: tuple[str, ...]
    builds: tuple[Built, ...] = ()

    def of(self, contender: str, output: Output) -> Measurement:
        """The measurement of that contender and output. KeyError where there is none."""
        for found in self.measurements:
            if (found.contender, found.output) == (contender, output):
                return found
        raise KeyError(f"no measurement of {contender!r}, {output.value!r}")
