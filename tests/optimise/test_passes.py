"""The passes: the same function before and after, the identities they find, and those they must not."""

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from servogen.ir.evaluate import evaluate
from servogen.ir.lower import lower_expressions
from servogen.ir.program import Input, Instr, Output, Program, check_legal, live
from servogen.optimise.dead import drop_dead
from servogen.optimise.fold import fold
from servogen.optimise.merge import merge
from servogen.optimise.passes import PASSES, optimise
from servogen.optimise.schedule import most_alive, schedule
from support.programs import ANY, TAME, clear_of_steps, examples, programs, random_states, same_to_50_digits

EVERY: list[Callable[[Program], Program]] = [*dict.fromkeys(PASSES), schedule, optimise]
NAMES = [run.__name__ for run in EVERY]

# ---- the same function ----


@pytest.mark.parametrize("run", EVERY, ids=NAMES)
@examples(40)
@given(programs(ops=TAME), st.integers(0, 2**32 - 1))
def test_the_same_values_at_50_digits(run: Callable[[Program], Program], program: Program, seed: int) -> None:
    after = check_legal(run(program))
    assert after.inputs == program.inputs
    assert [(o.name, o.rows, o.columns) for o in after.outputs] == [
        (o.name, o.rows, o.columns) for o in program.outputs
    ]
    same_to_50_digits(program, after, random_states(seed))


@pytest.mark.parametrize("run", EVERY, ids=NAMES)
@examples(40)
@given(programs(ops=ANY), st.integers(0, 2**32 - 1))
def test_the_same_values_wherever_there_is_one(run: Callable[[Program], Program], program: Program, seed: int) -> None:
    """Every operation of the table: where the value before is a number, it is the same number after."""
    states = random_states(seed)
    before, clear = evaluate(program, states), clear_of_steps(program, states)
    good = {n: np.isfinite(v) & (np.abs(v) < 1e6) & clear[:, None, None] for n, v in before.items()}
    assume(any(np.any(g) for g in good.values()))
    now = evaluate(check_legal(run(program)), states)
    for name, value in before.items():
        there = np.broadcast_to(now[name], good[name].shape)[good[name]]
        np.testing.assert_allclose(there, np.broadcast_to(value, good[name].shape)[good[name]], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("run", [drop_dead, merge, schedule, optimise], ids=lambda run: run.__name__)
@examples(40)
@given(programs(ops=ANY))
def test_idempotent(run: Callable[[Program], Program], program: Program) -> None:
    once = run(program)
    assert run(once) == once


@examples(40)
@given(programs(ops=ANY))
def test_fold_ends(program: Program) -> None:
    """Folding does not chase its own tail: a few rounds of folding and merging, and nothing changes any more."""
    for _ in range(12):
        program, before = drop_dead(merge(fold(program))), program
        if program == before:
            return
    pytest.fail("fold and merge still change the program after 12 rounds")


@examples(40)
@given(programs(ops=tuple(op for op in ANY if op != "pow")))
def test_optimise_never_adds_work(program: Program) -> None:
    assert optimise(program).operations()["total"] <= drop_dead(program).operations()["total"]


@pytest.mark.parametrize("exponent", range(-17, 18))
def test_a_power_costs_no_more_than_by_squaring(exponent: int) -> None:
    """The one operation that becomes several: a square for each binary digit, a product for each further 1."""
    program = optimise(build(exponent, ("pow", 0, 3)))
    n = abs(exponent)
    products = max(n.bit_length() + n.bit_count() - 2, 0)
    assert program.operations()["total"] == (products + (exponent < 0) if n <= 16 else 1)


# ---- identities ----

x, y, z = ca.SX.sym("x"), ca.SX.sym("y"), ca.SX.sym("z")
LEAVES = [(Input("x", 1), x), (Input("y", 1), y), (Input("z", 1), z)]


def build(*steps: tuple[Any, ...], outputs: int = 1) -> Program:
    """A program over x, y, z (%0, %1, %2); a step is (op, numbers...) or a constant; the last ones come out."""
    instrs = [Instr("input", (), (name, 0)) for name in "xyz"]
    for step in steps:
        if isinstance(step, tuple):
            instrs.append(Instr(step[0], tuple(step[1:])))
        else:
            instrs.append(Instr("const", (), Fraction(step)))
    last = range(len(instrs) - outputs, len(instrs))
    named = tuple(Output(f"o{k}", 1, 1, (n,)) for k, n in enumerate(last))
    return check_legal(Program("f", tuple(i for i, _ in LEAVES), tuple(instrs), named))


def text(program: Program, output: str = "o0") -> str:
    """The output as a formula, fully parenthesised."""

    def show(n: int) -> str:
        instr = program.instrs[n]
        if isinstance(instr.const, Fraction):
            return str(instr.const)
        if instr.const is not None:
            return instr.const[0]
        return f"{instr.op}({', '.join(show(a) for a in instr.args)})"

    return show(program.output(output).nodes[0])


@pytest.mark.parametrize(
    ("steps", "simplified"),
    [
        # zero and one
        ((0, ("add", 0, 3)), "x"),
        ((0, ("add", 3, 0)), "x"),
        ((0, ("sub", 0, 3)), "x"),
        ((0, ("sub", 3, 0)), "neg(x)"),
        ((0, ("mul", 0, 3)), "0"),
        ((0, ("mul", 3, 0)), "0"),
        ((1, ("mul", 0, 3)), "x"),
        ((1, ("mul", 3, 0)), "x"),
        ((1, ("div", 0, 3)), "x"),
        ((0, ("div", 3, 0)), "0"),
        ((1, ("div", 3, 0)), "div(1, x)"),
        ((("sub", 0, 0),), "0"),
        # signs
        ((("neg", 0), ("neg", 3)), "x"),
        ((("neg", 0), ("mul", 3, 1)), "neg(mul(x, y))"),
        ((("neg", 0), ("mul", 1, 3)), "neg(mul(x, y))"),
        ((("neg", 0), ("neg", 1), ("mul", 3, 4)), "mul(x, y)"),
        ((("neg", 0), ("div", 3, 1)), "neg(div(x, y))"),
        ((("neg", 0), ("div", 1, 3)), "neg(div(y, x))"),
        ((("neg", 0), ("neg", 1), ("div", 3, 4)), "div(x, y)"),
        ((("neg", 0), ("add", 3, 1)), "sub(y, x)"),
        ((("neg", 0), ("add", 1, 3)), "sub(y, x)"),
        ((("neg", 0), ("sub", 1, 3)), "add(x, y)"),
        ((-1, ("mul", 0, 3)), "neg(x)"),
        ((-2, ("mul", 0, 3)), "neg(mul(x, 2))"),
        ((-2, ("div", 3, 0)), "neg(div(2, x))"),
        ((-3, ("div", 0, 3)), "neg(div(x, 3))"),
        ((("neg", 0), ("cos", 3)), "cos(x)"),
        ((("neg", 0), ("sin", 3)), "neg(sin(x))"),
        ((("neg", 0), ("tan", 3)), "neg(tan(x))"),
        ((("neg", 0), ("fabs", 3)), "fabs(x)"),
        # powers of two divide exactly
        ((4, ("div", 0, 3)), "mul(x, 1/4)"),
        (("0.25", ("div", 0, 3)), "mul(x, 4)"),
        ((-8, ("div", 0, 3)), "neg(mul(x, 1/8))"),
        ((3, ("div", 0, 3)), "div(x, 3)"),
        (("0.1", ("div", 0, 3)), "div(x, 1/10)"),
        # powers
        ((0, ("pow", 0, 3)), "1"),
        ((1, ("pow", 0, 3)), "x"),
        ((2, ("pow", 0, 3)), "mul(x, x)"),
        ((3, ("pow", 0, 3)), "mul(x, mul(x, x))"),
        ((4, ("pow", 0, 3)), "mul(mul(x, x), mul(x, x))"),
        ((-1, ("pow", 0, 3)), "div(1, x)"),
        ((-2, ("pow", 0, 3)), "div(1, mul(x, x))"),
        (("0.5", ("pow", 0, 3)), "pow(x, 1/2)"),
        ((17, ("pow", 0, 3)), "pow(x, 17)"),
        ((("pow", 0, 1),), "pow(x, y)"),
        # constants, exactly
        (("0.1", 3, ("mul", 3, 4)), "3/10"),
        (("0.1", "0.2", ("add", 3, 4)), "3/10"),
        ((1, 3, ("div", 3, 4)), "1/3"),
        ((2, 10, ("pow", 3, 4)), "1024"),
        ((2, -2, ("pow", 3, 4)), "1/4"),
        (("2.25", ("sqrt", 3)), "3/2"),
        ((0, ("sin", 3)), "0"),
        ((0, ("cos", 3)), "1"),
        ((0, ("exp", 3)), "1"),
        ((1, ("log", 3)), "0"),
        (("-1.5", ("floor", 3)), "-2"),
        (("-1.5", ("ceil", 3)), "-1"),
        (("-1.5", ("fabs", 3)), "3/2"),
        (("-1.5", ("sign", 3)), "-1"),
        ((1, 2, ("lt", 3, 4)), "1"),
        ((2, 2, ("lt", 3, 4)), "0"),
        ((2, 2, ("le", 3, 4)), "1"),
        ((0, ("not", 3)), "1"),
        ((-7, 2, ("fmod", 3, 4)), "-1"),
        ((-7, 2, ("remainder", 3, 4)), "1"),
        ((0, 0, ("atan2", 3, 4)), "0"),
        # branches
        ((1, ("if_else_zero", 3, 0)), "x"),
        ((0, ("if_else_zero", 3, 0)), "0"),
        ((0, ("if_else_zero", 0, 3)), "0"),
    ],
)
def test_identities(steps: tuple[Any, ...], simplified: str) -> None:
    assert text(optimise(build(*steps))) == simplified


@pytest.mark.parametrize(
    "steps",
    [
        ((1, 0, ("div", 3, 4))),  # 1/0
        ((0, 0, ("div", 3, 4))),
        ((-1, ("sqrt", 3))),
        ((-1, ("log", 3))),
        ((2, ("acos", 3))),
        ((0, -1, ("pow", 3, 4))),
        ((-8, "1/3", ("pow", 3, 4))),
        ((1, 0, ("fmod", 3, 4))),
        ((0, ("div", 0, 3))),
        ((0, ("neg", 0), ("div", 4, 3))),
    ],
)
def test_what_has_no_value_is_left_to_run_time(steps: tuple[Any, ...]) -> None:
    program = optimise(build(*steps))
    assert program.instrs[program.output("o0").nodes[0]].op != "const"
    assert not np.isfinite(evaluate(program, {name: [1.5] for name in "xyz"})["o0"]).any()


def test_irrational_constants_have_50_digits() -> None:
    value = optimise(build(2, ("sqrt", 3))).instrs[0].const
    assert isinstance(value, Fraction)
    assert abs(value**2 - 2) < Fraction(1, 10**49)


def test_constants_are_exact_through_a_whole_expression() -> None:
    """0.1 * 3 - 0.3 is 5.6e-17 in float64, and exactly zero as written."""
    program = optimise(lower_expressions("f", LEAVES, [("o0", (x * 0.1) * 0 + ca.SX(0.1) * 3 - 0.3)]))
    lowered = build("0.1", 3, ("mul", 3, 4), "0.3", ("sub", 5, 6), ("mul", 0, 7), ("add", 8, 1))
    assert text(optimise(lowered)) == "y"
    assert text(program) in ("0", "1/18014398509481984") or abs(Fraction(text(program))) < Fraction(1, 10**16)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (("sub", 0, 1), ("sub", 1, 0)),
        (("div", 0, 1), ("div", 1, 0)),
        (("pow", 0, 1), ("pow", 1, 0)),
        (("atan2", 0, 1), ("atan2", 1, 0)),
        (("lt", 0, 1), ("le", 0, 1)),
        (("lt", 0, 1), ("lt", 1, 0)),
        (("fmod", 0, 1), ("remainder", 0, 1)),
        (("fmin", 0, 1), ("fmax", 0, 1)),
        (("sin", 0), ("sin", 1)),
        (("asin", 0), ("atan", 0)),
        (("if_else_zero", 0, 1), ("if_else_zero", 1, 0)),
        (("copysign", 0, 1), ("copysign", 1, 0)),
        (("mul", 0, 0), ("mul", 0, 1)),
    ],
)
def test_near_identities_do_not_merge(one: tuple[Any, ...], other: tuple[Any, ...]) -> None:
    program = optimise(build(one, other, outputs=2))
    assert program.output("o0").nodes != program.output("o1").nodes


def test_close_constants_do_not_merge() -> None:
    close = build("0.1", "0.10000000000000001", ("mul", 0, 3), ("mul", 0, 4), outputs=2)
    program = optimise(close)
    assert program.output("o0").nodes != program.output("o1").nodes


@pytest.mark.parametrize("op", ["add", "mul", "fmin", "fmax", "hypot", "eq", "ne", "and", "or"])
def test_commuted_operands_merge(op: str) -> None:
    program = merge(build((op, 0, 1), (op, 1, 0), outputs=2))
    assert program.output("o0").nodes == program.output("o1").nodes
    assert program.operations()["total"] == 1


def test_equal_products_merge_whatever_their_signs() -> None:
    program = optimise(build(("neg", 0), ("mul", 3, 1), ("mul", 1, 0), outputs=2))
    assert program.operations()["total"] == 1


def test_merging_reaches_through_levels() -> None:
    program = optimise(lower_expressions("f", LEAVES, [("o0", ca.sin(x * y) + z), ("o1", z + ca.sin(y * x))]))
    assert program.output("o0").nodes == program.output("o1").nodes
    assert program.operations() == {"total": 3, "add": 1, "mul": 1, "sin": 1}


def test_differences_of_equals_vanish() -> None:
    assert text(optimise(build(("mul", 0, 1), ("mul", 1, 0), ("sub", 3, 4)))) == "0"


def test_dead_code_is_dropped() -> None:
    program = build(("sin", 0), ("cos", 1), ("exp", 2), ("mul", 0, 1))
    after = drop_dead(program)
    assert [i.op for i in after.instrs] == ["input", "input", "mul"]
    assert after.inputs == program.inputs


def test_zero_over_something_is_zero() -> None:
    """Exact for finite operands that are not zero: what makes absent blocks of a model leave no trace."""
    assert text(optimise(build(0, ("sin", 0), ("div", 3, 4)))) == "0"


def test_x_over_x_stays() -> None:
    """It is 1 but at 0, where it has no value: nothing may hide that."""
    assert text(optimise(build(("div", 0, 0)))) == "div(x, x)"


# ---- schedule ----


@examples(80)
@given(programs(ops=TAME, most=25, outputs=4))
def test_schedule_keeps_the_instructions_and_no_more_alive(program: Program) -> None:
    after = check_legal(schedule(program))
    assert sorted(i.op for i in after.instrs) == sorted(i.op for i in program.instrs)
    assert most_alive(after) <= most_alive(program)
    assert after.operations() == program.operations()


def brute_force_alive(program: Program) -> int:
    """Computed values that are still to be used, or come out, counted after every instruction."""
    outputs = {n for o in program.outputs for n in o.nodes}
    most = 0
    for k in range(len(program.instrs)):
        later = {a for i in program.instrs[k + 1 :] for a in i.args}
        now = set(program.instrs[k].args)  # operands live on while the result is made
        alive = [
            n
            for n in range(k + 1)
            if program.instrs[n].op not in ("input", "const") and (n in later | outputs | now or n == k)
        ]
        most = max(most, len(alive))
    return most


@examples(80)
@given(programs(ops=TAME, most=20))
def test_most_alive_counts_what_it_says(program: Program) -> None:
    program = drop_dead(program)
    assert most_alive(program) == brute_force_alive(program)


def test_schedule_shortens_lives() -> None:
    """All sines first, then all sums: eight values alive; one after the other: two."""
    instrs = [Instr("input", (), ("x", 0))] + [Instr("const", (), Fraction(k + 2)) for k in range(8)]
    instrs += [Instr("mul", (0, k + 1)) for k in range(8)]
    total = 9
    for k in range(10, 17):
        instrs.append(Instr("add", (total, k)))
        total = len(instrs) - 1
    program = Program("f", (Input("x", 1),), tuple(instrs), (Output("o", 1, 1, (total,)),))
    assert most_alive(program) == 9 or most_alive(program) == 8
    assert most_alive(schedule(program)) <= 3


def test_every_instruction_of_a_scene_is_live(scene_programs: list[Program]) -> None:
    for program in scene_programs:
        assert live(program, (n for o in program.outputs for n in o.nodes)) == set(range(len(program.instrs)))
        assert optimise(program) == program


def test_scenes_shrink(scene_programs: list[Program]) -> None:
    """Recorded once; a change for the worse has to be looked at."""
    most = {"double_pendulum_energy": 89, "spacecraft": 76, "spacecraft_smooth": 76}
    for program in scene_programs:
        if program.name in most:
            assert program.operations()["total"] <= most[program.name], (program.name, program.operations())
