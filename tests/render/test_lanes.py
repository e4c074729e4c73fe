"""Vectors of states: the bits of the scalar code in every lane, whatever stands in the others."""

import math
import subprocess
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.loading import load_scene
from servogen.scene.domain import draw_states
from support.models import awkward_scenes

SCENES = awkward_scenes()
COUNT = 515
"""No multiple of any number of lanes."""


def branching() -> sg.Scene:
    """Operations that vectors lack, angles far away, a y of the caller and a mass that can be singular."""
    q, u, tau = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau", 2)
    Q = ca.diag(ca.vertcat(1 + ca.sin(q[0]) ** 2, q[1]))
    P = ca.vertcat(ca.if_else(u[0] > 0, ca.atan2(u[1], u[0]), ca.fabs(u[1])), ca.fmin(u[0], ca.sqrt(1 + u[1] ** 2)))
    mechanism = sg.Mechanism(q, u, tau, Q, P, ca.SX.eye(2))
    domain = {"q": ([-3.0, 0.5], [3.0, 2.0]), "u": (-1.0, 1.0)}
    return sg.Scene("branching", mechanism, [sg.Nonholonomic("speed", u[0] * u[1], -1.0)], y="input", domain=domain)


def states(scene: sg.Scene) -> dict[str, Any]:
    """Drawn from the domain; a NaN, an infinity, zeros of both signs, multiples of pi/2, far angles, huge numbers."""
    drawn = {n: np.array(v, dtype=float) for n, v in draw_states(scene, COUNT).items()}
    q, u = drawn["q"], drawn["u"]
    q[3, 0], u[6, 0], q[10, -1], q[13], u[13] = math.nan, math.inf, 0.0, 0.0, 0.0
    q[21, 0], q[22, 0], q[23, 0], q[29] = math.pi / 2, 1e5 * math.pi, 3e6, -0.0
    u[31], u[37], u[41, 0] = 0.0, 1e200, 1e-310
    return drawn


@pytest.mark.parametrize(
    ("scene", "scalar"),
    [
        (branching(), "float64"),
        (load_scene("planar_arm_3r_weighted"), "float32"),
        (load_scene("unicycle_path"), "float64"),
        (SCENES["columns"], "float64"),
    ],
    ids=lambda x: getattr(x, "name", x),
)
def test_a_lane_has_the_bits_of_one_state_alone(scene: sg.Scene, scalar: str) -> None:
    given = states(scene)
    one = sg.build(scene, scalar=scalar).load(flags=["-O1"]).control_batch(**given)  # type: ignore[arg-type]
    package = sg.build(scene, scalar=scalar, batch=True)  # type: ignore[arg-type]
    assert ("_lane_answer(" in (package.path / f"{package.prefix}_batch.c").read_text()) == (scene.name != "columns")
    many = package.load(flags=["-O1"]).control_batch(**given)
    assert (one.status < 0).any()
    assert (one.status >= 0).any()
    for name in ("value", "status", "path", "rank", "sweeps", "sigma_min", "residual"):
        assert getattr(one, name).tobytes() == getattr(many, name).tobytes(), name


@pytest.mark.parametrize(
    ("m", "l", "scalar", "method"),
    [(2, 5, "float64", "auto"), (3, 3, "float32", "auto"), (1, 4, "float64", "auto"), (2, 3, "float64", "cod")],
)
def test_solves_in_lanes(m: int, l: int, scalar: str, method: str) -> None:
    rng = np.random.default_rng(1)
    S, z, y = rng.normal(size=(COUNT, m, l)), rng.normal(size=(COUNT, m)), rng.normal(size=(COUNT, l))
    S[3], S[5, 0, 0], S[8, -1], z[11], y[17, 0], S[21] = 0.0, math.nan, S[8, 0] * (1 + 1e-9), 0.0, math.inf, 1e-30
    solver = sg.Solver(method=method)  # type: ignore[arg-type]
    packages = [sg.build_solver(m, l, scalar=scalar, solver=solver, batch=b) for b in (False, True)]  # type: ignore[arg-type]
    twins = [package.load(flags=["-O1"]) for package in packages]
    for free in (None, y):
        (one, told), (many, told_many) = (twin.solve(S, z, free) for twin in twins)
        assert one.tobytes() == many.tobytes()
        assert {int(s) for s in told.status} > {0}
        for name in ("status", "path", "rank", "sweeps", "sigma_min", "residual"):
            assert getattr(told, name).tobytes() == getattr(told_many, name).tobytes(), name


def test_nothing_is_fused_where_the_machine_could() -> None:
    """A product and a sum stay two roundings though the compiler's flags would have them fused."""
    scene = load_scene("unicycle_path")
    given = draw_states(scene, COUNT)
    one = sg.build(scene).load(flags=["-O1"]).control_batch(**given)
    fused = sg.build(scene, batch=True).load(flags=["-O2", "-ffp-contract=fast"]).control_batch(**given)
    fits = slice(COUNT - COUNT % 16)  # the rest is left to the scalar code, which is compiled as the flags say
    assert (one.status[fits] == 0).all()
    assert one.value[fits].tobytes() == fused.value[fits].tobytes()


@pytest.mark.parametrize("compiler", ["gcc", "clang", "g++"])
def test_strict_flags(compiler: str, tmp_path, need_tool) -> None:
    need_tool(compiler, compiler)
    package = sg.build(branching(), tmp_path, scalar="float32", batch=True)
    name = "branching_f32_batch"
    flags = ["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O1"]
    if compiler == "g++":
        source = tmp_path / "user.cpp"
        source.write_text(f'#include "{name}.h"\nint main() {{ return 0; }}\n')
    else:
        source = package.path / f"{name}.c"
        flags += ["-std=c99", "-Wconversion", "-Wdouble-promotion", "-Wmissing-prototypes", "-Wshadow"]
    done = subprocess.run(
        [compiler, *flags, f"-I{tmp_path}", "-c", source, "-o", tmp_path / "x.o"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_what_is_not_built_says_so() -> None:
    with pytest.raises(sg.SceneError, match="batch or limits"):
        sg.build_solver(2, 3, limits=True, batch=True)
    with pytest.raises(sg.SceneError, match="add it to entry_points"):
        sg.build(load_scene("unicycle_path"), entry_points=["S"], batch=True)
