"""The whole page of one scene, built as `servogen report` builds it."""

import json
import re
import xml.etree.ElementTree as ET
from functools import partial
from threading import Event

import pytest
from servogen.bench.run import bench
from servogen.cli.report import exit_code
from servogen.loading import load_scene
from servogen.report import scene_work
from servogen.report.collect import Wishes, collect
from servogen.report.page import render_page
from servogen.report.scene_work import STAGES

pytestmark = pytest.mark.xdist_group("page")  # one process makes the fixture


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    told = []
    wishes = Wishes(folder, states=8, rounds=1, without=(("board", "no board in this test"),))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene_work, "bench", partial(bench, states=64))  # the page shows figures, whatever they are of
        report = collect(["unicycle_path"], wishes, lambda *progress: told.append(progress))
    assert len(told) > 3
    assert [done for done, _, _ in told] == list(range(len(told)))
    return render_page(report)


def test_nothing_failed_and_nothing_comes_from_the_network(page):
    assert 'class="bad"' not in page
    assert not re.search(r'(?:src|href)="https?:', page)


def test_the_verdict_comes_first_then_the_loop_then_the_formulas(page):
    card = re.search(
        r'<div class="card held"><p><span>The closed loop:</span> <strong>held</strong></p><p>(.*?)</p>', page
    )
    assert re.search(r"was off its prescribed decay by at most \S+, at t = \S+ s \(tolerance ", card[1])
    order = [page.index(x) for x in ("<strong>held", "<h3>The closed loop<", 'class="motion"', 'class="plot"', "<math")]
    assert order == sorted(order)
    assert "passed" not in page


def test_runs_on_machines_that_differ_stand_on_top_and_below(page):
    card = re.search(r"<span>Robustness:</span> <strong>(\d+) of 100 held</strong></p><p>(.*?)</p>", page)
    assert 0 < int(card[1]) < 100
    assert "100 runs with masses within 10 %" in card[2]
    assert "rank correlation with the error: mass (+0.9" in card[2]  # twelve kilograms that the controller takes amiss
    tables = re.search(r"<h3>On machines that differ.*?<table>(.*?)</table>", page, re.DOTALL)[1]
    rows = [re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row) for row in re.findall(r"<tr>(.*?)</tr>", tables)]
    assert [row[0] for row in rows[1:]][-2:] == ["largest |tau[0]|", "largest |tau[1]|"]
    assert all(float(row[1]) <= float(row[2]) <= float(row[3]) <= float(row[4]) for row in rows[1:])


def test_pictures_are_well_formed_light_and_apart(page):
    pictures = re.findall(r"<svg.*?</svg>", page, re.DOTALL)
    assert len(pictures) > 8
    named = []
    for picture in pictures:
        root = ET.fromstring(picture.replace("xlink:href", "href"))
        assert root.get("viewBox") or root.get("width")
        own = [e.get("id") for e in root.iter() if e.get("id")]
        used = re.findall(r"#([\w-]+?)[\")]", picture)
        assert {u for u in used if u in picture and not re.fullmatch("[0-9a-f]{6}", u)} <= set(own)
        named += own
        assert len(picture) < 60_000
    assert len(named) == len(set(named))


def test_the_motion_is_data_beside_a_still_picture(page):
    motion = json.loads(re.search(r'<script type="application/json">(.*?)</script>', page)[1])
    assert motion["t"][0] == 0
    assert motion["t"][-1] == 10
    assert len(motion["poses"]) == len(motion["t"])
    assert {len(pose) for pose in motion["poses"]} == {2 * sum(motion["sizes"])}
    still = re.search(r'<g class="pose">(.*?)</g>', page)[1]
    shown = [float(x) for points in re.findall(r'points="([^"]*)"', still) for x in re.split("[ ,]", points)]
    assert shown == motion["poses"][-1]
    assert page.count('<g class="ghosts"><polyline') == 1


def test_what_is_left_out_is_said(page):
    assert "<li>no board in this test</li>" in page


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
    page = render_page(report)
    assert not report.problems
    assert "falls: closed loop on machines that differ: the start was refused" in report.skipped
    assert "<strong>refused: OVERFLOW</strong>" in page
    assert "The controller refused the start:" in page
    assert (exit_code(report, False), exit_code(report, False, any_verdict=True)) == (1, 0)


def test_a_page_of_nothing_says_so_and_the_command_was_interrupted(tmp_path):
    interrupted = Event()
    interrupted.set()
    report = collect(["unicycle_path", "spacecraft"], Wishes(tmp_path), interrupted=interrupted)
    page = render_page(report)
    assert page.count("not begun: stopped by Ctrl-C") >= 2 * len(STAGES)
    assert not report.problems
    assert (exit_code(report, True), exit_code(report, False)) == (130, 1)


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
