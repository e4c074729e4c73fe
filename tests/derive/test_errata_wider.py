"""Printed errors of the paper beyond those of test_errata.py: Section 5, where a row asks for what cannot be."""

import re
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.scene.domain import draw_states
from servogen.scenes.double_pendulum_energy_and_path import scene, simulation
from servogen.simulate.closed_loop import ClosedLoop
from support.models import derived


def test_eq_35_text_the_system_generically_has_a_solution() -> None:
    """Printed: "the above matrix system has no solution". S has rank 2 almost everywhere, and tau meets both rows."""
    _, quantities = derived(scene)
    states = draw_states(scene, 200)
    regular = 0
    for k in range(200):
        found = quantities(**{n: v[k] for n, v in states.items()})
        S, z = found["S"], found["z"].ravel()
        if np.linalg.cond(S) > 1e6:
            continue
        regular += 1
        tau = np.linalg.solve(S, z)
        assert np.linalg.norm(S @ tau - z) <= 1e-9 * (np.linalg.norm(z) + np.linalg.norm(S) * np.linalg.norm(tau))
    assert regular >= 195


def test_eq_35_as_printed_the_second_row_is_zero() -> None:
    """Printed: d psi_2 / du, which is zero for psi_2(q); right: d psi_2 / dq (C = I), by differences of psi_2'."""
    q, u = scene.mechanism.q, scene.mechanism.u
    psi = scene.constraints[1].psi
    assert ca.jacobian(psi, u).nnz() == 0
    psi_dot = ca.Function("psi_dot", [q, u, *(p.symbol for p in scene.parameters)], [ca.jtimes(psi, q, u)])
    defaults = [p.default for p in scene.parameters]
    row = np.array(
        ca.Function("row", [q, *(p.symbol for p in scene.parameters)], [ca.jacobian(psi, q)])([0.4, 0.9], *defaults)
    )
    h = 1e-6
    slope = [float(psi_dot([0.4, 0.9], [h * (k == 0), h * (k == 1)], *defaults)) / h for k in range(2)]
    assert np.allclose(row.ravel(), slope, rtol=1e-9)
    assert np.linalg.norm(row) > 0.1


def test_section_5_rank_is_lost_on_the_way_and_said() -> None:
    """S degenerates as |u| goes to 0: the run ends at a margin of the raw S, with both constraints met until then."""
    run = ClosedLoop(scene, simulation).run(step=2e-4)
    assert run.stop.reason == "event"
    assert run.stop.event == "sigma_min <= 0.2"
    assert run.stop.t == pytest.approx(0.644, abs=0.01)
    before = run.t < run.stop.t - 0.02
    assert np.max(np.abs(run.constraint - run.ideal)[before]) < 1e-6
    assert np.all(run.rank == 2)  # the rank of the scaled rows never drops: only the margin sees it
    assert run.outputs["K/E"][-1] < 0.02


@pytest.mark.parametrize("speed", [1e-1, 1e-3, 1e-5])
def test_section_5_sigma_min_goes_to_zero_with_the_speed(speed: float) -> None:
    twin = sg.reference(scene)
    info = twin.control(q=[1.7, -0.7], u=[0.4 * speed, 0.7 * speed]).info
    assert info.sigma_min < 2 * speed
    assert info.rank == 2


def test_every_row_of_the_table_has_its_tests() -> None:
    """codegen/docs/errata.md names them; a test that is renamed or gone is missed here."""
    root = Path(__file__).parents[2]
    rows = [line for line in (root / "codegen/docs/errata.md").read_text().splitlines() if line.startswith("| ")][1:]
    source = "\n".join(file.read_text() for file in (root / "tests/derive").glob("test_*.py"))
    assert len(rows) == 15
    for row in rows:
        named = re.findall(r"`(test_\w+)`", row)
        assert named, row
        for name in named:
            assert f"def {name}(" in source, name
