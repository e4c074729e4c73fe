"""Random linear mechanisms, and what is true of them: Markov parameters, and the zeros of the Rosenbrock pencil."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import servogen as sg
from scipy.linalg import eig


@dataclass(frozen=True, eq=False)
class Linear:
    """x' = A x + B tau, psi = K x with x = (q, u), all of integers; K of q alone, or of u alone."""

    A: Any
    B: Any
    K: Any
    scene: sg.Scene

    def degree(self, row: int) -> int | None:
        """The first k with K A^(k - 1) B not zero in this row, in integers without end."""
        power = self.K[row].astype(object)
        A, B = self.A.astype(object), self.B.astype(object)
        for k in range(1, len(A) + 1):
            if any(power @ B):
                return k
            power = power @ A
        return None

    def decoupling(self) -> Any:
        """Rows K A^(r - 1) B."""
        rows = []
        for row in range(len(self.K)):
            power = self.K[row].astype(object)
            for _ in range((self.degree(row) or 1) - 1):
                power = power @ self.A.astype(object)
            rows.append(power @ self.B.astype(object))
        return np.array(rows).astype(float)

    def invertible(self) -> bool:
        """Whether the transfer function K (s I - A)^-1 B has full rank for almost all s: at one that nothing made."""
        s = 0.37 + 0.61j
        inner = np.linalg.solve(s * np.eye(len(self.A)) - self.A.astype(float), self.B.astype(float))
        return bool(np.linalg.matrix_rank(self.K @ inner, rtol=1e-9) == len(self.K))

    def zeros(self) -> Any:
        """The finite s at which [A - s I, B; K, 0] loses rank."""
        n, m, l = len(self.A), len(self.K), self.B.shape[1]
        assert m == l
        M = np.block([[self.A.astype(float), self.B.astype(float)], [self.K.astype(float), np.zeros((m, l))]])
        N = np.zeros_like(M)
        N[:n, :n] = np.eye(n)
        alpha, beta = eig(M, N, right=False, homogeneous_eigvals=True)
        finite = np.abs(beta) > 1e-7 * np.abs(alpha)
        return alpha[finite] / beta[finite]


def random_linear(seed: int) -> Linear:
    """Few springs and dampers between 2 to 4 masses, 1 or 2 controls and as many rows: degrees from 1 to beyond 4."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 5)), int(rng.integers(1, 3))
    low = np.eye(n, dtype=int) + np.tril(rng.integers(-1, 2, (n, n)) * (rng.random((n, n)) < 0.25), -1)
    Q = low @ low.T  # of determinant one, so that its inverse is of integers, too
    inverse = np.rint(np.linalg.inv(Q)).astype(int)
    share = rng.choice([0.2, 0.5, 0.9])
    stiffness = rng.integers(-3, 4, (n, n)) * (rng.random((n, n)) < share)
    damping = rng.integers(-2, 3, (n, n)) * (rng.random((n, n)) < share / 2)
    G = np.zeros((n, m), int)
    G[rng.permutation(n)[:m], range(m)] = 1
    G = G + rng.integers(-1, 2, (n, m)) * (rng.random((n, m)) < 0.2)
    of_speeds = bool(rng.random() < 0.3)
    rows = np.zeros((m, n), int)
    rows[range(m), rng.permutation(n)[:m]] = 1
    rows = rows + rng.integers(-1, 2, (m, n)) * (rng.random((m, n)) < 0.2)
    zero = np.zeros((n, n), int)
    A = np.block([[zero, np.eye(n, dtype=int)], [inverse @ -stiffness, inverse @ -damping]])
    B = np.vstack([np.zeros((n, m), int), inverse @ G])
    K = np.hstack([0 * rows, rows] if of_speeds else [rows, 0 * rows])
    q, u = ca.SX.sym("q", n), ca.SX.sym("u", n)
    P = -ca.mtimes(ca.DM(stiffness), q) - ca.mtimes(ca.DM(damping), u)
    mech = sg.Mechanism(q, u, ca.SX.sym("tau", m), Q=ca.DM(Q), P=P, G=ca.DM(G))
    psi = ca.mtimes(ca.DM(rows), u if of_speeds else q)
    constraints = [sg.Output(f"row_{k}", psi[k], [-1.0]) for k in range(m)]
    return Linear(A, B, K, sg.Scene(f"linear_{seed}", mech, constraints))
