"""Bit for bit: one hash of all answers from every compiler, level and board; with libm there are several."""

import os
from itertools import cycle

import pytest
from servogen.loading import builtin_names, load_scene
from servogen.verify.bits import SYSTEMS, Build, builds, hashes, solver_hashes
from servogen.verify.harness import targets

CAMPAIGN = os.environ.get("SERVOGEN_CAMPAIGN") == "1"
BOARDS = [name for name in targets() if name != "host"]
LEVELS = ("-O1", "-O2")  # of the boards, by turns
SHORT = [
    Build("host", "gcc", "-O0"),
    Build("host", "clang", "-O3"),
    *(Build(board, "gcc", level) for board, level in zip(BOARDS, cycle(LEVELS), strict=False)),
]


@pytest.fixture
def everywhere(need_target):
    for compiler in ("gcc", "clang"):
        need_target("host", compiler)
    for board in BOARDS:
        need_target(board)
    return builds(BOARDS) if CAMPAIGN else SHORT


def test_one_hash(everywhere):
    names = builtin_names() if CAMPAIGN else ("double_pendulum_energy",)
    for prefix, found in hashes([load_scene(n) for n in names], everywhere, 200).items():
        assert len(found) == len(everywhere)
        assert len(set(found.values())) == 1, f"{prefix}: {found}"
        assert not next(iter(found.values())).startswith("failed")


def test_one_hash_of_solves(everywhere):
    """Every rung, singular systems and their infos; the bare solver."""
    shapes = [(1, 3), (2, 3), (3, 7), (6, 7), (6, 12), (7, 3)] if CAMPAIGN else [(2, 3)]
    for prefix, found in solver_hashes(shapes, everywhere, SYSTEMS if CAMPAIGN else 300).items():
        assert len(found) == len(everywhere)
        assert len(set(found.values())) == 1, f"{prefix}: {found}"
        assert not next(iter(found.values())).startswith("failed")


def test_libm_differs_between_machines(everywhere):
    """float64 from glibc and from newlib: were they the same, own functions would not be needed."""
    where = [Build("host", "gcc", "-O2"), Build("cortex-m7", "gcc", "-O2")]
    found = hashes([load_scene("double_pendulum_energy")], where, 2000, math="libm")
    assert any(len(set(by_build.values())) > 1 for by_build in found.values())
