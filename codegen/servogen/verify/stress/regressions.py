"""Matrices on which other libraries failed, each with the place where that was told."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from servogen.scalars import Scalar

nan, inf = float("nan"), float("inf")


@dataclass(frozen=True)
class Regression:
    """S; z is S (1, ..., 1), or zero where S is not finite. only: the scalar it was found in."""

    source: str
    S: tuple[tuple[float, ...], ...]
    only: Scalar | None = None

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.S), len(self.S[0])

    @property
    def finite(self) -> bool:
        return bool(np.isfinite(np.array(self.S)).all())


def _given(source: str, S: Any, only: Scalar | None = None) -> Regression:
    return Regression(source, tuple(tuple(float(x) for x in row) for row in S), only)


REGRESSIONS: tuple[Regression, ...] = (
    _given("casadi#1820: pinv of parallel rows is NaN", [[1, 2], [1, 2]]),
    _given("parallel rows of unlike size", [[1, 2], [2, 4]]),
    _given("integers of rank 2, a Jacobi loop that does not end", [[1, 2, 3], [2, 1, 3], [3, 1, 4]]),
    _given("LAPACK#1409: gesdd hangs on infinity", [[inf, 1, 1], [1, 1, 1], [1, 1, 1]]),
    _given("numpy#5588: NaN beside zeros", [[0, 0], [nan, nan]]),
    _given("Eigen 286: subnormal entries", [[-7.90884e-313, -4.94e-324], [0, 5.60844e-313]], "float64"),
    _given("Eigen 286, in float32", [[-1.59e-43, -1.4e-45], [0, 1.135e-43]], "float32"),
    _given(
        "nalgebra#1313: float32, entries at the noise of the others",
        [[5e-30, 0, 1, 0, 0, 6e-16, 0, 0], [0, 6e-16, 0, 0, 1, 0, 0, 0], [0, 0, 6e-16, 1, 0, 0, 0, 1]],
    ),
    _given("LAPACK#565: a column of the smallest normal numbers", [[0, 0], [2.0**-1022, 1]], "float64"),
    _given("LAPACK#565, in float32", [[0, 0], [2.0**-126, 1]], "float32"),
    _given("LAPACK#565, the column alone", [[2.0**-1022, 0], [2.0**-1022, 0]], "float64"),
    _given(
        "PX4-Matrix#148, PX4#23606: a rank tolerance cut a mixer off",
        [[-0.5, 0.5, 0.5, -0.5], [0.5, -0.5, 0.5, -0.5], [1e-2, 1e-2, -1e-2, -1e-2]],
    ),
    _given(
        "PX4#23606: six axes, thrust and yaw small",
        [
            [-0.7, 0.7, 0.7, -0.7, 0, 0, 0, 0],
            [0.7, -0.7, 0.7, -0.7, 0, 0, 0, 0],
            [0.03, 0.03, -0.03, -0.03, 0.002, 0.002, -0.002, -0.002],
        ],
    ),
)
