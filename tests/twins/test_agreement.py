"""The compiled C against the reference, which shares neither derivation nor optimiser nor solver with it."""

from typing import Any

import numpy as np
import pytest
import servogen as sg
from servogen.compiler import optimised_scene
from servogen.ir.rounding import rounding_bounds
from servogen.loading import builtin_names, load_scene
from servogen.results import Path
from servogen.scene.domain import draw_states
from support.models import awkward_scenes, random_scene
from support.mutate import mutated

STATES = 30
EPS = {"float64": 2.0**-52, "float32": 2.0**-23}


def rows(states: dict[str, Any]) -> list[dict[str, Any]]:
    count = len(next(iter(states.values())))
    return [{name: values[k] for name, values in states.items()} for k in range(count)]


def compare(scene: sg.Scene, scalar: str) -> None:
    """Quantities within the rounding bounds of both sides, tau within what these and the two solvers can cost."""
    compiled = sg.build(scene, scalar=scalar).load(flags=["-O0"])  # type: ignore[arg-type]
    reference = sg.reference(scene, scalar)  # type: ignore[arg-type]
    names = ("psi", "S", "z") if scene.kind == "servo" else ("phi", "A", "B")
    drawn = draw_states(scene, STATES, seed=5)
    tolerance = quantity_bounds(scene, scalar, drawn)
    compared = 0
    for k, state in enumerate(rows(drawn)):
        errors = {}
        for name in names:
            ours, theirs = getattr(compiled, name)(**state), getattr(reference, name)(**state)
            bound = tolerance[name][k].reshape(theirs.shape) + EPS[scalar] / 2 * np.abs(theirs)
            assert np.all(np.abs(ours.astype(float) - theirs) <= bound), (scene.name, name, ours, theirs)
            errors[name] = float(np.linalg.norm(bound))
        a, b = compiled.control(**state), reference.control(**state)
        assert a.info.status == b.info.status, (state, a, b)
        assert a.info.rank == b.info.rank
        S, z = (getattr(reference, name)(**state).astype(float) for name in names[1:])
        y = reference.system(reference.read_inputs(state))[1]["y"]
        solved = np.linalg.norm(tolerance.get(f"{names[1]}_w", tolerance[names[1]])[k])  # what the solver is given
        back = float(np.linalg.norm(tolerance["recover"][k])) if "recover" in tolerance else 0.0
        moved, least = control_bounds(reference, state, S, z, y, b.value, solved, errors[names[2]], back, scalar)
        compared += np.isfinite(moved)
        assert np.linalg.norm(a.value.astype(float) - b.value) <= moved, (scene.name, a, b)
        low = {Path.NORMAL: 0.1, Path.QR: 0.1}.get(a.info.path, 1.0)  # a lower bound there, else the value
        assert low * b.info.sigma_min - least <= a.info.sigma_min <= b.info.sigma_min + least, (scene.name, a, b)
    assert compared > PROVEN.get((scene.name, scalar), 0.9) * STATES


PROVEN = {("iiwa_pose", "float32"): 0.03}
"""The share of states at which the bounds prove anything about tau, where it is not nine tenths. A last joint of 0.001
kg m^2 puts singular values of the weighted pose within 20 times the rounding bound of float32 nearly everywhere; S, z,
status and rank are compared at all states, and tau in float64."""


def quantity_bounds(scene: sg.Scene, scalar: str, drawn: dict[str, Any]) -> dict[str, Any]:
    """name -> (N, size): how far the C and the textbook may drift from the truth, added up.

    The textbook is computed in float64 by other operations than the formulation before optimisation, as many in
    number: with twice that one's bound.
    """
    program = optimised_scene(scene)[1]
    inputs = drawn | {f.name: np.array([f.default]) for f in scene.parameters}
    ours = rounding_bounds(program.program, inputs, scalar)  # type: ignore[arg-type]
    theirs = rounding_bounds(program.exact, inputs, "float64")
    return {n: np.broadcast_to(ours[n] + 2 * theirs[n], (STATES, ours[n].shape[1])) for n in ours if n in theirs}


def control_bounds(
    reference: Any, state: Any, S: Any, z: Any, y: Any, tau: Any,
    S_error: float, z_error: float, back_error: float, scalar: str,
) -> tuple[float, float]:  # fmt: skip
    """How far tau (2-norm) and sigma_min may lie apart where the solver's matrix and z do by S_error and z_error.

    Infinite where the matrix may be singular. Both solvers may err by 8 eps kappa (|tau| + |y|), every check's bar.
    A weight W = L L^T makes S L^-T of S, and L^-T, which may be off by back_error, of the answer tau.
    """
    weight = reference.parts(reference.read_inputs(state)).get("weight")
    L = np.linalg.cholesky(weight) if weight is not None else np.eye(len(tau))
    back = np.linalg.inv(L).T
    matrix, stretch = S @ back, float(np.linalg.norm(back, 2))
    sigma = np.linalg.svd(matrix, compute_uv=False)
    least = S_error + EPS[scalar] / 2 * float(np.linalg.norm(matrix)) + 8 * EPS[scalar] * sigma[0]
    if least > 0.05 * sigma[-1]:
        return np.inf, least
    reach = float(np.linalg.norm(L.T @ tau) + np.linalg.norm(L.T @ y))
    residual = float(np.linalg.norm(z - S @ tau))
    carried = z_error + least * (2 * reach + residual / sigma[-1])
    return stretch * (carried + 16 * EPS[scalar] * sigma[0] * reach) / sigma[-1] + back_error * reach, least


@pytest.mark.parametrize("scalar", ["float64", "float32"])
@pytest.mark.parametrize("name", [n for n in builtin_names() if load_scene(n).kind != "ideal"])  # see test_ideal.py
def test_built_in_scenes(name: str, scalar: str) -> None:
    compare(load_scene(name), scalar)


@pytest.mark.parametrize(
    ("kind", "mass", "scalar"),
    [
        ("nonholonomic", "spd", "float64"),
        ("holonomic", "nonsymmetric", "float64"),
        ("mixed", "indefinite", "float64"),
        ("controls", "exchange", "float64"),
        ("controls", "identity", "float64"),
        ("mixed", "diagonal", "float32"),
        ("nonholonomic", "indefinite", "float32"),
        ("controls", "spd", "float32"),
    ],
)
def test_random_scenes(kind: str, mass: str, scalar: str) -> None:
    """m = 2, l = 3, everything in them, and every way to solve with Q."""
    compare(random_scene(11, kind, mass=mass, y="input"), scalar)


@pytest.mark.parametrize(
    "name", ["y_given", "y_formula", "one_cubic", "square", "columns", "every_operation", "names_c", "tall"]
)
def test_awkward_scenes(name: str) -> None:
    compare(awkward_scenes()[name], "float64")


def test_the_same_bits_at_every_level() -> None:
    """One order of arithmetic, whatever the compiler is allowed to do."""
    package = sg.build(load_scene("spacecraft_smooth"))
    twins = [package.load(flags=["-O0"]), package.load(flags=["-O3"])]
    for state in rows(draw_states(load_scene("spacecraft_smooth"), 200, seed=2)):
        first, second = (t.control(**state) for t in twins)  # type: ignore[union-attr]
        assert first.value.tobytes() == second.value.tobytes()
        assert first.info == second.info


def test_the_comparison_can_fail() -> None:
    """A changed constant in the C is seen."""
    package = sg.build(load_scene("spacecraft"))
    source = package.path / "spacecraft.c"
    source.write_text(mutated(source.read_text(), r"\b0\.5\b", "0.500001"))
    changed, right = package.load(flags=["-O0"]), sg.reference(load_scene("spacecraft"))
    differences = [
        np.abs(changed.phi(**s) - right.phi(**s)).max() + np.abs(changed.B(**s) - right.B(**s)).max()  # type: ignore[union-attr]
        for s in rows(draw_states(load_scene("spacecraft"), 10))
    ]
    assert max(differences) > 1e-9
