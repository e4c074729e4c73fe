"""The whole page of one scene, built as `servogen report` builds it."""

import re

import pytest
from servogen.loading import load_scene
from servogen.report.collect import Wishes, collect
from servogen.report.page import render_page

pytestmark = pytest.mark.xdist_group("page")  # one process makes the fixture


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    told = []
    wishes = Wishes(folder, states=20, rounds=1, without=(("board", "no board in this test"),))
    report = collect(["unicycle_path"], wishes, lambda *progress: told.append(progress))
    assert len(told) > 3
    assert [done for done, _, _ in told] == list(range(len(told)))
    return render_page(report)


def test_nothing_failed_and_nothing_comes_from_the_network(page):
    assert 'class="bad"' not in page
    assert not re.search(r'(?:src|href)="https?:', page)


def test_the_top_gives_the_loops_verdict(page):
    line = re.search(r"<td>unicycle_path in closed loop</td>.*", page)[0]
    assert re.search(r"was off its prescribed decay by at most \S+, at t = \S+ s \(tolerance ", line)
    assert '<td class="good">held</td>' in line


def test_a_start_that_is_refused_is_named(tmp_path):
    file = tmp_path / "falls.py"
    file.write_text(
        "import casadi as ca\nimport servogen as sg\nq, u, tau = (ca.SX.sym(n) for n in ('q', 'u', 'tau'))\n"
        "mech = sg.Mechanism(q=q, u=u, tau=tau, Q=1, P=0, G=1 / q)\n"
        "scene = sg.Scene('falls', mech, [sg.Nonholonomic('n', u, Theta=-1.0)])\n"
        "simulation = sg.Simulation(start={'q': 0})\n"
    )
    without = tuple((stage, "not wanted") for stage in ("check", "board", "speed", "precision"))
    report = collect([str(file)], Wishes(tmp_path, without=without))
    assert "controller: NONFINITE" in render_page(report)


def test_figures_of_the_loop_have_their_units(page):
    assert re.search(r"<th>largest control</th>.*>\S+ N m at the end, never above \S+ N m<", page)
    assert re.search(r"<th>x</th>.*>\S+ m at the end, 2.6 m at the start<", page)
    assert re.search(r"<td><code>u</code></td>.*<td>m/s, rad/s</td>", page)


def test_it_says_what_the_scene_is_made_of_and_what_its_solver_costs(page):
    scene = load_scene("unicycle_path")
    for f in scene.parameters:
        assert f"<td><code>{f.name}</code></td>" in page
    control = re.search(r"<td><code>unicycle_path_control</code></td>.*", page)[0]
    assert "and the solver:" in control
    assert "and the solver:" not in re.search(r"<td><code>unicycle_path_S_z</code></td>.*", page)[0]
