"""Many states at once: what one call after the other gives, bit for bit, however the states and the threads are cut."""

import math
from typing import Any

import numpy as np
import pytest
import servogen as sg
from servogen.loading import load_scene
from servogen.scene.domain import draw_states
from servogen.twins.batch import STATES_FOR_A_THREAD
from support.models import awkward_scenes, random_scene

SCENES = awkward_scenes()
TAU = random_scene(3, "controls", mass="exchange", y=lambda model: -model.mechanism.tau)


def states(scene: sg.Scene, count: int) -> dict[str, Any]:
    """Drawn from the domain; one in seven has a NaN, one in eleven a zero velocity."""
    drawn = {n: np.array(v, dtype=float) for n, v in draw_states(scene, count).items()}
    drawn["u"][::11] = 0.0
    drawn["u"][3::7] = math.nan
    return drawn


def same(one: Any, other: Any) -> bool:
    """Equal bits, NaN among them."""
    return bool(np.asarray(one).tobytes() == np.asarray(other).tobytes())


@pytest.mark.parametrize(
    ("name", "scalar"),
    [("double_pendulum_energy", "float64"), ("columns", "float32"), ("spacecraft_smooth", "float64")],
)
def test_a_batch_is_one_call_after_the_other(name: str, scalar: str) -> None:
    scene = SCENES[name] if name in SCENES else load_scene(name)
    twin = sg.build(scene, scalar=scalar).load(flags=["-O0"])  # type: ignore[arg-type]
    count = 2 * STATES_FOR_A_THREAD + 1
    many = states(scene, count)
    last = np.arange(1.0, scene.controls + 1)
    batches = [twin.control_batch(threads=n, last=last, **many) for n in (1, 2, None)]
    names = [f.name for f in scene.system.functions if not f.controls]
    quantities = {n: getattr(twin, f"{n}_batch")(**many) for n in names}
    refused = 0
    for k in range(count):
        state = {n: v[k] for n, v in many.items()}
        one = twin.control(last=last, **state)
        refused += one.info.status < 0
        assert all(same(one.value, b.value[k]) and one.info == b[k].info for b in batches), k
        assert all(same(getattr(twin, n)(**state), v[k]) for n, v in quantities.items()), k
    assert 0 < refused < count
    assert repr(batches[0]).startswith(f"<Batch of {count} states: NONFINITE*")


def test_project_and_step_by_the_batch() -> None:
    twin = sg.build(TAU).load(flags=["-O0"])
    many = states(TAU, 30)
    for name, dt in (("project", ()), ("step", (1e-3,))):
        batch = getattr(twin, f"{name}_batch")(*dt, **many)
        for k in range(30):
            one = getattr(twin, name)(*dt, **{n: v[k] for n, v in many.items()})
            assert same(one.value, batch.value[k])
            assert one.info == batch[k].info


def test_the_reference_takes_batches_as_well() -> None:
    scene = SCENES["columns"]
    given = {"u": states(scene, 12)["u"], "k": np.linspace([1.0, 0.5, 0.0], [-2.0, 0.1, 3.0], 12)}
    batches = [twin.control_batch(**given) for twin in (sg.build(scene).load(flags=["-O0"]), sg.reference(scene))]
    np.testing.assert_array_equal(batches[0].status, batches[1].status)
    np.testing.assert_array_equal(batches[0].rank, batches[1].rank)
    np.testing.assert_allclose(batches[0].value, batches[1].value, rtol=1e-12, atol=1e-15)


def test_parameters_of_each_state_hold_for_the_call_alone() -> None:
    scene = load_scene("double_pendulum_energy")
    first = next(iter(scene.parameters)).name
    for twin in (sg.build(scene).load(flags=["-O0"]), sg.reference(scene)):
        state = {n: v[0] for n, v in draw_states(scene, 1).items()}
        twin.prepare(g=3.7)
        kept = twin.control(**state)
        masses = np.array([1.0, 2.5, math.nan, 4.0])
        batch = twin.control_batch(**state, **{first: masses}, last=[7.0, 8.0])
        assert batch.status.tolist() == [0, 0, sg.Status.NONFINITE, 0]
        assert batch.value[2].tolist() == [7.0, 8.0]
        assert batch[2].info == sg.Info(sg.Status.NONFINITE, sg.Path.NONE, 0, 0, 0.0, 0.0)
        quantity = twin.S_batch(**state, **{first: masses})
        assert np.isnan(quantity[2]).all()
        assert same(twin.control(**state).value, kept.value)  # the twin's own parameters are as they were
        for k in (0, 1, 3):
            twin.prepare(g=3.7, **{first: masses[k]})
            assert same(twin.control(**state).value, batch.value[k])
            assert same(twin.S(**state), quantity[k])


def test_arrays_are_read_where_they_are_and_as_they_are() -> None:
    """Rows apart, columns apart, another type, shared by all, a number: the same states."""
    scene = load_scene("double_pendulum_energy")
    twin = sg.build(scene).load(flags=["-O0"])
    q, u = draw_states(scene, 5)["q"], np.array([0.5, -0.25])
    expected = twin.control_batch(q=np.ascontiguousarray(q), u=np.tile(u, (5, 1)), E_0=np.full(5, 0.5))
    wide = np.full((5, 7), math.nan)
    wide[:, 2:4] = q
    for given in (wide[:, 2:4], np.asfortranarray(q), q.tolist()):
        assert same(twin.control_batch(q=given, u=u, E_0=0.5).value, expected.value)
    halves = np.round(q * 64) / 64
    narrow = twin.control_batch(q=halves.astype(np.float32), u=u)
    assert same(narrow.value, twin.control_batch(q=halves, u=u).value)
    assert len(twin.control_batch(q=q[:0], u=u)) == 0
    assert len(twin.control_batch(q=q[0], u=u)) == 1


def test_a_batch_left_in_the_folder_is_not_the_packages(tmp_path) -> None:
    """An earlier package, of another shape, was made with batch; this one is not."""
    sg.build_solver(1, 2, tmp_path, prefix="p", batch=True)
    twin = sg.build_solver(1, 3, tmp_path, prefix="p").load(flags=["-O0"])
    tau, _ = twin.solve([[[1.0, 2.0, 2.0]], [[0.0, 0.0, 2.0]]], [[9.0], [1.0]])
    np.testing.assert_allclose(tau, [[1.0, 2.0, 2.0], [0.0, 0.0, 0.5]], rtol=1e-15)


def test_what_is_wrong_with_a_batch_is_told() -> None:
    scene = load_scene("double_pendulum_energy")
    for twin in (sg.build(scene).load(flags=["-O0"]), sg.reference(scene)):
        good = {"q": np.zeros((3, 2)), "u": np.ones((3, 2))}
        with pytest.raises(TypeError, match="control_batch: no input or parameter 'speed'; there are q, u"):
            twin.control_batch(**good, speed=1.0)
        with pytest.raises(TypeError, match=r"control: u \(.*\) of scene 'double_pendulum_energy' is left out"):
            twin.control_batch(q=good["q"])
        with pytest.raises(ValueError, match=r"q has shape \(3, 3\); give \(2,\), or \(N, 2\) for N states"):
            twin.control_batch(q=np.zeros((3, 3)), u=good["u"])
        with pytest.raises(ValueError, match="q has 3 states and u has 4; give one number of them"):
            twin.S_batch(q=good["q"], u=np.ones((4, 2)))
        with pytest.raises(ValueError, match=r"u: give numbers of shape \(2,\), or \(N, 2\)"):
            twin.control_batch(q=good["q"], u="fast")
        with pytest.raises(ValueError, match=r"u: give numbers of shape \(2,\), or \(N, 2\)"):
            twin.control_batch(q=good["q"], u=good["u"] + 1j)
        for threads in (0, -1, 2.5, "2", True):
            for function in (twin.control_batch, twin.S_batch):
                with pytest.raises(ValueError, match=f"threads={threads!r}: give a whole number from 1, or None"):
                    function(**good, threads=threads)
        with pytest.raises(ValueError, match=r"last has shape \(3,\); it must have \(2,\) or \(3, 2\)"):
            twin.control_batch(**good, last=np.zeros(3))
        with pytest.raises(AttributeError, match="has no A"):
            twin.A_batch(**good)
