"""Programs: text that reads back, legality, lowering, and the interpreters against CasADi's own VM."""

from fractions import Fraction
from typing import Any

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
import servogen as sg
from hypothesis import given
from hypothesis import strategies as st
from servogen.ir.balls import middle
from servogen.ir.evaluate import evaluate, evaluate_exactly, node_values
from servogen.ir.lower import lower_expressions
from servogen.ir.program import IllegalProgramError, Input, Instr, Output, Program, check_legal, live, parse, rebuild
from support.programs import ANY, INPUTS, TAME, examples, programs, random_states

# ---- text ----


@examples(60)
@given(programs(ops=ANY))
def test_text_reads_back(program: Program) -> None:
    assert parse(str(program)) == program
    assert str(parse(str(program))) == str(program)
    assert hash(parse(str(program))) == hash(program)


def test_text_is_as_documented() -> None:
    program = Program(
        "f",
        (Input("m", 1, "parameter"), Input("q", 2)),
        (Instr("input", (), ("m", 0)), Instr("input", (), ("q", 1)), Instr("const", (), Fraction(-1, 3)),
         Instr("mul", (0, 1))),
        (Output("S", 1, 2, (3, 2)), Output("none", 0, 1, ())),
    )  # fmt: skip
    text = (
        "program f\nparameter m[1]\ninput q[2]\n%0 = input m[0]\n%1 = input q[1]\n%2 = const -1/3\n%3 = mul %0 %1\n"
        "output S[1x2] = %3 %2\noutput none[0x1] =\n"
    )
    assert str(program) == text
    assert parse(text) == program


# ---- legality ----

X = Instr("input", (), ("x", 0))


@pytest.mark.parametrize(
    ("inputs", "instrs", "outputs", "words"),
    [
        ((Input("x", 1), Input("x", 2)), (X,), (), "two inputs share a name"),
        ((Input("x", 1),), (X, Instr("sin", (1,))), (), "instruction 1: sin refers to an instruction that is"),
        ((Input("x", 1),), (X, Instr("sin", (2,)), X), (), "instruction 1: sin refers"),
        ((Input("x", 1),), (X, Instr("sin", (-1,))), (), "instruction 1: sin refers"),
        ((Input("x", 1),), (Instr("input", (), ("x", 1)),), (), "instruction 0: input"),
        ((Input("x", 1),), (Instr("input", (), ("x", -1)),), (), "instruction 0: input"),
        ((Input("x", 1),), (Instr("input", (), ("y", 0)),), (), "instruction 0: input"),
        ((Input("x", 1),), (Instr("input", (), Fraction(1)),), (), "instruction 0: input"),
        ((Input("x", 1),), (X, Instr("input", (0,), ("x", 0))), (), "instruction 1: input"),
        ((Input("x", 1),), (Instr("const", (), None),), (), "instruction 0: const"),
        ((Input("x", 1),), (Instr("const", (), ("x", 0)),), (), "instruction 0: const"),
        ((Input("x", 1),), (X, Instr("const", (0,), Fraction(1))), (), "instruction 1: const"),
        ((Input("x", 1),), (X, Instr("erfinv", (0,))), (), "instruction 1: erfinv"),
        ((Input("x", 1),), (X, Instr("add", (0,))), (), "instruction 1: add"),
        ((Input("x", 1),), (X, Instr("sin", (0, 0))), (), "instruction 1: sin"),
        ((Input("x", 1),), (X, Instr("sin", (0,), Fraction(1))), (), "instruction 1: sin"),
        ((Input("x", 1),), (X,), (Output("o", 1, 2, (0,)),), "output o is not 1x2"),
        ((Input("x", 1),), (X,), (Output("o", 1, 1, (1,)),), "output o is not 1x1"),
        ((Input("x", 1),), (X,), (Output("o", 1, 1, (-1,)),), "output o is not 1x1"),
    ],
)  # fmt: skip
def test_what_is_illegal(inputs: Any, instrs: Any, outputs: Any, words: str) -> None:
    with pytest.raises(IllegalProgramError) as error:
        check_legal(Program("f", inputs, instrs, outputs))
    assert words in str(error.value)
    assert "program f" in str(error.value)


def test_two_outputs_of_one_name_are_illegal() -> None:
    outputs = (Output("o", 1, 1, (0,)), Output("o", 1, 1, (0,)))
    with pytest.raises(IllegalProgramError, match="two outputs share a name"):
        check_legal(Program("f", (Input("x", 1),), (X,), outputs))


@examples(50)
@given(programs(ops=ANY))
def test_live_and_rebuild(program: Program) -> None:
    kept = live(program, (n for o in program.outputs for n in o.nodes))
    part = check_legal(rebuild(program, sorted(kept)))
    assert len(part.instrs) == len(kept)
    assert rebuild(program, range(len(program.instrs))) == program


def test_operations_are_free_of_leaves_and_signs() -> None:
    instrs = (
        X,
        Instr("const", (), Fraction(2)),
        Instr("neg", (0,)),
        Instr("mul", (1, 2)),
        Instr("sin", (3,)),
        Instr("sin", (0,)),
    )
    program = Program("f", (Input("x", 1),), instrs, (Output("o", 2, 1, (4, 5)),))
    assert program.operations() == {"total": 3, "mul": 1, "sin": 2}


# ---- lowering ----


@st.composite
def graphs(draw: Any) -> tuple[list[tuple[Input, Any]], list[tuple[str, Any]]]:
    """Random SX over two columns, with CasADi's own abbreviations, and matrices of every shape and sparsity."""
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    pool = [*x.nonzeros(), *p.nonzeros(), ca.SX(0), ca.SX(1), ca.SX(-2), ca.SX(0.1)]
    unary = [
        ca.sin, ca.cos, ca.atan, ca.tanh, ca.fabs, lambda a: -a, lambda a: a * a, lambda a: 2 * a,
        lambda a: 1 / (2 + ca.cos(a)), lambda a: ca.sqrt(1 + a**2), lambda a: a**3, lambda a: (2 + ca.sin(a)) ** 1.5,
        ca.floor, ca.sign, lambda a: ca.exp(ca.sin(a)), lambda a: ca.logic_not(a > 0),
    ]  # fmt: skip
    binary = [
        lambda a, b: a + b, lambda a, b: a - b, lambda a, b: a * b, lambda a, b: a / (3 + ca.sin(b)), ca.fmin, ca.fmax,
        ca.atan2, lambda a, b: a < b, lambda a, b: ca.if_else(a <= b, a, ca.sin(b)), ca.hypot,
        lambda a, b: ca.logic_or(a > 1, ca.logic_and(a < b, b != 0)),
    ]  # fmt: skip
    for _ in range(draw(st.integers(1, 12))):
        a, b = (draw(st.sampled_from(pool)) for _ in range(2))
        build = draw(st.sampled_from(unary + binary))
        pool.append(build(a) if build in unary else build(a, b))
    outputs = []
    for k in range(draw(st.integers(1, 3))):
        rows, columns = draw(st.integers(1, 3)), draw(st.integers(1, 3))
        matrix = ca.SX(rows, columns)  # all structural zeros
        for i in range(rows):
            for j in range(columns):
                if draw(st.booleans()):
                    matrix[i, j] = draw(st.sampled_from(pool))
        outputs.append((f"o{k}", matrix))
    return [(Input("x", 3), x), (Input("p", 2, "parameter"), p)], outputs


@examples(70)
@given(graphs(), st.integers(0, 2**32 - 1))
def test_lowered_programs_agree_with_casadi(graph: Any, seed: int) -> None:
    inputs, outputs = graph
    program = lower_expressions("f", inputs, outputs)
    function = ca.Function("f", [s for _, s in inputs], [ca.densify(e) for _, e in outputs])
    rng = np.random.default_rng(seed)
    states = {"x": np.round(rng.uniform(-3, 3, (4, 3)), 1), "p": np.round(rng.uniform(-3, 3, (4, 2)), 1)}
    values = evaluate(program, states)
    for n in range(4):
        for (label, _), true in zip(
            outputs, function.call([ca.DM(states["x"][n]), ca.DM(states["p"][n])]), strict=True
        ):
            assert values[label][n].shape == true.shape
            np.testing.assert_allclose(values[label][n], true.full(), rtol=1e-10, atol=1e-10)


def test_matrices_go_row_by_row() -> None:
    x = ca.SX.sym("x", 6)
    matrix = ca.reshape(x, 3, 2)  # columns first: [[x0, x3], [x1, x4], [x2, x5]]
    program = lower_expressions("f", [(Input("x", 6), x)], [("M", matrix), ("T", matrix.T)])
    values = evaluate(program, {"x": np.arange(6.0)})
    assert values["M"][0].tolist() == [[0, 3], [1, 4], [2, 5]]
    assert values["T"][0].tolist() == [[0, 1, 2], [3, 4, 5]]
    leaves = [program.instrs[n].const for n in program.output("M").nodes]
    assert leaves == [("x", 0), ("x", 3), ("x", 1), ("x", 4), ("x", 2), ("x", 5)]


def test_sparse_matrices_are_filled_with_zeros() -> None:
    x = ca.SX.sym("x", 2)
    matrix = ca.SX(2, 3)
    matrix[1, 0], matrix[0, 2] = x[1], x[0]
    program = lower_expressions("f", [(Input("x", 2), x)], [("M", matrix)])
    assert evaluate(program, {"x": [5.0, 7.0]})["M"][0].tolist() == [[0, 0, 5], [7, 0, 0]]


def test_lowering_refuses_what_has_no_row() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(
        sg.SceneError, match=rf"routine f, instruction \d: op erfinv \(CasADi id {ca.OP_ERFINV}\).*ir/ops.py"
    ):
        lower_expressions("f", [(Input("x", 1), x)], [("o", ca.erfinv(x))])
    with pytest.raises(sg.SceneError, match="constant is inf"):
        lower_expressions("f", [(Input("x", 1), x)], [("o", x + ca.inf)])


# ---- interpreters ----


@examples(80)
@given(programs(ops=TAME), st.integers(0, 2**32 - 1))
def test_interpreters_agree(program: Program, seed: int) -> None:
    states = random_states(seed)
    values, narrow = evaluate(program, states), evaluate(program, states, np.float32)
    jumps = any(i.op in ("lt", "le") for i in program.instrs)
    for n, exact in enumerate(evaluate_exactly(program, states)):
        for name, entries in exact.items():
            assert narrow[name].dtype == np.float32
            true = np.array([float(x) for x in entries])
            if not jumps:
                np.testing.assert_allclose(values[name][n].ravel(), true, rtol=1e-9, atol=1e-9)


def test_states_that_are_given_once_hold_for_all() -> None:
    x = Instr("input", (), ("x", 0)), Instr("input", (), ("k", 0)), Instr("add", (0, 1))
    program = Program("f", (Input("x", 1), Input("k", 1)), x, (Output("o", 1, 1, (2,)), Output("c", 1, 1, (1,))))
    states = {"x": [[1.0], [2.0]], "k": [10.0]}
    assert evaluate(program, states)["o"].ravel().tolist() == [11, 12]
    assert [float(v["o"][0]) for v in evaluate_exactly(program, states)] == [11, 12]
    assert evaluate(program, states)["c"].shape == (2, 1, 1)


def test_balls_hold_the_value_and_are_small() -> None:
    instrs = (Instr("const", (), Fraction(1, 3)), Instr("sin", (0,)))
    program = Program("f", (), instrs, (Output("o", 1, 2, (0, 1)),))
    third, sine = next(evaluate_exactly(program, {}))["o"]
    with mp.workdps(70):
        for found, true in ((third, mp.mpf(1) / 3), (sine, mp.sin(mp.mpf(1) / 3))):
            number = middle(found)
            missed = abs(mp.mpf(number.numerator) / number.denominator - true)
            assert missed <= mp.mpf(float(found.rad())) < mp.mpf(10) ** -58


@pytest.mark.parametrize(
    ("op", "args"),
    [
        ("sqrt", (-1,)),
        ("log", (-1,)),
        ("acos", (2,)),
        ("div", (0, 0)),
        ("div", (1, 0)),
        ("pow", (-1, 0.5)),
        ("fmod", (1, 0)),
    ],
)
def test_what_has_no_value_is_not_finite(op: str, args: tuple[float, ...]) -> None:
    instrs = (*(Instr("const", (), Fraction(a)) for a in args), Instr(op, tuple(range(len(args)))))
    program = Program("f", (), instrs, (Output("o", 1, 1, (len(args),)),))
    assert next(evaluate_exactly(program, {}))["o"][0].is_nan()
    assert not np.isfinite(evaluate(program, {})["o"]).any()


def test_constants_beyond_the_type_are_infinite() -> None:
    program = Program(
        "f", (), (Instr("const", (), Fraction(10) ** 400), Instr("neg", (0,))), (Output("o", 1, 1, (1,)),)
    )
    assert node_values(program, {})[0][0] == np.inf
    assert evaluate(program, {}, np.float32)["o"][0, 0, 0] == -np.inf


def test_constants_are_rounded_once() -> None:
    """Just above half an ulp: through float64 it would be a tie, and go to even."""
    value = 1 + Fraction(1, 2**24) + Fraction(1, 2**60)
    program = Program("f", (), (Instr("const", (), value),), (Output("o", 1, 1, (0,)),))
    assert evaluate(program, {}, np.float32)["o"][0, 0, 0] == np.float32(1 + 2.0**-23)


def test_inputs_are_as_support_says() -> None:
    assert [i.name for i in INPUTS] == ["p", "x", "k"]
