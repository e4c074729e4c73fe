"""Loops read from the source and the longest path through machine code, on code whose length is known."""

import pytest
from servogen.verify.bound import BoundUnknownError, read_machine
from servogen.verify.loops import LoopUnboundedError, loops_of
from support.c import run

TEXT = """static void f(int n, int rank)
{
    for (i = 0; i < 3; ++i) {
        for (j = i + 1; j < n; ++j) {
        }
        for (k = i; k > 0 && x[k] < 2; --k) {
        }
        for (j = 0; j < i; ++j, ++k) {
        }
    }
    for (k = rank - 1; k >= 0; --k) { /* a remark */
    }
    for (sweep = 1; sweep <= 7; ++sweep) {
    }
    for (bit = 1u << 24; bit != 0; bit >>= 1) {
    }
}

static void g(void)
{
    f(5, 2);
    f(4, 2);
}
"""


def test_limits_are_read_from_the_source():
    loops = loops_of(TEXT, {"rank": 6})
    assert [loop.turns for loop in loops] == [3, 5, 3, 3, 6, 8, 64]
    ends = [(3, 10), (4, 5), (6, 7), (8, 9), (11, 12), (13, 14), (15, 16)]
    assert [(loop.first, loop.last) for loop in loops] == ends


@pytest.mark.parametrize(
    "text",
    [
        "    for (;;) {\n    }\n",
        "    while (x > 1.0) {\n    }\n",
        "    do {\n    } while (0);\n",
        "    goto again;\n",
        "    for (k = 0; k < unknown; ++k) {\n    }\n",
        "    for (k = 0; k < 3; k += step) {\n    }\n",
        "    for (k = 0; k < 3; ++k) sum += k;\n",
    ],
)
def test_a_loop_without_a_limit_is_refused(text):
    with pytest.raises(LoopUnboundedError, match="line 3"):
        loops_of("void f(int unknown)\n{\n" + text + "}\n", {})


SOURCE = """
int sample_straight(int x);
int sample_branch(int x);
int sample_nest(volatile int *x);
int sample_again(int x);
int sample_pointer(int (*f)(int));
int hv_repeat(int times);
__attribute__((naked)) int sample_straight(int x) { __asm volatile("nop\\n nop\\n nop\\n bx lr"); }
__attribute__((naked)) int sample_branch(int x)
{
    __asm volatile("cmp r0, #0\\n beq 1f\\n nop\\n nop\\n nop\\n 1: bx lr");
}
__attribute__((naked)) int sample_far(int x) { __asm volatile("push {lr}\\n bl 1f\\n nop\\n nop\\n 1: pop {pc}"); }
int sample_nest(volatile int *x)
{
    int i, j;
    for (i = 0; i < 10; ++i) {
        for (j = 0; j < 20; ++j) {
            __asm volatile("nop\\n nop\\n nop\\n nop\\n nop\\n nop\\n nop\\n nop");
            *x = j;
        }
    }
    return *x;
}
int sample_again(int x) { return x > 1 ? x * sample_again(x - 1) + sample_again(x - 2) * 3 : 1; }
int sample_pointer(int (*f)(int)) { return f(3) + 1; }
int hv_repeat(int times) { while (times-- > 0) { (void)sample_straight(times); } return 0; }
"""


@pytest.fixture(scope="module")
def machine(need_target, tmp_path_factory):
    need_target("cortex-m4")
    folder = tmp_path_factory.mktemp("bound")
    source, image = folder / "sample.c", folder / "sample.elf"
    source.write_text(SOURCE)
    flags = ["-mcpu=cortex-m4", "-mthumb", "-O2", "-g", "-w", "-nostdlib", "-Wl,-e,hv_repeat"]
    run(["arm-none-eabi-gcc", *flags, source, "-o", image])
    tools = [f"arm-none-eabi-{name}" for name in ("objdump", "nm", "addr2line")]
    loops = loops_of(SOURCE.split("int hv_repeat(int times) {")[0], {})
    return read_machine(tools[0], tools[1], image, tools[2], source, loops)


def test_straight_code_counts_exactly(machine):
    assert machine.bound("sample_straight") == 4
    assert machine.bound("sample_branch") == 6
    assert 4 < machine.turn("hv_repeat", "sample_straight") <= 10


def test_a_branch_with_link_inside_its_function_is_a_jump(machine):
    """How gcc jumps far on v6-M; once it was taken for recursion."""
    assert machine.bound("sample_far") == 3


def test_loops_count_all_their_turns(machine):
    """200 turns of 8 nops and some 3 more; the bound may hold a turn more at each level."""
    assert 200 * 10 <= machine.bound("sample_nest") <= 11 * 21 * 15


@pytest.mark.parametrize(("function", "reason"), [("sample_again", "recursion"), ("sample_pointer", "register")])
def test_what_has_no_bound_is_refused(machine, function, reason):
    with pytest.raises(BoundUnknownError, match=reason):
        machine.bound(function)
    with pytest.raises(BoundUnknownError, match="not in the image"):
        machine.bound("sample_nowhere")
