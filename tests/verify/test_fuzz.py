"""Fuzzing of the emitted solver: a few seconds of it, the inputs of former findings, and that it finds what is wrong."""

import re

import pytest
from servogen.verify import fuzz

FINDINGS: dict[fuzz.Target, tuple[str, ...]] = {}
"""Inputs (hex) on which a target once failed."""


@pytest.fixture(scope="module")
def clang(need_tool):
    return need_tool("clang", "clang libclang-rt-dev")


def test_seconds_of_fuzzing_find_nothing(clang):
    found = fuzz.run_target(clang, fuzz.Target(2, 3, "float64", "default"), seconds=2, seed=1)
    assert found.passed, found.words
    assert found.executions > 1000


@pytest.mark.parametrize("target", FINDINGS, ids=str)
def test_former_findings(clang, target):
    done = fuzz.replay(clang, target, [bytes.fromhex(text) for text in FINDINGS[target]])
    assert done.returncode == 0, done.stderr


def test_a_solver_that_writes_a_nan_is_found(clang, tmp_path, monkeypatch):
    """The fuzzer proves that it can fail: a row's square root of the range test taken away."""
    import servogen.compiler as compiler

    genuine = compiler.build_solver

    def spoilt(*args, **options):
        package = genuine(*args, **options)
        source = package.path / "pinv.c"
        text = source.read_text()
        spoiled = re.sub(r">= UINT64_C\(0x7ff0000000000000\)", "> UINT64_C(0x7fffffffffffffff)", text)
        assert spoiled != text
        source.write_text(spoiled)
        return package

    monkeypatch.setattr(compiler, "build_solver", spoilt)
    found = fuzz.run_target(clang, fuzz.Target(1, 2, "float64", "default"), seconds=4, seed=1)
    assert not found.passed
    assert found.input
