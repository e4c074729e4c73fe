"""The law: it prints and reads back, broken ones are refused by name, and every step has all its columns."""

import re
from dataclasses import replace
from importlib.resources import files

import casadi as ca
import pytest
import servogen as sg
from servogen.compiler import compile_scene, derived_scene, target_for
from servogen.law.law import IllegalLawError, Law, Routine, check_legal, of_the_state, parse, shapes
from servogen.law.steps import (
    STEPS,
    SYSTEM,
    Advance,
    Apply,
    Call,
    Cascade,
    Evaluate,
    Invert,
    Multiply,
    Project,
    React,
    Solve,
    row_of,
)
from servogen.plan.module import Target
from servogen.plan.planner import plan_solver_only
from servogen.verify.answers import ANSWERS
from servogen.verify.exact_steps import EXACT
from servogen.verify.truth import Truth, states_to_check
from servogen.verify.vectors import ANY_ANSWER, ANY_STATUS
from support.models import awkward_scenes, random_scene

LAWS = [
    derived_scene(random_scene(3, "mixed", y="input"))[0].law,
    derived_scene(random_scene(3, "controls", y=lambda m: -m.mechanism.tau))[0].law,
    derived_scene(awkward_scenes()["one_control"])[0].law,
    plan_solver_only(2, 3, Target("float64", "p"), sg.Solver()).law,
]


def ideal() -> Law:
    scene = random_scene(7, "nonholonomic")
    weight = ca.diag(ca.SX([1, 2, 3]))
    return derived_scene(replace(scene, mode="ideal", weight=weight, y="input"))[0].law


@pytest.mark.parametrize("law", [*LAWS, ideal()], ids=lambda law: law.name)
def test_prints_and_reads_back(law: Law) -> None:
    assert parse(str(law)) == law
    assert check_legal(law) is law


def test_a_law_with_priorities_prints_its_levels() -> None:
    law = _with(Cascade("x", SYSTEM, "S", "z", ((1,), (0,)), "in.y"))
    assert "x = cascade solver=system matrix=S right=z levels=1;0 free=in.y" in str(law)
    assert parse(str(law)) == check_legal(law)


def test_an_ideal_law_reads_as_the_paper_does() -> None:
    """Eqs. (16)-(17): the reaction, the system solved in the metric of W, and back."""
    words = [row_of(step).word for step in ideal().routine("control").steps]
    assert words == ["evaluate", "react", "solve", "multiply"]
    assert [r.name for r in ideal().routines] == ["pinv", "R", "control"]
    assert shapes(ideal())["R"] == (3, 1)


SOUND = Law(
    "sound",
    inputs=(("y", (3, 1)),),
    quantities=(("S", (2, 3)), ("z", (2, 1)), ("N", (4, 1)), ("J", (2, 5)), ("M", (2, 2)), ("b", (2, 1))),
    solvers=((SYSTEM, (2, 3)), ("reaction", (2, 2))),
    entries=(("S",), ("S", "z")),
    routines=(
        Routine("R", (Evaluate(("M", "b", "J")), React("R", "reaction", "M", "b", "J")), "R", info=False),
        Routine(
            "control",
            (
                Evaluate(("S", "z", "N")),
                Solve("x", SYSTEM, "S", "z", "in.y"),
                Multiply("tau", "N", "x", (((0, 0), (1, 2)), ((2, 1),), ((3, 2),))),
            ),
            "tau",
        ),
    ),
)


def _with(step: object, place: int = 1, routine: int = 1) -> Law:
    """SOUND with one step of a routine replaced."""
    changed = SOUND.routines[routine]
    steps = (*changed.steps[:place], step, *changed.steps[place + 1 :])
    routines = list(SOUND.routines)
    routines[routine] = replace(changed, steps=steps)
    return replace(SOUND, routines=tuple(routines))


BROKEN = {
    "reads before": (_with(Solve("x", SYSTEM, "S", "w")), "step 1: solve reads w before any step leaves it"),
    "no quantity": (_with(Evaluate(("S", "q")), 0), "evaluate asks for q, which is no quantity"),
    "shapes": (_with(Solve("x", SYSTEM, "S", "N")), "S of 2 x 3 and N of 4 x 1"),
    "free of another size": (_with(Solve("x", SYSTEM, "S", "z", "z")), "S of 2 x 3 and the free z"),
    "solver of another shape": (_with(Solve("x", "reaction", "S", "z")), "its solver reaction takes (2, 2)"),
    "no solver": (_with(Solve("x", "other", "S", "z")), "its solver other takes None"),
    "twice": (_with(Solve("S", SYSTEM, "S", "z")), "leaves S a second time"),
    "no result": (_with(Solve("tau", SYSTEM, "S", "z")), "multiply reads x before"),
    "pattern": (_with(Multiply("tau", "N", "x", (((9, 0),),)), 2), "an entry that N has not"),
    "column": (_with(Multiply("tau", "N", "x", (((0, 3),),)), 2), "a column beyond x"),
    "reaction": (_with(React("R", "reaction", "M", "z", "J"), 1, 0), "reads z before any step"),
    "at hand without a matrix": (_with(Apply("x", SYSTEM, "T", "z")), "needs T, which is not there"),
    "levels": (_with(Cascade("x", SYSTEM, "S", "z", ((0,), (0,)))), "levels that do not hold each of the 2 rows once"),
    "a level of none": (_with(Cascade("x", SYSTEM, "S", "z", ((0, 1), ()))), "levels that do not hold each of the 2"),
    "no cap": (_with(Project("tau", SYSTEM, "in.y", "z", "S", 0), 2), "a cap of no steps"),
    "argument": (_with(Invert("x", SYSTEM, "any")), "reads any before"),
    "entry": (replace(SOUND, entries=(("nothing",),)), "an entry hands out nothing, which is no quantity"),
    "two of a name": (replace(SOUND, routines=SOUND.routines[:1] * 2), "two routines share a name"),
    "result": (replace(SOUND, routines=(replace(SOUND.routines[0], result="S"),)), "no step leaves its result S"),
}


def _control(*steps: object, info: bool = True) -> Law:
    """SOUND with another control."""
    routine = replace(SOUND.routines[1], steps=steps, result=steps[-1].into, info=info)  # type: ignore[attr-defined]
    return replace(SOUND, routines=(SOUND.routines[0], routine))


FIRST, SOLVE = Evaluate(("S", "z", "M", "b", "J")), Solve("tau", SYSTEM, "S", "z", "in.y")
SAME = Multiply("out", "N", "tau", (((0, 0),), ((1, 1),), ((2, 2),)))

UNPRINTABLE = {
    "two solves": (
        _control(FIRST, Solve("x", SYSTEM, "S", "z"), Solve("tau", SYSTEM, "S", "z", "x")),
        "control: evaluate, solve, solve cannot be printed",
    ),
    "no solve behind": (_control(FIRST, React("R", "reaction", "M", "b", "J")), "evaluate, react cannot be printed"),
    "a solve without info": (_control(FIRST, SOLVE, info=False), "evaluate, solve without info cannot be printed"),
    "an inverse behind": (
        _control(FIRST, SOLVE, Invert("i", SYSTEM, "S")),
        "evaluate, solve, invert cannot be printed",
    ),
    "a projection behind": (
        _control(FIRST, SOLVE, Project("near", SYSTEM, "in.y", "z", "S", 2)),
        "evaluate, solve, project cannot be printed",
    ),
    "an evaluation behind": (
        _control(FIRST, Evaluate(("N",)), SOLVE, SAME),
        "evaluate, evaluate, solve, multiply cannot be printed",
    ),
    "a solve of the state alone": (
        replace(
            SOUND,
            routines=(Routine("solve", (SOLVE,), "tau", (("S", (2, 3)), ("z", (2, 1)))),),
        ),
        "solve cannot be printed: it takes no state, and in.y is no argument",
    ),
    "calls alone": (
        replace(SOUND, routines=(*SOUND.routines, Routine("twice", (Call("a", "control"), Call("c", "control")), "c"))),
        "twice: call, call cannot be printed",
    ),
    "a call that does not see the advance": (
        replace(
            SOUND,
            routines=(
                *SOUND.routines,
                Routine(
                    "tick",
                    (Call("rate", "control"), Advance("on", "in.y", "rate", "dt"), Call("end", "control")),
                    "end",
                    (("dt", (1, 1)),),
                ),
            ),
        ),
        "tick: call, advance, call cannot be printed",
    ),
    "two reactions": (
        replace(
            SOUND,
            routines=(
                *SOUND.routines,
                Routine("R2", (Evaluate(("M", "z", "J")), React("R2", "reaction", "M", "z", "J")), "R2", info=False),
            ),
        ),
        "two different steps react",
    ),
}


@pytest.mark.parametrize("what", UNPRINTABLE)
def test_routines_that_have_no_c_are_refused_by_name(what: str) -> None:
    law, words = UNPRINTABLE[what]
    with pytest.raises(IllegalLawError, match=re.escape(words)):
        check_legal(law)


def test_every_law_that_is_derived_can_be_printed() -> None:
    for law in (*LAWS, ideal(), SOUND):
        assert {r.form for r in law.routines} <= {"step", "evaluation", "tick"}, law.name


def test_the_sound_one_is_legal() -> None:
    assert check_legal(SOUND) is SOUND


@pytest.mark.parametrize("what", BROKEN)
def test_broken_laws_are_refused_by_name(what: str) -> None:
    law, words = BROKEN[what]
    with pytest.raises(IllegalLawError, match=re.escape(words)):
        check_legal(law)


def test_every_step_has_all_its_columns() -> None:
    """C for each step, and an exact answer for those that work on what an evaluation left."""
    templates = files("servogen.render") / "templates"
    text = (templates / "steps.c.j2").read_text()
    for row in STEPS.values():
        assert f"macro call_{row.word}(" in text or f"macro run_{row.word}(" in text, row.word
    walked_by_truth = {"evaluate", "project", "advance", "call", "invert", "limit"}
    assert {row_of.word for kind, row_of in STEPS.items() if kind in ANSWERS} | walked_by_truth == {
        row.word for row in STEPS.values()
    }
    assert len({row.word for row in STEPS.values()}) == len(STEPS)
    assert set(EXACT) == set(ANSWERS)


def test_steps_say_only_the_statuses_of_their_rows() -> None:
    """At states of the domain and at boundary ones, NaN and huge numbers among them."""
    for name in ("plain", "one_cubic", "everything"):
        scene = awkward_scenes()[name]
        module = compile_scene(scene, target_for(scene.name, "float64", None))
        truth = Truth(scene, module, states_to_check(scene, 3)[0], 3)
        for routine in module.law.routines:
            if not of_the_state(routine):
                continue
            steps = [s for r in module.law.routines if r is routine or routine.name == "step" for s in r.steps]
            told = {status for step in steps for status in row_of(step).statuses}
            seen = {a.status for a in truth.answers(routine.name)} - {ANY_ANSWER, ANY_STATUS}
            assert seen <= {0, *told}, (name, routine.name)
