"""Servo-constraints, and the stability of the dynamics the user prescribes for them."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar, Literal

import casadi as ca
import flint
import numpy as np

from servogen.errors import SceneError
from servogen.results import FloatArray
from servogen.scene.convert import column, to_sx
from servogen.scene.names import check_identifier
from servogen.scene.symbols import derived


def _label(name: object) -> str:
    if not isinstance(name, str) or not name.strip() or not name.isprintable():
        raise SceneError(f"a constraint's name must be printable text; got {name!r}")
    return f"constraint {name!r}"


def _rows(value: Any, what: str) -> Any:
    sx = column(value, what)
    if sx.size1() == 0:
        raise SceneError(f"{what} is empty; give at least one row")
    return sx


def _priority(value: object, what: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise SceneError(f"{what}: priority={value!r}; give an integer, the lower the more important")
    return int(value)


def _check_active(active: object, name: str, what: str) -> None:
    if active is None:
        return
    if active != "input":
        raise SceneError(f"{what}: active={active!r}; give 'input' for the input {name}_active, or leave it out")
    check_identifier(f"{name}_active", f"{what}: the input")


def theta_matrix(Theta: Any, m: int, what: str) -> Any:
    """Theta as an m x m SX: a number times I, a vector as a diagonal, or the matrix itself."""
    sx = to_sx(Theta, what)
    if sx.is_scalar():
        return sx * ca.SX.eye(m)
    if sx.shape == (m, m):
        return sx
    if sx.is_vector() and sx.numel() == m:
        return ca.diag(sx)
    raise SceneError(
        f"{what} has shape {sx.size1()}x{sx.size2()}; give a number, a vector of {m} (the diagonal) or a {m}x{m} matrix"
    )


def check_hurwitz(matrix: Any, what: str) -> None:
    """SceneError unless every eigenvalue of a numeric matrix has a negative real part."""
    polynomial = _characteristic_polynomial(np.array(ca.DM(matrix), dtype=float))
    if _is_hurwitz(polynomial):
        return
    worst = _largest_real_part(polynomial)
    if worst == 0:
        fault = "is marginal: it has an eigenvalue with real part 0, so that errors would not decay"
    else:
        fault = f"is unstable: it has an eigenvalue with real part {worst:.4g}, so that errors would grow"
    raise SceneError(f"{what} {fault}; every eigenvalue must lie in the open left half-plane (Hurwitz)")


def _characteristic_polynomial(numbers: FloatArray) -> flint.fmpq_poly:
    """In rationals, as Routh's array below: numeric eigenvalues of a singular matrix come out on either side of zero.

    Numbers count as the decimals they print.
    """
    rows = [[flint.fmpq(*Fraction(repr(float(x))).as_integer_ratio()) for x in row] for row in numbers]
    return flint.fmpq_mat(rows).charpoly()


def _is_hurwitz(polynomial: flint.fmpq_poly) -> bool:
    """Whether every root has a negative real part: Routh's array."""
    coefficients = polynomial.coeffs()[::-1]
    upper, lower = coefficients[0::2], coefficients[1::2]
    while lower:
        if lower[0] <= 0:
            return False
        ratio = upper[0] / lower[0]
        below = [*lower[1:], flint.fmpq(0)]
        upper, lower = lower, [a - ratio * b for a, b in zip(upper[1:], below, strict=False)]
    return True


def _largest_real_part(polynomial: flint.fmpq_poly) -> float:
    """Of the roots, to about 16 digits: they are enclosed in intervals, and 0 stands for one that holds 0."""
    parts = [root.real for root, _ in polynomial.complex_roots()]
    return max(0.0 if part.contains(0) else float(part) for part in parts)


@dataclass(frozen=True, eq=False)
class Nonholonomic:
    """psi(q, u, t) = 0, imposed as psi' = Theta psi, Eqs. (3)-(9).

    Theta: number, vector (diagonal), m x m matrix, or SX of parameters; a numeric one must be Hurwitz.
    priority: an integer; constraints of higher numbers get what those of lower ones leave open.
    active: "input" for an input <name>_active, 0 to 1, that brings the constraint in and takes it out; None: always in.
    """

    name: str
    psi: Any
    Theta: Any
    priority: int = 0
    active: Literal["input"] | None = None

    word: ClassVar = "nonholonomic"
    symbol: ClassVar = "psi"
    order: ClassVar = 1

    def __post_init__(self) -> None:
        what = _label(self.name)
        psi = _rows(self.psi, f"{what}: psi")
        Theta = theta_matrix(self.Theta, psi.size1(), f"{what}: Theta")
        if Theta.is_constant():
            check_hurwitz(Theta, f"{what}: Theta")
        object.__setattr__(self, "priority", _priority(self.priority, what))
        _check_active(self.active, self.name, what)
        object.__setattr__(self, "psi", psi)
        object.__setattr__(self, "Theta", Theta)

    @property
    def size(self) -> int:
        return int(self.psi.size1())

    @property
    def wish(self) -> str:
        return "psi' = Theta psi"

    @property
    def thetas(self) -> tuple[Any, ...]:
        return (self.Theta,)


@dataclass(frozen=True, eq=False)
class Holonomic:
    """psi(q, t) = 0, imposed as psi'' = Theta1 psi' + Theta2 psi, Eqs. (11)-(12).

    Theta1, Theta2 as for Nonholonomic; numeric ones must make the companion [[0, I], [Theta2, Theta1]] Hurwitz.
    priority, active: as for Nonholonomic.
    """

    name: str
    psi: Any
    Theta1: Any
    Theta2: Any
    priority: int = 0
    active: Literal["input"] | None = None

    word: ClassVar = "holonomic"
    symbol: ClassVar = "psi"
    order: ClassVar = 2

    def __post_init__(self) -> None:
        what = _label(self.name)
        psi = _rows(self.psi, f"{what}: psi")
        m = psi.size1()
        Theta1 = theta_matrix(self.Theta1, m, f"{what}: Theta1")
        Theta2 = theta_matrix(self.Theta2, m, f"{what}: Theta2")
        if Theta1.is_constant() and Theta2.is_constant():
            check_hurwitz(
                companion((Theta2, Theta1)), f"{what}: the companion [[0, I], [Theta2, Theta1]] of Theta1 and Theta2"
            )
        object.__setattr__(self, "priority", _priority(self.priority, what))
        _check_active(self.active, self.name, what)
        object.__setattr__(self, "psi", psi)
        object.__setattr__(self, "Theta1", Theta1)
        object.__setattr__(self, "Theta2", Theta2)

    @property
    def size(self) -> int:
        return int(self.psi.size1())

    @property
    def wish(self) -> str:
        return "psi'' = Theta1 psi' + Theta2 psi"

    @property
    def thetas(self) -> tuple[Any, ...]:
        return (self.Theta2, self.Theta1)


@dataclass(frozen=True, eq=False)
class Output:
    """psi(q, u, t) = 0, of relative degree r = len(Theta), imposed as psi^(r) = T0 psi + T1 psi' + ...

    Theta: the list [T0, T1, ...], each as for Nonholonomic; where all are numeric their companion
    [[0, I, 0], [0, 0, I], [T0, T1, T2]] (r = 3) must be Hurwitz. No derivative of psi below the r-th may reach tau, and
    the r-th must: both are proved when the scene is built, and a SceneError names the row and its own degree.
    Holonomic(psi, Theta1, Theta2) is Output(psi, [Theta2, Theta1]), and Nonholonomic(psi, Theta) is
    Output(psi, [Theta]). Isidori (1995), Section 5.1: the relative degree, and this law.
    priority, active: as for Nonholonomic.
    """

    name: str
    psi: Any
    Theta: Any
    priority: int = 0
    active: Literal["input"] | None = None

    word: ClassVar = "output"
    symbol: ClassVar = "psi"

    def __post_init__(self) -> None:
        what = _label(self.name)
        psi = _rows(self.psi, f"{what}: psi")
        if not isinstance(self.Theta, list | tuple) or not self.Theta:
            raise SceneError(
                f"{what}: Theta must be the list [T0, T1, ...], one for psi and each of its derivatives below the one "
                f"that the controls reach; got {self.Theta!r}"
            )
        thetas = tuple(theta_matrix(T, psi.size1(), f"{what}: T{k}") for k, T in enumerate(self.Theta))
        if all(T.is_constant() for T in thetas):
            check_hurwitz(companion(thetas), f"{what}: the companion of Theta")
        object.__setattr__(self, "priority", _priority(self.priority, what))
        _check_active(self.active, self.name, what)
        object.__setattr__(self, "psi", psi)
        object.__setattr__(self, "Theta", thetas)

    @property
    def size(self) -> int:
        return int(self.psi.size1())

    @property
    def order(self) -> int:
        """r, the relative degree."""
        return len(self.Theta)

    @property
    def wish(self) -> str:
        terms = (f"T{k} {derived('psi', k)}" for k, T in enumerate(self.Theta) if not T.is_zero())
        return f"{derived('psi', self.order)} = {' + '.join(terms)}"

    @property
    def thetas(self) -> tuple[Any, ...]:
        return tuple(self.Theta)


def companion(thetas: Sequence[Any]) -> Any:
    """[[0, I, 0], [0, 0, I], [T0, T1, T2]]: its eigenvalues are those of psi''' = T0 psi + T1 psi' + T2 psi''."""
    m, order = thetas[0].size1(), len(thetas)
    rows = [[ca.SX.eye(m) if j == i + 1 else ca.SX(m, m) for j in range(order)] for i in range(order - 1)]
    return ca.vertcat(*(ca.horzcat(*row) for row in (*rows, thetas)))


@dataclass(frozen=True, eq=False)
class ControlsInvolved:
    """phi(q, u, tau, t) = 0, realised by A tau' = B, Eqs. (36)-(41), with Theta phi added to B.

    Theta = 0 (the default) keeps phi where it is; a numeric one must otherwise be Hurwitz.
    """

    name: str
    phi: Any
    Theta: Any = 0

    word: ClassVar = "controls-involved"
    symbol: ClassVar = "phi"
    order: ClassVar = 1

    def __post_init__(self) -> None:
        what = _label(self.name)
        phi = _rows(self.phi, f"{what}: phi")
        Theta = theta_matrix(self.Theta, phi.size1(), f"{what}: Theta")
        if Theta.is_constant() and not Theta.is_zero():
            check_hurwitz(Theta, f"{what}: Theta (0 would be allowed, too)")
        object.__setattr__(self, "phi", phi)
        object.__setattr__(self, "Theta", Theta)

    @property
    def size(self) -> int:
        return int(self.phi.size1())

    @property
    def wish(self) -> str:
        return "phi' = 0" if self.Theta.is_zero() else "phi' = Theta phi"

    @property
    def thetas(self) -> tuple[Any, ...]:
        return (self.Theta,)


Constraint = Nonholonomic | Holonomic | Output | ControlsInvolved
"""What all of them tell besides their parts. word, symbol: what they and their expression are called. wish: what is
asked of it, a formula. order: of the derivative that is prescribed; thetas: what multiplies the expression and its
derivatives below that one."""

CONSTRAINTS = (Nonholonomic, Holonomic, Output, ControlsInvolved)


def decay_of(constraint: Constraint) -> Any:
    """The matrix of x' = decay x, x being the expression and its time derivatives below its order."""
    return companion(constraint.thetas)


def is_holonomic(constraint: Constraint, u: Any) -> bool:
    """Whether its second derivative is prescribed, of an expression without u: that alone needs no u'."""
    return constraint.order == 2 and not ca.depends_on(expression_of(constraint), u)


def expression_of(constraint: Constraint) -> Any:
    """psi or phi."""
    return constraint.phi if isinstance(constraint, ControlsInvolved) else constraint.psi


def theta_parts(constraint: Constraint) -> dict[str, Any]:
    """The Theta matrices of a constraint by name."""
    if isinstance(constraint, Holonomic):
        return {"Theta1": constraint.Theta1, "Theta2": constraint.Theta2}
    if isinstance(constraint, Output):
        return {f"T{k}": theta for k, theta in enumerate(constraint.Theta)}
    return {"Theta": constraint.Theta}
