"""Certificates on boards: everything is proven, nothing seen exceeds it, and the budgets hold."""

import pytest
from servogen.loading import load_scene, scene_folder
from servogen.report.board_page import render_board_page
from servogen.verify.board_certificate import certify
from servogen.verify.budget import FILE, exceeded, read


@pytest.mark.parametrize("name", ["double_pendulum_energy", "spacecraft"])
def test_proven_and_within_budget(name, need_target):
    boards = ["cortex-m4", "cortex-m7"]
    for board in boards:
        need_target(board)
    budgets = read(scene_folder(name) / FILE)
    found = certify(load_scene(name), boards)
    assert [(c.target, c.scalar) for c in found] == [(b, s) for b in boards for s in ("float64", "float32")]
    for c in found:
        assert c.problems == ()
        assert exceeded(c, budgets) == []
        assert c.ram == 0
        assert budgets[name][c.target][c.scalar]["flash"] > 0
        for e in c.entries:
            assert 0 < e.instructions_mean <= e.instructions <= e.bound + 2
            assert 0 < e.stack_seen <= e.stack
        if (c.target, c.scalar) != ("cortex-m4", "float64"):
            assert not [n for n in c.needs if n.startswith("__aeabi_d")], "the core has it in hardware"
    page = render_board_page(found, [])
    assert "Everything was proven" in page
    assert all(f"{e.bound:,}" in page for c in found for e in c.entries)
