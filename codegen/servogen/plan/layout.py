"""How the numbers of one solver lie in memory: which side is long, padding, and the C of a place."""

from dataclasses import dataclass
from typing import Literal

from servogen.scalars import Scalar

Form = Literal["row", "column", "full"]
"""Closed forms for one row and for one column, and the ladder for the rest."""

BLOCK = 4
"""Sums run in this many parts, and vectors are padded to whole blocks: SIMD and scalar machines add up alike."""


@dataclass(frozen=True)
class Layout:
    """Of one pseudo-inverse, S of m x l."""

    m: int
    l: int
    scalar: Scalar
    form: Form

    @property
    def wide(self) -> bool:
        """The vectors of the SVD are the rows (m <= l), else the columns."""
        return self.m <= self.l

    @property
    def count(self) -> int:
        """min(m, l), the number of singular values."""
        return min(self.m, self.l)

    @property
    def long(self) -> int:
        """max(m, l): the length of the vectors that are made orthogonal."""
        return max(self.m, self.l)

    @property
    def width(self) -> int:
        """`long` in whole blocks of four numbers; below four there are no blocks."""
        return self.long if self.long < BLOCK else -(-self.long // BLOCK) * BLOCK

    @property
    def pad(self) -> int:
        return self.width - self.long

    @property
    def stride(self) -> int:
        """Columns of the triangle, padded likewise."""
        return self.count if self.count < BLOCK else -(-self.count // BLOCK) * BLOCK

    @property
    def m_width(self) -> int:
        """Numbers in a working vector of m: padded if it is the long side."""
        return self.m if self.wide or self.form != "full" else self.width

    @property
    def l_width(self) -> int:
        return self.width if self.wide and self.form == "full" else self.l

    def m_at(self, index: str) -> str:
        """C for the place of element `index` in a working vector of m."""
        return index if self.wide else self._at(index)

    def l_at(self, index: str) -> str:
        return self._at(index) if self.wide and self.form == "full" else index

    def _at(self, index: str) -> str:
        whole = self.long - self.long % BLOCK
        return (
            index if self.pad == 0 or self.form != "full" else f"({index} < {whole} ? {index} : {index} + {self.pad})"
        )

    @property
    def real(self) -> str:
        return "double" if self.scalar == "float64" else "float"
