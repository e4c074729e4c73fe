"""The benchmark sees planted errors, silent NaN and slow code, and gives everyone the same states."""

import dataclasses
import math
import re
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from servogen.bench.contenders import casadi_c, numpy_pinv, servogen_c
from servogen.bench.plot import _NARROW, _WIDE, _labels, _spread, draw, pareto
from servogen.bench.results import Output
from servogen.bench.run import bench
from servogen.bench.user import expressions, function
from servogen.loading import load_scene
from servogen.scene.domain import draw_states
from support.loops import random_mechanism
from support.mutate import mutated

SCENE = load_scene("double_pendulum_energy")
BASELINE = "CasADi cse"


def altered(contender, name, pattern, new):
    """The same contender under another name, its kernel edited; a prefix of its own keeps the copies apart."""
    hit = {f: mutated(f.text, pattern, new) for f in contender.files if re.search(pattern, f.text)}
    assert hit, f"{pattern!r} matches nothing in {name}"
    files = tuple(dataclasses.replace(f, text=hit.get(f, f.text)) for f in contender.files)
    return dataclasses.replace(contender, name=name, files=files)


def run(contenders, **options):
    return bench(
        SCENE,
        **{"rounds": 3, "states": 64, "count_instructions": False} | options,
        contenders=contenders,
    )


def rivals(old, new):
    def choose(scene, inputs, capacity):
        ours = servogen_c(scene, inputs, capacity, "float64")
        return altered(ours, "altered", old, new), casadi_c(scene, inputs, capacity, BASELINE, cse=True)

    return choose


def test_a_planted_error_is_measured():
    result = run(rivals(r"\bS\[0\] = ([^;]+);", r"S[0] = \1 + 1e-9;"))
    assert result.of("altered", Output.MATRIX).errors.largest == pytest.approx(1e-9, rel=1e-3)
    assert result.of("altered", Output.RIGHT).errors.largest_ulps < 20
    assert result.of(BASELINE, Output.MATRIX).errors.largest_ulps < 20


def test_a_silent_nan_is_an_infinite_error():
    result = run(rivals(r"\btau\[0\] = [^;]+;", "tau[0] = (double)NAN;"))  # behind all checks, with a good status
    broken = result.of("altered", Output.ANSWER).errors
    assert broken.nonfinite > 0
    assert math.isinf(broken.largest)
    assert result.of("altered", Output.MATRIX).errors.nonfinite == 0


def test_casadis_pinv_is_silent_at_rest_and_ours_is_not():
    result = run(lambda s, i, c: (servogen_c(s, i, c, "float64"), casadi_c(s, i, c, BASELINE, cse=True)))
    assert result.of(BASELINE, Output.ANSWER).boundary.nonfinite > 0
    ours = result.of("servogen f64", Output.ANSWER).boundary
    assert ours.nonfinite == 0
    assert ours.remarked > 0


def test_slower_code_takes_longer():
    def choose(scene, inputs, capacity):
        ours = servogen_c(scene, inputs, capacity, "float64")
        work = "volatile double waste = 0.0; int w; for (w = 0; w < 400; ++w) { waste = waste + 1.0; }\n    S[0] ="
        return altered(ours, "slow", r"\bS\[0\] =", work), casadi_c(scene, inputs, capacity, BASELINE, cse=True)

    result = run(choose, rounds=5)
    assert result.of("slow", Output.MATRIX).times.ratio > 3


def test_the_same_states_for_all_and_the_same_figures_again():
    def choose(scene, inputs, capacity):
        return numpy_pinv(scene, inputs), casadi_c(scene, inputs, capacity, BASELINE, cse=True)

    first, again = run(choose), run(choose)
    for a, b in zip(first.measurements, again.measurements, strict=True):
        assert (a.contender, a.output, a.errors, a.boundary) == (b.contender, b.output, b.errors, b.boundary)
    # S by CasADi's virtual machine and by its C is one computation, but for the order of the solve
    vm, c = (first.of(n, Output.MATRIX).errors for n in (first.measurements[0].contender, BASELINE))
    assert vm.scale == c.scale
    assert vm.judged == c.judged == 64


def test_pictures_are_drawn(tmp_path):
    result = run(lambda s, i, c: (servogen_c(s, i, c, "float64"), casadi_c(s, i, c, BASELINE, cse=True)))
    for path in draw(result, tmp_path):
        assert path.stat().st_size > 1000


def test_pareto_line():
    assert pareto([(1, 5), (2, 3), (3, 4), (4, 1)]) == [(1, 5), (2, 3), (4, 1)]
    assert pareto([(1, 1), (2, 1)]) == [(1, 1)]


def test_times_are_of_the_whole_batch():
    result = run(lambda s, i, c: (servogen_c(s, i, c, "float64"), casadi_c(s, i, c, BASELINE, cse=True)))
    for m in result.measurements:
        assert 0 < m.times.best <= m.times.median <= m.times.p999
        assert np.isfinite(m.times.ratio)


def test_labels_of_close_markers_stand_apart() -> None:
    spots = [
        (np.float64(0.1), np.float64(0.5)),
        (np.float64(0.1), np.float64(0.501)),
        (np.float64(0.9), np.float64(0.5)),
    ]
    heights = _spread(spots, _WIDE.height)
    assert np.min(np.diff(sorted(heights))) > 0.05
    assert _spread([(0.1, 0.2), (0.9, 0.8)], _WIDE.height) == [0.2, 0.8]  # nothing moves that need not


@pytest.mark.parametrize("x", [0.0, 0.3, 0.5, 0.6, 0.7, 1.0])
@pytest.mark.parametrize(("room", "width", "left"), [(_WIDE, 5.4, 0.01), (_NARROW, 4.0, 0.17)])
def test_no_label_leaves_its_panel(x: float, room: Any, width: float, left: float) -> None:
    """A long name in the middle ran beyond the right edge and was cut."""
    figure = Figure(figsize=(width, 6.2))
    axes = figure.subplots()
    figure.subplots_adjust(left=left, right=0.99)  # as wide as in a bench of two panels, and on a telephone
    errors = SimpleNamespace(nonfinite=0, largest_ulps=10.1)
    row = SimpleNamespace(
        ours=True, contender="servogen, adam's model", times=SimpleNamespace(median=1083.0), errors=errors
    )
    _labels(axes, [row], [(x, 0.5)], room)  # type: ignore[list-item]
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    label = axes.texts[0].get_window_extent(canvas.get_renderer())  # type: ignore[no-untyped-call]
    assert axes.bbox.x0 <= label.x0
    assert label.x1 <= axes.bbox.x1


def test_a_label_that_goes_above_its_marker_covers_no_other() -> None:
    """One in the middle, where neither side has room, went up by itself after the others had been spread."""
    figure = Figure(figsize=(4.0, 6.2))
    axes = figure.subplots()
    errors = SimpleNamespace(nonfinite=0, largest_ulps=2.0)
    rows = [
        SimpleNamespace(ours=False, contender=name, times=SimpleNamespace(median=9e4), errors=errors)
        for name in ("CasADi VM, numpy", "the textbook's twin")
    ]
    _labels(axes, rows, [(0.6, 0.3), (0.95, 0.34)], _NARROW)  # type: ignore[arg-type]
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    boxes = [Text.get_window_extent(t, canvas.get_renderer()) for t in axes.texts]  # type: ignore[no-untyped-call]
    lower, upper = sorted(boxes, key=lambda box: box.y0)  # without the lines to the markers
    assert lower.y1 <= upper.y0


@pytest.mark.parametrize("name", ["double_pendulum_ideal", "skewed_thrusters", "unicycle_path", "quaternion_pointing"])
def test_scenes_of_every_kind_have_all_their_contenders(name):
    """Ideal forces, constant G, rectangular C, a holonomic pair: nobody's answer is left out."""
    result = bench(load_scene(name), rounds=1, states=16, count_instructions=False)
    names = {m.contender for m in result.measurements if m.output is Output.ANSWER}
    assert names >= {"servogen f64", "servogen f32", BASELINE}
    assert all(m.errors.largest_ulps < 1e6 for m in result.measurements if m.contender == "servogen f64")


@pytest.mark.parametrize("free", [False, True])
def test_everyone_honours_the_weight(free: bool) -> None:
    """With a weight and a y of the state there was no truth; numpy's pinv looked wrong, for it never had the weight."""
    scene = load_scene("planar_arm_3r_weighted")
    if free:
        scene = dataclasses.replace(scene, y=-3 * scene.mechanism.u)
    result = bench(scene, rounds=1, states=16, count_instructions=False)
    answers = [m for m in result.measurements if m.output is Output.ANSWER]
    assert {"servogen f64", BASELINE, "CasADi VM, numpy", "textbook twin"} <= {m.contender for m in answers}
    assert all(m.errors.largest_ulps < 1e6 for m in answers)


@pytest.mark.parametrize("ldlt", [False, True])
def test_a_user_solves_the_closed_mechanism(ldlt: bool) -> None:
    """CasADi's contenders had the loop cut open: their answer was that of another mechanism."""
    mech = random_mechanism(7, 5, 1, 1, redundant=True)
    phi = sg.ControlsInvolved("phi", mech.tau[:2] - ca.sin(mech.q[:2]) * mech.u[:2], Theta=-1.0)
    psi = sg.Holonomic("psi", ca.vertcat(mech.q[0] + ca.sin(mech.q[1]), mech.q[2] * mech.q[1]), -2.0, -3.0)
    for constraint in (psi, phi):
        scene = sg.Scene("joined", mech, [constraint], domain={"q": (-1.5, 1.5), "u": (-1.0, 1.0)})
        system = function(scene, "system", expressions(scene, ldlt)[Output.SYSTEM], cse=False)
        state = {n: v[0] for n, v in draw_states(scene, 1).items()} | {"tau": np.array([0.3, -0.2, 0.5])}
        right, twin = scene.system.right, sg.reference(scene)
        expected = [getattr(twin, n)(**state).ravel() for n in (scene.system.matrix, right)]
        found = np.array(system(*(state[f.name] for f in scene.input_fields()), [])).ravel()
        np.testing.assert_allclose(found, np.concatenate(expected), rtol=0, atol=1e-9 * np.max(np.abs(found)))
