"""The instruction counter: a loop of known length, on every board."""

import dataclasses

import pytest
from servogen.verify.harness import run_harness, targets

LOOP = 20_000
BOARDS = [name for name in targets() if name != "host"]

HEAD = "int sample_z(const sample_model *model, const sample_input *in, double *z)\n{"
COUNTED = f"""
    int turns = {LOOP};
    __asm volatile("1: sub %0, #1\\n cmp %0, #0\\n bne 1b" : "+l"(turns) : : "cc");
"""


@pytest.mark.parametrize("board", BOARDS)
def test_three_instructions_a_turn(board, sample, need_target, tmp_path):
    """An entry point made LOOP turns longer costs 3 LOOP instructions more."""
    need_target(board)
    plain = sample.write(tmp_path, "plain")
    longer = sample.write(tmp_path, "longer", edits=[(HEAD, HEAD + COUNTED)])
    vectors = {}
    for prefix in ("plain", "longer"):
        given = sample.vectors(prefix, count=4)
        entries = tuple(e for e in given.entries if e.name == "z")
        vectors[prefix] = dataclasses.replace(given, entries=entries)
    results = run_harness([plain, longer], vectors, target=board, build_dir=tmp_path / "build", measure=True)
    assert [r.problems for r in results] == [(), ()]
    costs = [r.costs["z"].worst for r in results]
    assert abs(costs[1] - costs[0] - 3 * LOOP) < 0.001 * 3 * LOOP


def test_the_host_does_not_count(sample, need_target, tmp_path):
    need_target()
    package = sample.write(tmp_path)
    vectors = {"sample": sample.vectors(count=4)}
    (result,) = run_harness([package], vectors, build_dir=tmp_path / "build", measure=True)
    assert result.passed
    assert result.costs == {}
