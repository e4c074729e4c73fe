"""Back to back on boards, at states made on the target: 10,000 a scene, of the committed C."""

import json
import os

import pytest
from servogen.loading import builtin_names, load_scene
from servogen.results import Status
from servogen.verify.campaign import campaign_header, read_campaign, run_campaign
from servogen.verify.generated import FOLDERS, committed_folder

CAMPAIGN = os.environ.get("SERVOGEN_CAMPAIGN") == "1"
VECTORS = 100_000 if CAMPAIGN else 10_000


def packages(scalar, names=None):
    """(folder, prefix) of the committed packages, and their headers by prefix."""
    found, headers = [], {}
    for name in names or builtin_names():
        folder = committed_folder() / name / FOLDERS[scalar]
        manifest = json.loads((folder / "manifest.json").read_text())
        found.append((folder, manifest["prefix"]))
        headers[manifest["prefix"]] = campaign_header(load_scene(name), manifest["prefix"], scalar, manifest)
    return found, headers


def run(scalar, targets, tmp_path, names=None, vectors=VECTORS):
    given, headers = packages(scalar, names)
    results = []
    for target in targets:
        level = "-O2" if CAMPAIGN else "-O0" if target == "host" else "-O1"  # the same bits, sooner compiled
        options = {"vectors": vectors, "optimisation": level}
        results.append(run_campaign(given, headers, target=target, build_dir=tmp_path / target, **options))
    return results


def agree(results):
    for first, *others in zip(*results, strict=True):
        for other in others:
            assert other.hash == first.hash, f"{first.prefix}: {first.target} against {other.target}"
            assert not other.problem


@pytest.mark.xdist_group("all scenes")  # one process optimises them
@pytest.mark.parametrize(("scalar", "board"), [("float32", "cortex-m4"), ("float64", "cortex-m7")])
def test_every_scene(scalar, board, need_target, tmp_path):
    """Each scalar where the core has it in hardware; singular states and refusals are among them."""
    need_target(board)
    here, there = run(scalar, ["host", board], tmp_path)
    agree([here, there])
    for result in there:
        last = result.entries[-1]
        assert last.statuses["NONFINITE"] > 50
        assert last.statuses["OK"] + last.statuses.get("REGULARISED", 0) > 0.5 * VECTORS
        assert all(e.instructions > 0 and e.stack > 0 for e in result.entries)
    assert any("RANK_DEFICIENT_INCONSISTENT" in r.entries[-1].statuses for r in there)
    assert {"lam", "closure"} <= {e.entry for r in there for e in r.entries}  # of loops


def test_float64_in_software(need_target, tmp_path):
    """Without firmware_sim/targets/arm/dadd.c three of these states have another last bit."""
    need_target("cortex-m4")
    agree(run("float64", ["host", "cortex-m4"], tmp_path, ["double_pendulum_energy_and_path"]))


@pytest.mark.parametrize("board", ["cortex-m0", "cortex-m3", "cortex-m33"])
def test_smoke(board, need_target, tmp_path):
    need_target(board)
    agree(run("float32", ["host", board], tmp_path, ["double_pendulum_energy", "spacecraft"], 300))


COUNTS = ",".join(str({Status.NONFINITE: 1, Status.OK: 4}.get(s, 0)) for s in sorted(Status))
LOG = f"""harness prefix=p
campaign entry=z vectors=5 hash=01 touched=0 worst=9 vector=3 total=1e stack=8 statuses={COUNTS}
verdict pass=1
"""


@pytest.mark.parametrize(
    ("old", "new", "code", "problem"),
    [
        ("", "", 0, ""),
        ("prefix=p", "prefix=q", 0, "heading"),
        ("vectors=5", "vectors=4", 0, "not all"),
        ("campaign", "nothing", 0, "not all"),
        ("touched=0", "touched=1", 0, "touched"),
        ("pass=1", "pass=0", 0, "verdict"),
        ("", "", 1, "verdict"),
        ("verdict", "fault: an exception", 3, "fault"),
    ],
)
def test_nothing_is_believed_that_the_lines_do_not_prove(old, new, code, problem):
    result = read_campaign("p", "host", code, LOG.replace(old, new), 5)
    assert problem in result.problem
    assert bool(problem) == bool(result.problem)
    if not problem:
        assert result.entries[0].statuses == {"NONFINITE": 1, "OK": 4}
        assert result.entries[0].total == 30
