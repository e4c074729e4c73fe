"""The paper's figures: every number from 2 to 21 once, each curve what it says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from servogen.report.paper import SCENES, draw_paper, narrow_figures, sheets
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.trajectory import Trajectory
from servogen.simulate.wanted import load_simulation

pytestmark = pytest.mark.xdist_group("paper")  # one process makes the fixture


@pytest.fixture(scope="module")
def runs() -> dict[str, Trajectory]:
    found = {}
    for name in SCENES:
        scene, simulation = load_simulation(name)
        short = replace(simulation, duration=min(simulation.duration, 3.0))
        found[name] = ClosedLoop(scene, short).run()
    return found


def test_figures_2_to_21_each_once(runs: dict[str, Trajectory]) -> None:
    numbers = [panel.number for sheet in sheets(runs) for panel in sheet.panels]
    assert numbers == list(range(2, 22))


def test_curves_are_what_the_paper_shows(runs: dict[str, Trajectory]) -> None:
    panels = {panel.number: panel for sheet in sheets(runs) for panel in sheet.panels}
    for t, E, _ in panels[2].curves:
        assert np.allclose(E, E[0] * np.exp(-t), rtol=1e-5)
    t, K, _ = panels[6].curves[0]
    assert np.allclose(K, 0.124 * np.exp(-t), rtol=1e-3)
    for k in range(3):
        assert panels[7 + k].curves[0][1][0] == pytest.approx(0.1)
        assert np.array_equal(panels[13 + k].curves[0][1], -panels[19 + k].curves[0][1])  # y = -tau
    turns = [np.sum(np.diff(np.sign(np.diff(panels[n].curves[0][1]))) != 0) for n in (7, 16)]
    assert turns[0] > 3 * turns[1]  # y = 0 chatters, y = -tau does not


def test_the_sheets_are_drawn(runs: dict[str, Trajectory], tmp_path: Path) -> None:
    found = sheets(runs)
    drawn = draw_paper(found, tmp_path)
    assert [file.name for file in drawn] == [
        "paper_figures_2_to_5.png", "paper_figures_6_to_12.png", "paper_figures_13_to_21.png",
    ]  # fmt: skip
    assert all(file.stat().st_size > 20_000 and file.with_suffix(".svg").exists() for file in drawn)
    assert "neither masses, lengths nor the start" in found[0].caption
    for number in ("m_B = 1", "L = 1.2", "q(0) = (1.6, -1.8)"):  # chosen, so said
        assert number in found[0].caption
    for caption in (found[1].caption, found[2].caption):  # the paper's own
        assert "I_1 = 10, I_2 = 6.3, I_3 = 8.5, a = 1" in caption
        assert "u(0) = (0.1, 0.1, 0.1), tau(0) = (0.09998" in caption  # as printed, projected onto phi = 0
    assert [number for sheet in found for number in narrow_figures(sheet)] == list(range(2, 22))
