"""The twins' contract: keywords, shapes, prepare, last, and what a negative status leaves alone."""

import ctypes as ct
import math
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.loading import builtin_names, load_scene
from servogen.scene.domain import draw_states
from support.models import awkward_scenes, random_scene

SCENES = awkward_scenes()
_LOADED: dict[tuple[str, str], Any] = {}


def loaded(scene: sg.Scene, scalar: str = "float64") -> Any:
    """The compiled twin with its parameters' defaults, compiled once."""
    key = (scene.name, scalar)
    if key not in _LOADED:
        _LOADED[key] = sg.build(scene, scalar=scalar).load(flags=["-O0"])  # type: ignore[arg-type]
    _LOADED[key].prepare()
    return _LOADED[key]


def both(scene: sg.Scene, scalar: str = "float64") -> list[Any]:
    return [loaded(scene, scalar), sg.reference(scene, scalar)]  # type: ignore[arg-type]


def a_state(scene: sg.Scene, seed: int = 0) -> dict[str, Any]:
    return {name: values[0] for name, values in draw_states(scene, 1, seed).items()}


FULL = random_scene(3, "mixed", y="input")
TAU = random_scene(3, "controls", mass="exchange", y=lambda model: -model.mechanism.tau)


# ---- keywords ----


def test_known_but_unused_keywords_are_accepted() -> None:
    for twin in both(SCENES["plain"]):
        base = twin.control(q=[0.1, 0.2], u=[1.0, 2.0])
        more = twin.control(q=[0.1, 0.2], u=[1.0, 2.0], t=3.0, tau=[1.0, 1.0], y=[5.0, 5.0])
        assert np.array_equal(base.value, more.value)
        assert twin.S(q=[0, 0], u=[0, 0], t=1, y=[0, 0]).shape == (1, 2)
    for twin in both(SCENES["unused"]):
        assert twin.control(q=[0, 0], u=[1, 0], r=0.5).info.status == sg.Status.OK


def test_unknown_keywords_are_type_errors() -> None:
    for twin in both(SCENES["columns"]):
        for call in (twin.control, twin.S, twin.z, twin.psi):
            with pytest.raises(TypeError, match="no input 'speed'; scene 'columns' knows q, u, t"):
                call(speed=1.0)
            with pytest.raises(TypeError, match="no input 'k'"):
                call(k=[1.0, 1.0, 1.0])  # a parameter is for prepare
        with pytest.raises(TypeError, match="prepare: no parameter 'q'; there are k, spare, c0"):
            twin.prepare(q=[0.0, 0.0])


def test_wrong_sizes_are_value_errors() -> None:
    for twin in both(SCENES["columns"]):
        for wrong in ({"q": [1.0]}, {"u": 1.0}, {"t": [1.0, 2.0]}, {"c1": [1.0, 2.0, 3.0]}, {"tau": [1.0]}, {"y": 1.0}):
            with pytest.raises(ValueError, match=f"{next(iter(wrong))} has . entries; it must have"):
                twin.control(**wrong)
        for bad in (None, "x", [None, "x"], ca.SX.sym("x", 2)):
            with pytest.raises(ValueError, match=r"u = .*; give 2 numbers"):
                twin.control(u=bad)
        with pytest.raises(ValueError, match="k has 1 entries; it must have 3"):
            twin.prepare(k=1.0)
        with pytest.raises(ValueError, match="last has 3 entries"):
            twin.control(u=[0.0, 0.0], last=[0.0] * 3)
        with pytest.raises(ValueError, match=r"pinv: the matrix has shape \(3, 3\)"):
            twin.pinv(np.eye(3))


def test_what_is_left_out_takes_its_default() -> None:
    for twin in both(SCENES["columns"]):
        full = twin.control(q=[0, 0], u=[0, 0], t=0.0, c0_r=1.0, c1=[0.0, 1.0], c1_dot=[0.0, 0.0])
        assert np.array_equal(twin.control(u=[0, 0]).value, full.value)
        moved = twin.control(u=[0, 0], c0_r=2.0).value
        assert not np.array_equal(moved, full.value)
        assert np.array_equal(twin.control(u=[0, 0], c1=[0.0, 1.0]).value, full.value)


def test_a_state_that_is_left_out_is_a_type_error() -> None:
    """tau of zeros at a state that nobody meant; but only where the function has a use for it."""
    for twin in both(SCENES["plain"]):  # u_0 + q_1
        for call in (twin.control, twin.S, twin.z, twin.psi):
            with pytest.raises(
                TypeError, match=rf"{call.__name__}: q \(q_0, q_1\) and u \(u_0, u_1\) of scene 'plain'"
            ):
                call()
            with pytest.raises(TypeError, match=r"u \(u_0, u_1\) of scene 'plain' is left out; give every state"):
                call(q=[0, 0])
    q, u, tau = ca.SX.sym("q"), ca.SX.sym("u"), ca.SX.sym("tau")
    place = sg.Scene("place", sg.Mechanism(q=q, u=u, tau=tau, Q=1, P=0, G=1), [sg.Holonomic("at", q, -2.0, -1.0)])
    for twin in both(place):
        assert twin.psi(q=2.0) == 2.0  # psi of q alone
        with pytest.raises(TypeError, match=r"z: u \(u\)"):  # psi' is u
            twin.z(q=2.0)
    for twin in both(load_scene("spacecraft")):
        with pytest.raises(TypeError, match="step: u"):
            twin.step(0.1, tau=[0, 0, 0])


def test_numbers_lists_columns_and_integers() -> None:
    for twin in both(SCENES["one"]):
        values = [
            twin.control(q=q, u=2, y=0).value for q in (1, 1.0, [1.0], np.array([[1.0]]), np.float32(1), ca.DM(1))
        ]
        assert all(np.array_equal(v, values[0]) for v in values)
        assert values[0].shape == (1,)


def test_functions_of_the_other_kind_are_attribute_errors() -> None:
    for twin in both(SCENES["plain"]):
        for name in ("A", "B", "phi", "project", "step"):
            with pytest.raises(AttributeError):
                getattr(twin, name)
    for twin in both(SCENES["one_control"]):
        for name in ("S", "z", "psi"):
            with pytest.raises(AttributeError, match=f"scene 'one_control' has no {name}"):
                getattr(twin, name)


# ---- shapes ----


@pytest.mark.parametrize(("scene", "names"), [(FULL, "S z psi"), (TAU, "A B phi")], ids=["servo", "controls"])
def test_shapes_and_types(scene: sg.Scene, names: str) -> None:
    matrix, *columns = names.split()
    for scalar in ("float64", "float32"):
        for twin in both(scene, scalar):
            state = a_state(scene)
            assert getattr(twin, matrix)(**state).shape == (2, 3)
            for name in columns:
                assert getattr(twin, name)(**state).shape == (2,)
            inverse = twin.pinv(np.arange(6.0).reshape(2, 3))
            assert inverse.shape == (3, 2)
            answer = twin.control(**state)
            assert answer.value.shape == (3,)
            for value in (getattr(twin, matrix)(**state), inverse, answer.value):
                assert value.dtype == np.dtype(scalar)
            assert isinstance(answer.info.status, sg.Status)
            assert isinstance(answer.info.path, sg.Path)
            assert answer.info.rank == 2


def test_row_major_matrices_reach_python_as_they_are() -> None:
    state = a_state(FULL)
    np.testing.assert_allclose(loaded(FULL).S(**state), sg.reference(FULL).S(**state), rtol=1e-10)


# ---- prepare ----


def test_prepare_sets_and_resets() -> None:
    scene, state = SCENES["columns"], {"u": [1.0, 1.0], "t": 0.5}
    first, second = both(scene)
    for k in ([1.0, 0.5, 0.0], [-2.0, 0.1, 3.0]):
        assert first.prepare(k=k) == sg.Status.OK
        assert second.prepare(k=k) == sg.Status.OK
        np.testing.assert_allclose(first.z(**state), second.z(**state), rtol=1e-13)
        np.testing.assert_allclose(first.S(**state), second.S(**state), rtol=1e-13)
    default = sg.reference(scene).z(**state)
    for twin in (first, second):
        twin.prepare(c0=1.0)  # k goes back to its default
        twin.prepare()
        np.testing.assert_allclose(twin.z(**state), default, rtol=1e-13)


@pytest.mark.parametrize("name", ["double_pendulum_energy", "spacecraft_smooth", "columns"])
@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_a_parameter_that_is_not_finite_leaves_the_model(name: str, scalar: str) -> None:
    scene = SCENES[name] if name in SCENES else load_scene(name)
    for twin in both(scene, scalar):
        state = a_state(scene)
        before = twin.control(**state).value
        for f in scene.parameters or ():
            for bad in (math.nan, math.inf, -math.inf):
                for k in range(f.size):
                    value = list(f.default)
                    value[k] = bad
                    assert twin.prepare(**{f.name: value}) == sg.Status.NONFINITE, (f.name, k)
        assert np.array_equal(twin.control(**state).value, before)


def test_a_model_that_overflows_is_left() -> None:
    scene = SCENES["constant_of_parameters"]
    twin = loaded(scene)
    before = twin.control(u=[1.0, 0.0]).value
    assert twin.prepare(a=1e200) == sg.Status.OVERFLOW  # 1 + a^2
    assert np.array_equal(twin.control(u=[1.0, 0.0]).value, before)


def test_a_parameter_beyond_float32_is_not_finite() -> None:
    for twin in both(load_scene("spacecraft"), "float32"):
        assert twin.prepare(I_1=1e39) == sg.Status.NONFINITE


# ---- last, and outputs that stay as they were ----


@pytest.mark.parametrize("name", [*builtin_names(), "everything", "everything_tau", "columns", "y_given", "one_cubic"])
def test_an_input_that_is_not_finite_leaves_every_output(name: str) -> None:
    """Every entry point, every entry of every input, NaN and both infinities, through ctypes: no byte changes."""
    scene = SCENES[name] if name in SCENES else load_scene(name)
    twin = loaded(scene)
    state, last = a_state(scene), np.arange(1.0, scene.controls + 1)
    reference = sg.reference(scene)
    solving = ["control"] + (["project", "step"] if scene.kind == "controls" else [])
    levels = [0] * len(scene.levels) if scene.cascaded else []
    nothing = sg.Info(sg.Status.NONFINITE, sg.Path.NONE, 0, 0, 0.0, 0.0, level_rank=levels, level_residual=levels)
    for f in twin._module.inputs:
        for k in range(f.size):
            for bad in (math.nan, math.inf, -math.inf):
                value = np.array(state[f.name], dtype=float)
                value[k] = bad
                inputs = twin.read_inputs(state | {f.name: value})
                for entry in twin._entries:
                    status, outputs = twin.evaluate(entry, inputs)
                    assert status == sg.Status.NONFINITE, (entry, f.name)
                    assert all(np.isnan(o).all() for o in outputs)
                for entry in solving:
                    extra = (0.01,) if entry == "step" else ()
                    answer = getattr(twin, entry)(*extra, **inputs, last=last)
                    assert answer.info == nothing
                    assert np.array_equal(answer.value, last)
                    other = getattr(reference, entry)(*extra, **inputs, last=last)
                    assert other.info.status == sg.Status.NONFINITE, (entry, f.name)
                    assert np.array_equal(other.value, last)


def test_last_defaults_to_zeros_and_is_not_written_to() -> None:
    for twin in both(SCENES["plain"]):
        last = np.array([3.0, 4.0])
        assert twin.control(q=[math.nan, 0], u=[0, 0]).value.tolist() == [0.0, 0.0]
        kept = twin.control(q=[math.nan, 0], u=[0, 0], last=last)
        kept.value[0] = 99.0
        assert last.tolist() == [3.0, 4.0]
        good = twin.control(q=[0, 0], u=[1.0, 0.0], last=last)
        assert good.info.status == sg.Status.OK
        assert not np.array_equal(good.value, last)


def test_overflow_leaves_the_outputs() -> None:
    scene = load_scene("double_pendulum_energy")
    for scalar, huge in (("float64", 1e200), ("float32", 1e30)):
        for twin in both(scene, scalar):
            answer = twin.control(q=[0.3, 0.2], u=[huge, 1.0], last=[1.0, 2.0])
            assert answer.info.status == sg.Status.OVERFLOW
            assert answer.value.tolist() == [1.0, 2.0]
            assert np.isnan(twin.z(q=[0.3, 0.2], u=[huge, 1.0])).all()
            assert np.isfinite(twin.S(q=[0.3, 0.2], u=[1.0, 1.0])).all()


def test_each_entry_point_has_a_status_of_its_own() -> None:
    """psi overflows and S does not: S is answered."""
    scene = SCENES["every_operation"]
    state = {"q": [1.0, 2.0], "u": [1e308, 0.0]}
    for twin in both(load_scene("double_pendulum_energy")):
        assert np.isnan(twin.psi(q=[0, 0], u=[1e200, 0])).all()
        assert np.isfinite(twin.S(q=[0, 0], u=[1e200, 0])).all()
    assert np.isfinite(loaded(scene).psi(**state)).all()


def test_control_with_null_info_and_outputs_over_inputs() -> None:
    """info may be NULL, and outputs may be the same memory as inputs."""
    scene = load_scene("double_pendulum_energy")
    twin = loaded(scene)
    state = a_state(scene)
    layout = type("input", (ct.Structure,), {"_fields_": [(f.name, ct.c_double * f.size) for f in twin._module.inputs]})
    struct = layout.from_buffer_copy(twin._read(state, "control"))
    expected = twin.control(**state).value
    out = (ct.c_double * 2)()
    assert twin._function("control")(ct.byref(twin._model), ct.byref(struct), out, None) == 0
    assert list(out) == list(expected)
    S, z = twin.S(**state).ravel(), twin.z(**state)
    at = ct.addressof(struct)
    offset = layout.u.offset
    status = twin._function("S_z")(ct.byref(twin._model), ct.byref(struct), ct.c_void_p(at), ct.c_void_p(at + offset))
    assert status == 0
    assert list(struct.q) == list(S)
    assert struct.u[0] == z[0]
    struct = layout.from_buffer_copy(twin._read(state, "control"))
    assert twin._function("control")(ct.byref(twin._model), ct.byref(struct), ct.byref(struct), None) == 0
    assert list(struct.q) == list(expected)


# ---- at rest ----


@pytest.mark.parametrize("name", ["double_pendulum_energy", "spacecraft", "spacecraft_smooth"])
@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_at_rest_the_answer_is_finite_and_the_rank_zero(name: str, scalar: str) -> None:
    scene = load_scene(name)
    for twin in both(scene, scalar):
        state = a_state(scene) | {"u": np.zeros(scene.mechanism.u.size1())}
        answer = twin.control(**state)
        assert np.isfinite(answer.value).all()
        assert answer.info.rank == 0
        assert answer.info.status in (sg.Status.RANK_DEFICIENT_CONSISTENT, sg.Status.RANK_DEFICIENT_INCONSISTENT)
        matrix = twin.S(**state) if scene.kind == "servo" else twin.A(**state)
        assert not matrix.any()
        y = -state["tau"] if name == "spacecraft_smooth" else np.zeros(scene.controls)
        np.testing.assert_allclose(answer.value, y, rtol=1e-6)


# ---- project and step ----


def test_project_meets_the_constraint() -> None:
    for scene in (load_scene("spacecraft"), SCENES["one_cubic"], SCENES["one_control"], SCENES["everything_tau"]):
        for seed in range(5):
            state = a_state(scene, seed)
            answers = []
            for twin in both(scene):
                answer = twin.project(**state)
                if answer.info.status == sg.Status.NOT_CONVERGED:
                    continue
                assert answer.info.status == sg.Status.OK
                assert np.abs(twin.phi(**(state | {"tau": answer.value}))).max() < 1e-9
                answers.append(answer.value)
            if scene.name != "everything_tau":  # quadratic: phi = 0 may have no solution, and Newton's method no end
                assert len(answers) == 2
            if len(answers) == 2:
                np.testing.assert_allclose(*answers, rtol=1e-9, atol=1e-12)


def test_project_onto_zero_from_afar() -> None:
    """tau = 0 is the answer: convergence is judged where the numbers are, not where they went."""
    q, u, tau = ca.SX.sym("q"), ca.SX.sym("u"), ca.SX.sym("tau")
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=1.0, P=0.0, G=1.0)
    scene = sg.Scene("to_zero", mech, [sg.ControlsInvolved("law", tau + 0.3 * tau**3 + 0.1 * tau**2, -1.0)])
    for twin in both(scene):
        for start in (0.3, 0.7, 1.0, 1.7, -0.9):
            answer = twin.project(tau=start)
            assert answer.info.status == sg.Status.OK
            assert abs(answer.value[0]) < 1e-15


def test_step_is_control_then_project() -> None:
    scene = load_scene("spacecraft_smooth")
    state = a_state(scene) | {"tau": [0.1, -0.2, 0.3]}
    for twin in both(scene):
        rate = twin.control(**state).value
        moved = twin.project(**(state | {"tau": np.array(state["tau"]) + 0.01 * rate}))
        stepped = twin.step(0.01, **state)
        np.testing.assert_allclose(stepped.value, moved.value, rtol=1e-14)
        for dt in (math.nan, math.inf):
            bad = twin.step(dt, **state, last=[1.0, 2.0, 3.0])
            assert bad.info.status == sg.Status.NONFINITE
            assert bad.value.tolist() == [1.0, 2.0, 3.0]
        far = twin.step(1e308, **(state | {"tau": [1e10, 1e10, 1e10]}), last=[1.0, 2.0, 3.0])
        assert far.info.status == sg.Status.OVERFLOW
        assert far.value.tolist() == [1.0, 2.0, 3.0]


def test_a_finite_system_that_overflows_inside_the_solver_is_an_overflow() -> None:
    """With a weight, S W^-1/2 and its product with y are the twins' own affair: both say OVERFLOW, never NONFINITE."""
    q, u, tau = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau", 3)
    G = ca.vertcat(ca.horzcat(1, q[0], 0), ca.horzcat(0, 1, q[1]))
    mechanism = sg.Mechanism(q=q, u=u, tau=tau, Q=ca.SX.eye(2), P=-q, G=G)
    weight = ca.DM([[2, 0.1, 0], [0.1, 3, 0.2], [0, 0.2, 1]])
    scene = sg.Scene("huge", mechanism, [sg.Nonholonomic("still", u, Theta=-1.0)], y="input", weight=weight)
    for twin in both(scene):
        answer = twin.control(q=[1.0, np.finfo(float).max], u=[0, 0], y=[0, 0, 0], last=[1.0, 2.0, 3.0])
        assert answer.info.status == sg.Status.OVERFLOW
        assert answer.value.tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("wrong", [{"J": -0.6}, {"m": -3.0}, {"J": 0.0}])
def test_a_parameter_that_makes_Q_indefinite_is_refused(wrong: dict[str, float]) -> None:
    """Q = diag(m, J) is positive over the domain; a negative inertia would answer with torques of the wrong sign."""
    q, u, tau = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau", 2)
    p = sg.Parameters(m=sg.Parameter(12.0), J=sg.Parameter(0.6))
    mechanism = sg.Mechanism(q=q, u=u, tau=tau, Q=ca.diag(ca.vertcat(p.m, p.J)), P=-u, G=ca.SX.eye(2))
    scene = sg.Scene("robot", mechanism, [sg.Nonholonomic("still", u, Theta=-1.0)], parameters=p)
    for twin in both(scene):
        before = twin.control(q=[0, 0], u=[1.0, 2.0]).value
        assert twin.prepare(**wrong) == sg.Status.SINGULAR_MASS
        assert np.array_equal(twin.control(q=[0, 0], u=[1.0, 2.0]).value, before)
