"""The compiled C against the reference, which shares neither derivation nor optimiser nor solver with it."""

from typing import Any

import numpy as np
import pytest
import servogen as sg
from servogen.loading import builtin_names, load_scene
from servogen.scene.domain import draw_states
from support.models import awkward_scenes, random_scene

STATES = 30
EPS = {"float64": 2.0**-52, "float32": 2.0**-23}


def rows(states: dict[str, Any]) -> list[dict[str, Any]]:
    count = len(next(iter(states.values())))
    return [{name: values[k] for name, values in states.items()} for k in range(count)]


def compare(scene: sg.Scene, scalar: str, loose: float) -> None:
    """Quantities within `loose` units of their size; tau within the same times the condition of the matrix."""
    compiled = sg.build(scene, scalar=scalar).load(flags=["-O0"])  # type: ignore[arg-type]
    reference = sg.reference(scene, scalar)  # type: ignore[arg-type]
    names = ("psi", "S", "z") if scene.kind == "servo" else ("phi", "A", "B")
    scale = {n: max(np.abs(getattr(reference, n)(**s)).max() for s in rows(draw_states(scene, 8, 1))) for n in names}
    for state in rows(draw_states(scene, STATES, seed=5)):
        for name in names:
            ours, theirs = getattr(compiled, name)(**state), getattr(reference, name)(**state)
            bound = loose * EPS[scalar] * (np.abs(theirs).max() + scale[name])
            assert np.abs(ours.astype(float) - theirs).max() <= bound, (scene.name, name, ours, theirs)
        a, b = compiled.control(**state), reference.control(**state)
        assert a.info.status == b.info.status, (state, a, b)
        assert a.info.rank == b.info.rank
        matrix = getattr(reference, names[1])(**state).astype(float)
        sigma = np.linalg.svd(matrix, compute_uv=False)
        kappa = sigma[0] / sigma[-1] if sigma[-1] > 0 else np.inf
        right = scale[names[2]] / sigma[-1] if sigma[-1] > 0 else np.inf
        bound = loose * EPS[scalar] * kappa * (np.linalg.norm(b.value) + right)
        assert np.abs(a.value.astype(float) - b.value).max() <= bound, (scene.name, a, b)
        np.testing.assert_allclose(a.info.sigma_min, b.info.sigma_min, rtol=loose * 10 * EPS[scalar] * kappa)


@pytest.mark.parametrize("scalar", ["float64", "float32"])
@pytest.mark.parametrize("name", [n for n in builtin_names() if load_scene(n).kind != "ideal"])  # see test_ideal.py
def test_built_in_scenes(name: str, scalar: str) -> None:
    compare(load_scene(name), scalar, loose=200)


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
    compare(random_scene(11, kind, mass=mass, y="input"), scalar, loose=4000)


@pytest.mark.parametrize(
    "name", ["y_given", "y_formula", "one_cubic", "square", "columns", "every_operation", "names_c", "tall"]
)
def test_awkward_scenes(name: str) -> None:
    compare(awkward_scenes()[name], "float64", loose=500)


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
    text = source.read_text()
    assert "0.5" in text
    source.write_text(text.replace("0.5", "0.500001", 1))
    changed, right = package.load(flags=["-O0"]), sg.reference(load_scene("spacecraft"))
    differences = [
        np.abs(changed.phi(**s) - right.phi(**s)).max() + np.abs(changed.B(**s) - right.B(**s)).max()  # type: ignore[union-attr]
        for s in rows(draw_states(load_scene("spacecraft"), 10))
    ]
    assert max(differences) > 1e-9
