"""Every derivation on random models: the mechanism's own motion, differentiated numerically, must be what was derived.

The models of support.models have explicit time, D, C (rectangular where n is even), parameters, and references with one
and two rates; here their sizes, masses and kinds are drawn as well, l > n among them.
"""

from typing import Any

import casadi as ca
import numpy as np
import servogen as sg
from derive.test_motion import Motion, excess, random_state
from hypothesis import assume, given
from hypothesis import strategies as st
from support.models import MASSES, derived, random_scene
from support.programs import examples

SEEDS = st.integers(0, 100_000)
KINDS = st.sampled_from(["nonholonomic", "holonomic", "mixed"])


def close(left: Any, right: Any) -> None:
    np.testing.assert_allclose(left, right, rtol=5e-6, atol=5e-6 * (1 + np.abs(right).max()))


@examples(12)
@given(seed=SEEDS, kind=KINDS, mass=st.sampled_from(MASSES), n=st.integers(2, 4), l=st.integers(2, 5))
def test_servo_rows_are_the_motion(seed: int, kind: str, mass: str, n: int, l: int) -> None:
    """psi' - Theta psi (psi'' - Theta1 psi' - Theta2 psi) = S tau - z for any tau."""
    scene = random_scene(seed, kind, 2, l, n, mass)
    motion, rng = Motion(scene), np.random.default_rng(seed)
    state, tau = random_state(scene, rng), rng.uniform(-2, 2, l)
    system = derived(scene)[1](**state, tau=tau)
    assert system["S"].shape == (2, l)
    close(excess(motion, motion.constraints_at(state, lambda s: tau)), system["S"] @ tau - system["z"].ravel())


@examples(8)
@given(seed=SEEDS, mass=st.sampled_from(MASSES), n=st.integers(1, 4), m=st.integers(1, 2), l=st.integers(2, 4))
def test_controls_involved_rows_are_the_motion(seed: int, mass: str, n: int, m: int, l: int) -> None:
    """phi' - Theta phi = A tau' - B for any tau'; the second derivatives of phi by tau are those of A."""
    scene = random_scene(seed, "controls", m, l, n, mass)
    motion, rng = Motion(scene), np.random.default_rng(seed)
    state, rate = random_state(scene, rng), rng.uniform(-2, 2, l)
    formulation, quantities = derived(scene)
    system, start = quantities(**state), state["tau"]
    samples = motion.constraints_at(state, lambda s: start + s * rate)
    close(excess(motion, samples), system["A"] @ rate - system["B"].ravel())
    h, bends = 1e-5, np.zeros((m, l, l))
    for (row, i, j), value in zip(
        formulation.law.routine("project").steps[0].places, system["curvature"].ravel(), strict=True
    ):
        bends[row, i, j] = bends[row, j, i] = value
    for j in range(l):
        ahead, behind = (quantities(**(state | {"tau": start + s * h * np.eye(l)[j]}))["A"] for s in (1, -1))
        close((ahead - behind) / (2 * h), bends[:, :, j])


@examples(10)
@given(
    seed=SEEDS,
    kind=KINDS,
    l=st.integers(2, 4),
    free=st.sampled_from(["none", "expression", "input"]),
    weighted=st.booleans(),
)
def test_the_answer_makes_the_constraints_decay_and_is_the_nearest(
    seed: int, kind: str, l: int, free: str, weighted: bool
) -> None:
    """With tau = y + S_W+ (z - S y) the rows decay as Theta says, and W (tau - y) has no part that S does not see."""
    base = random_scene(seed, kind, 2, l)
    rng = np.random.default_rng(seed)
    half = rng.uniform(-0.4, 0.4, (l, l))
    bend = ca.sin(base.mechanism.q[0] + base.mechanism.t)
    W = ca.triu2symm(ca.triu(half @ half.T + np.eye(l) * (2 + bend))) if weighted else None
    formula = ca.cos(base.mechanism.u[0]) * ca.DM(np.arange(1, l + 1))
    y = {"none": None, "input": "input", "expression": formula}[free]
    scene = sg.Scene("s", base.mechanism, base.constraints, base.parameters, base.references, y=y, weight=W)
    formulation, quantities = derived(scene)
    motion, state = Motion(scene), random_state(scene, rng)
    found = quantities(**state, tau=np.zeros(l))
    S, z = found["S"], found["z"].ravel()
    assume(np.linalg.cond(S) < 50)
    weight = np.eye(l)
    if weighted:
        weight = np.array(ca.Function("W", [base.mechanism.q, base.mechanism.t], [W])(state["q"], state["t"]))
    numbers = np.cos(state["u"][0]) * np.arange(1, l + 1)
    given_y = {"none": np.zeros(l), "input": state.get("y"), "expression": numbers}[free]
    if formulation.weight is None:
        tau = given_y + np.linalg.pinv(S) @ (z - S @ given_y)
    else:  # in sigma = L^T tau, as the code has it
        target = found["y_w"].ravel() if free != "none" else np.zeros(l)
        sigma = target + np.linalg.pinv(found["S_w"]) @ (z - found["S_w"] @ target)
        back = found["recover"].ravel()
        tau = np.array([sum(back[e] * sigma[j] for e, j in row) for row in formulation.weight.pattern])
    assume(np.linalg.norm(tau) < 10)  # violent motions need finer differences
    left = excess(motion, motion.constraints_at(state, lambda s: tau))
    np.testing.assert_allclose(left, 0, atol=2e-4 * (1 + np.abs(z).max() + np.linalg.norm(S) * np.linalg.norm(tau)))
    gradient = weight @ (tau - given_y)
    unseen = gradient - np.linalg.pinv(S) @ S @ gradient
    assert np.linalg.norm(unseen) <= 1e-9 * (1 + np.linalg.norm(gradient))


@examples(8)
@given(seed=SEEDS, kind=KINDS, mass=st.sampled_from(MASSES))
def test_ideal_forces_make_the_constraints_decay(seed: int, kind: str, mass: str) -> None:
    """With forces R on every velocity (G = I) the rows decay, and T u' = F along that very motion."""
    base = random_scene(seed, kind, 2, 3, 3, mass)
    mech = base.mechanism
    everywhere = sg.Mechanism(
        q=mech.q, u=mech.u, tau=mech.tau, t=mech.t, C=mech.C, D=mech.D, Q=mech.Q, P=mech.P, G=ca.DM.eye(3)
    )
    scene = sg.Scene("s", everywhere, base.constraints, base.parameters, base.references, mode="ideal")
    motion, rng = Motion(scene), np.random.default_rng(seed)
    state = random_state(scene, rng)
    found = derived(scene)[1](**state, tau=np.zeros(3))
    assume(np.linalg.cond(found["reaction_matrix"]) < 100)
    assume(np.linalg.cond(found["T"]) < 1e3)
    R = found["J"].T @ np.linalg.solve(found["reaction_matrix"], found["reaction_right"].ravel())
    assume(np.linalg.norm(R) < 10)
    left = excess(motion, motion.constraints_at(state, lambda s: R))
    np.testing.assert_allclose(left, 0, atol=2e-4 * (1 + np.abs(found["reaction_right"]).max() + np.abs(R).max()))
    u_dot = motion.rates(state, 0.0, np.concatenate([state["q"], state["u"]]), R)[len(state["q"]) :]
    close(found["T"] @ u_dot, found["F"].ravel())
