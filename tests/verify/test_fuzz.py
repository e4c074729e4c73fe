"""Fuzzing of the emitted solver: seconds of it, and that it finds what is wrong."""

import platform

import pytest
from servogen.verify import fuzz
from support.mutate import mutated


@pytest.fixture(scope="module")
def clang(need_tool, need_library):
    need_library("clang", f"libclang_rt.fuzzer-{platform.machine()}.a", "libclang-rt-dev")
    return need_tool("clang", "clang")


def test_seconds_of_fuzzing_find_nothing(clang):
    found = fuzz.run_target(clang, fuzz.Target(2, 3, "float64", "default"), seconds=2, seed=1)
    assert found.passed, found.words
    assert found.executions > 1000


def test_a_solver_that_writes_a_nan_is_found(clang, tmp_path, monkeypatch):
    """The fuzzer proves that it can fail: the test for infinity made deaf."""
    genuine = fuzz.build_solver

    def spoilt(*args, **options):
        package = genuine(*args, **options)
        source = package.path / "pinv.c"
        deaf = mutated(source.read_text(), ">= PINV_INFINITY_BITS", "> PINV_MAGNITUDE_MASK")
        source.write_text(deaf)
        return package

    monkeypatch.setattr(fuzz, "build_solver", spoilt)
    found = fuzz.run_target(clang, fuzz.Target(1, 2, "float64", "default"), seconds=4, seed=1)
    assert not found.passed
    assert found.input
