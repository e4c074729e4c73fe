"""The tools that read objects, on code made to fail them: recursion, frames without a bound, wrong symbols."""

from pathlib import Path

import pytest
import servogen as sg
from servogen.loading import load_scene
from servogen.verify import objects
from servogen.verify.board_certificate import BoardCertificate, EntryCost
from servogen.verify.budget import accept, exceeded, read
from servogen.verify.objects import Function, StackUnknownError, stack, wrong_symbols
from support.c import run

ARM = ["arm-none-eabi-gcc", "-mthumb", "-O2", "-std=c99", "-ffp-contract=off"]
M4F = ["-mcpu=cortex-m4", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
M0 = ["-mcpu=cortex-m0"]

SOURCE = """
int leaf(int x);
int deep(int x);
int again(int x);
int open_ended(int n);
int pointer(int (*f)(int), int x);
__attribute__((noinline)) int leaf(int x) { volatile int keep[100]; keep[x] = x; return keep[0]; }
__attribute__((noinline)) int deep(int x) { volatile int keep[10]; keep[0] = leaf(x); return keep[0] + leaf(x + 1); }
__attribute__((noinline)) int again(int x) { return x > 1 ? x + again(x - 1) + leaf(again(x - 2)) : 1; }
__attribute__((noinline)) int open_ended(int n) { volatile char keep[n]; keep[0] = 1; return leaf(keep[n - 1]); }
__attribute__((noinline)) int pointer(int (*f)(int), int x) { return f(x) + 1; }
"""


def test_stack_by_hand():
    graph = {"a": Function(16, calls={"b", "c"}), "b": Function(100), "c": Function(40, calls={"memcpy"})}
    assert stack("a", graph, {"memcpy": Function(80, code=20)}) == (136, ("a", "c", "memcpy"))
    with pytest.raises(StackUnknownError, match="memcpy, called by c: its frame is not known"):
        stack("a", graph, {})
    with pytest.raises(StackUnknownError, match="memcpy: it was not disassembled"):
        stack("a", graph, {"memcpy": Function(0)})
    with pytest.raises(StackUnknownError, match="recursion: a -> b -> a"):
        stack("a", {"a": Function(8, calls={"b"}), "b": Function(8, calls={"a"})}, {})


@pytest.fixture
def graph(need_target, tmp_path):
    need_target("cortex-m4")
    source = tmp_path / "code.c"
    source.write_text(SOURCE)
    run([*ARM, *M4F, "-fcallgraph-info=su", "-c", source, "-o", tmp_path / "code.o"])
    return objects._read_graph((tmp_path / "code.ci").read_text())


def test_what_has_no_bound_is_refused(graph):
    depth, chain = stack("deep", graph, {})
    assert chain == ("deep", "leaf")
    assert 440 <= depth <= 520
    for name, complaint in (("again", "recursion: again"), ("open_ended", "has no bound"), ("pointer", "indirect")):
        with pytest.raises(StackUnknownError, match=complaint):
            stack(name, graph, {})


def test_disassembly_agrees_with_the_compiler(graph, need_target, tmp_path):
    """Frames read from the disassembly of the same object are the compiler's own."""
    library = objects.library_graph("arm-none-eabi-objdump", "arm-none-eabi-nm", tmp_path / "code.o")
    for name in ("leaf", "deep"):
        assert library[name].frame == graph[name].frame
    assert library["deep"].calls == {"leaf"} or library["deep"].frame >= graph["deep"].frame


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("__aeabi_fadd", False),
        ("memcpy", False),
        ("__aeabi_dadd", True),
        ("__aeabi_f2d", True),
        ("__aeabi_ui2d", True),
        ("sinf", True),
        ("sqrtf", True),
        ("malloc", True),
        ("snprintf", True),
    ],
)
def test_symbols_of_a_float32_package(name, wrong):
    assert bool(wrong_symbols([name], "float32")) == wrong


@pytest.mark.parametrize("flags", [M4F, M0], ids=["M4F", "M0"])
@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_objects_need_the_compilers_arithmetic_alone(flags, scalar, need_target, tmp_path):
    """No libm, no heap, no stdio; float32 without any float64; on an M4F float32 needs nothing at all."""
    need_target("cortex-m4")
    for name in ("double_pendulum_energy", "spacecraft"):
        package = sg.build(load_scene(name), tmp_path / name / scalar, scalar)
        for level in ("-O0", "-O2", "-O3"):
            target = tmp_path / "package.o"
            run([*ARM, *flags, level, "-c", package.path / f"{package.prefix}.c", "-o", target])
            needs = objects.undefined("arm-none-eabi-nm", target)
            assert wrong_symbols(needs, scalar) == []
            if flags is M4F and scalar == "float32" and level != "-O0":
                assert needs == ()


def test_libm_is_seen_where_it_is_asked_for(need_target, tmp_path):
    need_target("cortex-m4")
    package = sg.build(load_scene("double_pendulum_energy"), tmp_path, "float32", math="libm")
    run([*ARM, *M4F, "-c", package.path / f"{package.prefix}.c", "-o", tmp_path / "package.o"])
    wrong = wrong_symbols(objects.undefined("arm-none-eabi-nm", tmp_path / "package.o"), "float32")
    assert any(text.startswith("cosf:") for text in wrong)


def certificate(**changes):
    entry = EntryCost("control", 1000, 900, 1100, 0, 10, 200, 180, ("control",), {}, 1.0, ())
    given = {"entries": (entry,), "flash": 4000} | changes
    fixed = {"scene": "s", "scalar": "float32", "target": "cortex-m4", "prefix": "s_f32", "math": "own"}
    rest = {"compiler": "", "flags": (), "library": 0, "ram": 0, "state": {}, "functions": {}, "needs": ()}
    return BoardCertificate(**fixed, **rest, **given, problems=())


def test_a_budget_allows_three_percent(tmp_path):
    file = Path(tmp_path) / "budget.toml"
    assert exceeded(certificate(), read(file)) == []
    accept(file, [certificate()])
    assert exceeded(certificate(), read(file)) == []
    assert exceeded(certificate(flash=4119), read(file)) == []
    assert "flash: 4125, +3.1% of the budget 4000" in exceeded(certificate(flash=4125), read(file))[0]
    dearer = EntryCost("control", 1031, 900, 1100, 0, 10, 207, 180, ("control",), {}, 1.0, ())
    assert len(exceeded(certificate(entries=(dearer,)), read(file))) == 2
    assert "nothing of that name" in exceeded(certificate(entries=()), {"s": {"cortex-m4": {"float32": {
        "instructions": {"gone": 5}}}}})[0]  # fmt: skip
