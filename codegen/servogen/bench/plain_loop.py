"""Runs of planar_arm_3r beside a closed loop in plain numpy: python -m servogen.bench.plain_loop [--runs 200].

Nothing of the generated code is used: the arm in the absolute angles of its links, the controller by the textbook's
formula, the classical Runge-Kutta method, the prescribed decay in closed form. Plants and starts are those that the
compiled runs have drawn.
"""

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from servogen.results import FloatArray
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.runs import QUANTILES, Runs
from servogen.simulate.wanted import load_simulation

SPREAD = {"m": 0.1, "q": 0.05, "u": 0.1}
"""Half-widths of the draws: 10 % of each mass, 0.05 rad and 0.1 rad/s of each joint at the start."""

STEP = 1e-3
_MASSES, _LENGTHS, _GRAVITY = (3.0, 2.0, 1.0), np.array([0.5, 0.4, 0.3]), 9.81
_THETA1, _THETA2 = -6.0, -8.0  # decays of 2 and 4 per second
_TO_ABSOLUTE = np.tril(np.ones((3, 3)))


@dataclass(frozen=True, eq=False)
class Comparison:
    """Quantiles of both loops by name, and the largest difference of single runs, relative to the largest of all."""

    compiled: dict[str, FloatArray]
    plain: dict[str, FloatArray]
    runs: float

    @property
    def quantiles(self) -> float:
        """The largest relative difference of a quantile."""
        return max(float(np.max(np.abs(self.plain[n] / v - 1))) for n, v in self.compiled.items())


def compare(loop: ClosedLoop, count: int, duration: float, seed: int = 0) -> Comparison:
    """`count` runs of planar_arm_3r's loop, and the same in numpy."""
    many = loop.runs(count, seed=seed, spread=SPREAD, duration=duration, step=STEP, method="rk4")
    found = plain_runs(many, duration)
    own = np.hstack([many.error, many.end, many.tau])
    sizes = np.max(np.abs(own), axis=0)
    plain = {n: np.quantile(found[:, k], QUANTILES) for k, n in enumerate(many.quantiles())}
    return Comparison(many.quantiles(), plain, float(np.max(np.abs(found - own) / sizes)))


def plain_runs(many: Runs, duration: float) -> FloatArray:
    """Of each run the deviations from the decay (2), |psi| at the end (2) and the largest torques (3): (N, 7)."""
    m, q, u = (many.draws[:, [many.names.index(f"{n}[{k}]") for k in range(3)]] for n in ("m", "q", "u"))
    known = np.tile(_MASSES, (len(m), 1))
    x = np.hstack([q, u])
    psi, psi_dot = _error(0.0, x)
    slow, fast = (4 * psi + psi_dot) / 2, (2 * psi + psi_dot) / -2
    error, tau_max = np.zeros_like(psi), np.zeros_like(q)

    def rate(t: float, x: FloatArray) -> FloatArray:
        Q, bias = _arm(m, x)
        push = _control(known, t, x) - bias
        return np.hstack([x[:, 3:], np.linalg.solve(Q, push[:, :, None])[:, :, 0]])

    for k in range(round(duration / STEP) + 1):
        t = k * STEP
        psi, _ = _error(t, x)
        decay = slow * math.exp(-2 * t) + fast * math.exp(-4 * t)
        error = np.maximum(error, np.abs(psi - decay))
        tau_max = np.maximum(tau_max, np.abs(_control(known, t, x)))
        end = np.abs(psi)
        a = rate(t, x)
        b = rate(t + STEP / 2, x + STEP / 2 * a)
        c = rate(t + STEP / 2, x + STEP / 2 * b)
        x = x + STEP / 6 * (a + 2 * b + 2 * c + rate(t + STEP, x + STEP * c))
    return np.hstack([error, end, tau_max])


def _control(m: FloatArray, t: float, x: FloatArray) -> FloatArray:
    """tau = S+ z with S = J Q^-1."""
    Q, bias = _arm(m, x)
    J, drift = _jacobian(x)
    psi, psi_dot = _error(t, x)
    wanted = _reference(t)[2] + _THETA1 * psi_dot + _THETA2 * psi
    S = np.swapaxes(np.linalg.solve(Q, np.swapaxes(J, 1, 2)), 1, 2)  # Q is symmetric
    z = wanted - drift + np.einsum("nij,nj->ni", S, bias)
    tau: FloatArray = np.einsum("nij,nj->ni", np.linalg.pinv(S), z)
    return tau


def _arm(m: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The mass matrix (N, 3, 3) and what stands against the torques, by Lagrange in absolute angles."""
    angle, spin = x[:, :3] @ _TO_ABSOLUTE.T, x[:, 3:] @ _TO_ABSOLUTE.T
    reach = np.tril(np.tile(_LENGTHS, (3, 1)), -1) + np.diag(_LENGTHS / 2)  # of link k's centre along link i
    coupling = np.einsum("nk,ki,kj->nij", m, reach, reach)
    between = angle[:, :, None] - angle[:, None, :]
    inertia = coupling * np.cos(between)
    inertia[:, range(3), range(3)] += m * _LENGTHS**2 / 12
    against = np.einsum("nij,nj->ni", coupling * np.sin(between), spin**2)
    against += _GRAVITY * (m @ reach) * np.cos(angle)
    return _TO_ABSOLUTE.T @ inertia @ _TO_ABSOLUTE, against @ _TO_ABSOLUTE


def _jacobian(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """J (N, 2, 3) of the arm's end, and J' u."""
    angle, spin = x[:, :3] @ _TO_ABSOLUTE.T, x[:, 3:] @ _TO_ABSOLUTE.T
    along = np.stack([np.cos(angle), np.sin(angle)], axis=1) * _LENGTHS
    across = np.stack([-np.sin(angle), np.cos(angle)], axis=1) * _LENGTHS
    return across @ _TO_ABSOLUTE, -np.einsum("nij,nj->ni", along, spin**2)


def _error(t: float, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """psi and psi'."""
    angle = x[:, :3] @ _TO_ABSOLUTE.T
    place = np.stack([np.cos(angle), np.sin(angle)], axis=1) @ _LENGTHS
    r, r_dot, _ = _reference(t)
    return place - r, np.einsum("nij,nj->ni", _jacobian(x)[0], x[:, 3:]) - r_dot


def _reference(t: float) -> FloatArray:
    """The circle, its velocity and its acceleration."""
    c, s = 0.15 * math.cos(math.pi * t), 0.15 * math.sin(math.pi * t)
    return np.array([[0.5 + c, 0.4 + s], [-math.pi * s, math.pi * c], [-(math.pi**2) * c, -(math.pi**2) * s]])


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--duration", type=float, default=6.0, help="seconds of each run")
    given = parser.parse_args(arguments)
    done = compare(ClosedLoop(*load_simulation("planar_arm_3r")), given.runs, given.duration)
    print(f"planar_arm_3r, {given.runs} runs of {given.duration:g} s: compiled, plain, at {QUANTILES}")
    for name, values in done.compiled.items():
        print(f"  {name}: {_listed(values)}\n  {'':{len(name)}}  {_listed(done.plain[name])}")
    print(f"largest relative difference of a quantile {done.quantiles:.2g}; of single runs {done.runs:.2g}")


def _listed(values: FloatArray) -> str:
    return ", ".join(f"{x:.10g}" for x in values)


if __name__ == "__main__":
    main()
