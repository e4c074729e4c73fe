"""Mechanisms with loops and rolling, and their motion by a dense Karush-Kuhn-Tucker system to 50 digits."""

from typing import Any

import casadi as ca
import mpmath as mp
import numpy as np
import servogen as sg

DIGITS = 50


def random_mechanism(seed: int, n: int, loops: int, rolling: int, redundant: bool) -> sg.Mechanism:
    """n velocity parameters, three controls, a dense Q of q, `loops` and `rolling` rows; redundant: one row twice."""
    g = np.random.default_rng(seed)
    q, u, tau = ca.SX.sym("q", n), ca.SX.sym("u", n), ca.SX.sym("tau", 3)
    A = g.normal(size=(n, n))
    Q = ca.DM(A @ A.T + n * np.eye(n)) + 0.3 * ca.diag(ca.sin(q) ** 2)
    P = ca.mtimes(ca.DM(g.normal(size=(n, n))), ca.cos(q)) - u * ca.sumsqr(u) / 10
    curved = ca.mtimes(ca.DM(g.normal(size=(loops, n))), ca.sin(q)) + ca.mtimes(ca.DM(g.normal(size=(loops, n))), q)
    slope = ca.DM(g.normal(size=(rolling, n))) + ca.DM(g.normal(size=(rolling, 1))) @ ca.sin(q).T
    passive: list[Any] = []
    if loops:
        passive.append(sg.PassiveHolonomic("loop", ca.vertcat(curved, 2 * curved[0]) if redundant else curved))
    if rolling:
        passive.append(sg.PassiveNonholonomic("rolling", ca.mtimes(slope, u)))
    return sg.Mechanism(q=q, u=u, tau=tau, Q=Q, P=P, G=ca.DM(g.normal(size=(n, 3))), passive=passive)


def exact_motion(scene: sg.Scene, state: dict[str, Any]) -> tuple[Any, Any, Any]:
    """S, z (of holonomic rows without references) and lam under tau, as mpmath matrices.

    J and j by derivatives of chi with CasADi, its numbers as they are; the solve itself to 50 digits, lam by the
    pseudo-inverse of J^T.
    """
    mech = scene.mechanism
    rates = [ca.jtimes(c.chi, mech.q, mech.u) if isinstance(c, sg.PassiveHolonomic) else c.chi for c in mech.passive]
    rate, (c,) = ca.vertcat(*rates), scene.constraints
    psi_dot = ca.jtimes(c.psi, mech.q, mech.u)
    prescribed = ca.mtimes(c.Theta1, psi_dot) + ca.mtimes(c.Theta2, c.psi)
    parts = [mech.Q, mech.P, mech.G, ca.jacobian(rate, mech.u), ca.jtimes(rate, mech.q, mech.u)]
    parts += [ca.jacobian(psi_dot, mech.u), ca.jtimes(psi_dot, mech.q, mech.u), prescribed]
    function = ca.Function("parts", [mech.q, mech.u], parts)
    with mp.workdps(DIGITS):
        Q, P, G, J, j, K, X, wanted = (mp.matrix(np.array(v).tolist()) for v in function(state["q"], state["u"]))
        n = Q.rows
        rows = _independent(J)
        kkt = mp.zeros(n + len(rows))
        for a in range(n):
            for b in range(n):
                kkt[a, b] = Q[a, b]
        for k, row in enumerate(rows):
            for a in range(n):
                kkt[a, n + k], kkt[n + k, a] = -J[row, a], J[row, a]

        def motion(force: Any, drift: Any) -> Any:
            right = mp.matrix([*force, *(drift[row] for row in rows)])
            return list(mp.lu_solve(kkt, right))

        none = mp.zeros(J.rows, 1)
        free = motion(P, -j)
        gains = [motion(G[:, k], none) for k in range(G.cols)]
        S = mp.matrix([[mp.fdot(K[i, :], x[:n]) for x in gains] for i in range(K.rows)])
        z = mp.matrix([wanted[i] - X[i] - mp.fdot(K[i, :], free[:n]) for i in range(K.rows)])
        lam = free[n:]
        for k, x in enumerate(gains):
            lam = [a + mp.mpf(float(state["tau"][k])) * b for a, b in zip(lam, x[n:], strict=True)]
        kept = mp.matrix([[J[row, a] for a in range(n)] for row in rows])
        B = (mp.inverse(kept * kept.T) * kept * J.T).T
        return S, z, B * mp.lu_solve(B.T * B, mp.matrix(lam))


def _independent(J: Any) -> list[int]:
    """Rows of J that no earlier ones make up, to 20 digits."""
    rows: list[int] = []
    basis: list[Any] = []
    for k in range(J.rows):
        v = J[k, :].T
        size = mp.norm(v)
        for b in basis:
            v = v - (b.T * v)[0] * b
        if mp.norm(v) > mp.mpf(10) ** -12 * size:
            basis.append(v / mp.norm(v))
            rows.append(k)
    return rows
