"""The default atol of a row: its rounding noise where it vanishes, and 0 where there is none."""

from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.compiler import compile_scene, optimised_scene, target_for
from servogen.ir.evaluate import node_values
from servogen.loading import load_scene
from servogen.results import Status
from servogen.scene.solver import Solver
from servogen.survey import noise

U = 2.0**-53


def scene_of(*rows: Any, domain: Any = None, **options: Any) -> sg.Scene:
    """Velocities psi = S(q) u of a point with unit masses, so that S is the rows as they are written."""
    q, u, tau = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau", 2)
    S = ca.vertcat(*(ca.horzcat(*row(q)) for row in rows))
    mechanism = sg.Mechanism(q=q, u=u, tau=tau, Q=ca.DM.eye(2), P=ca.SX.zeros(2), G=ca.DM.eye(2))
    return sg.Scene("rows", mechanism, [sg.Nonholonomic("v", S @ u, Theta=-1.0)], domain=domain, **options)


def atol(scene: sg.Scene, scalar: str = "float64") -> tuple[float, ...]:
    return compile_scene(scene, target_for(scene.name, scalar, None)).solver.atol  # type: ignore[union-attr, arg-type]


def cosine(q: Any) -> tuple[Any, Any]:
    return ca.cos(q[0]), 0


def test_a_cosine_has_the_noise_of_its_angle() -> None:
    """Half an ulp of pi/2, and the rounding of a value that is zero: between eps and 4 eps."""
    (found,) = atol(scene_of(cosine))
    assert U * np.pi / 2 < found <= 4 * U
    assert np.log2(found) % 1 == 0


@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_where_the_row_vanishes_nothing_is_divided_by_its_noise(scalar: str) -> None:
    scene = scene_of(cosine)
    code, textbook = sg.build(scene, scalar=scalar).load(), sg.reference(scene, scalar)  # type: ignore[arg-type]
    bare = sg.build(scene_of(cosine, solver=sg.Solver(atol=0)), scalar=scalar).load()  # type: ignore[arg-type]
    for q in (np.pi / 2, -np.pi / 2):
        state = {"q": [q, 0.3], "u": [1.0, 2.0]}
        for twin in (code, textbook):
            answer = twin.control(**state)
            assert answer.info.status in (Status.RANK_DEFICIENT_CONSISTENT, Status.RANK_DEFICIENT_INCONSISTENT)
            assert np.all(answer.value == 0)
        assert bare.control(**state).info.status == Status.OK  # by a cosine that is nothing but noise
    near = code.control(q=[np.pi / 2 - 1e-3, 0.3], u=[1.0, 2.0])
    assert near.info.status == Status.OK


def test_a_unit_takes_the_noise_along() -> None:
    plain, scaled = scene_of(cosine), scene_of(lambda q: (ca.cos(q[0]) * 2**20, 0))
    assert atol(scaled)[0] == 2.0**20 * atol(plain)[0]


def test_float32_is_noisier_by_its_epsilon() -> None:
    scene = scene_of(cosine)
    assert atol(scene, "float32")[0] == 2.0**29 * atol(scene)[0]


@pytest.mark.parametrize(
    "row",
    [
        lambda q: (2 + ca.cos(q[0]), q[1]),  # no zero
        lambda q: (q[0], 3 * q[1]),  # relative accuracy down to zero
        lambda q: (q[0] ** 2 * q[1], 0),  # a zero of higher order, likewise
        lambda q: (ca.sin(q[0]), ca.sin(q[1])),  # within (-1, 1) only at 0, where sin is accurate
        lambda q: (1, 0),  # no state at all
    ],
)
def test_without_a_zero_or_without_noise_there_it_is_nought(row: Any) -> None:
    assert atol(scene_of(row, domain={"q": (-1.0, 1.0)})) == (0.0,)


@pytest.mark.parametrize(
    ("row", "expected"),
    [
        (lambda q: (ca.sin(q[0]), ca.sin(q[1])), np.pi),  # at pi, a corner of the domain by default
        (lambda q: (q[0] - 1, q[1] - 2), 2.0),  # the largest entry's noise
        (lambda q: (1 - ca.cos(q[0] - q[1]), 0), 1.0),  # a double zero
        (lambda q: (ca.exp(q[0]) - ca.exp(q[1]), 0), np.exp(np.pi) * np.pi),  # a line of zeros
        (lambda q: (q[0] ** 2 + q[1] ** 2 - 2, 2 * q[0] ** 2 + 2 * q[1] ** 2 - 4), 8.0),  # dependent entries
    ],
)
def test_zeros_of_all_kinds_are_found(row: Any, expected: float) -> None:
    (found,) = atol(scene_of(row))
    assert expected * U < found <= 16 * expected * U


def test_noise_covers_what_rounding_leaves_at_a_zero() -> None:
    """On the line q0 + q1 = pi the row is zero; its entries as float64 computes them are within atol."""
    scene = scene_of(lambda q: (ca.sin(q[0]) - ca.sin(q[1]), ca.cos(q[0]) + ca.cos(q[1])))
    (found,) = atol(scene)
    formulation, optimised = optimised_scene(scene)
    x = np.random.default_rng(0).uniform(0, np.pi, 1000)
    values = node_values(optimised.program, {"q": np.stack([x, np.pi - x], 1), "u": np.ones((1000, 2))})
    entries = np.array([values[n] for n in optimised.program.output(formulation.factorised).nodes])
    largest = np.max(np.abs(entries))
    assert 0 < largest <= found <= 64 * largest


def test_every_row_has_its_own() -> None:
    found = atol(scene_of(cosine, lambda q: (1, ca.cos(q[1]))))
    assert found[0] > 0
    assert found[1] == 0


@pytest.mark.parametrize("given", [0, 0.0, 1e-3])
def test_what_the_user_says_stays(given: float) -> None:
    assert atol(scene_of(cosine, solver=Solver(atol=given))) == (given,)


@pytest.mark.parametrize("name", ["spacecraft", "spacecraft_smooth", "double_pendulum_energy"])
@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_rows_accurate_down_to_rest_are_not_cut_off(name: str, scalar: str) -> None:
    assert atol(load_scene(name), scalar) == (0.0,)


def test_a_domain_by_a_callable_is_a_box_too() -> None:
    def near(generator: np.random.Generator) -> dict[str, Any]:
        return {"q": generator.uniform(0.0, 1.0, 2)}

    def far(generator: np.random.Generator) -> dict[str, Any]:
        return {"q": generator.uniform(0.0, 2.0, 2)}

    assert atol(scene_of(cosine, domain=near)) == (0.0,)
    assert atol(scene_of(cosine, domain=far))[0] > 0


def test_last_bits_of_the_host_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Values and derivatives shaken in their last bits at every step lead to the same numbers."""
    scene = load_scene("quaternion_pointing")
    expected = atol(scene)
    assert atol(scene) == expected
    generator, at = np.random.default_rng(0), noise._Rows.at

    def shaken(self: Any, row: Any, x: Any) -> Any:
        return tuple(v * (1 + 2.0**-51 * generator.uniform(-1, 1, v.shape)) for v in at(self, row, x))

    monkeypatch.setattr(noise._Rows, "at", shaken)
    for _ in range(3):
        noise._zeros.cache_clear()
        assert atol(scene) == expected
    noise._zeros.cache_clear()
