"""Numerical stress of the solver: families of matrices against exact rationals, each figure beside its bar.

`campaign` runs it, `families` are what it feeds, `truth` and `core` what it measures, `bars` what is allowed
(numerics.md: Bars). Every system comes from the seed; a figure is the largest over its systems.
"""

from servogen.verify.stress.bars import BARS
from servogen.verify.stress.families import FAMILIES, SHAPES
from servogen.verify.stress.report import StressReport, StressRow
from servogen.verify.stress.tasks import stress, tasks

__all__ = ["BARS", "FAMILIES", "SHAPES", "StressReport", "StressRow", "stress", "tasks"]
