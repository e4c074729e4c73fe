"""The formulas of the page: read back from their MathML and evaluated, they are the program."""

import math
import xml.etree.ElementTree as ET
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.compiler import derived_scene, optimised_scene
from servogen.ir.evaluate import evaluate
from servogen.ir.lower import lower_expressions
from servogen.ir.program import Input, Program
from servogen.loading import builtin_names, load_scene
from servogen.plan.module import Target
from servogen.plan.planner import plan
from servogen.report.equations import _written, equations
from servogen.report.formulas import LARGEST, Formulas, formulas
from servogen.report.mathml import formula, symbol
from servogen.report.mathml import math as mathml
from servogen.report.sparsity import kinds, picture

FUNCTIONS = {"sin": math.sin, "cos": math.cos, "abs": abs}


def read(element: Any, values: dict[str, float]) -> str:
    """MathML as Python: what stands side by side is multiplied."""
    text = ET.tostring(element, encoding="unicode")
    if text in values:
        return repr(values[text])
    parts = [read(child, values) for child in element]
    if element.tag == "mn":
        return str(element.text)
    if element.tag == "mo":
        return {"−": "-", "·": "*", "|": "|"}.get(element.text, element.text)
    if element.tag == "mi":
        return str(element.text)
    if element.tag == "mspace":
        return ""
    if element.tag == "mfrac":
        return f"(({parts[0]})/({parts[1]}))"
    if element.tag == "msqrt":
        return f"({parts[0]})**0.5"
    if element.tag == "msup":
        return f"{parts[0]}^{parts[1]}" if parts[0] in FUNCTIONS else f"(({parts[0]})**({parts[1]}))"
    if element.tag == "msubsup":
        base, index, power = (ET.tostring(child, encoding="unicode") for child in element)
        return f"(({values[f'<msub>{base}{index}</msub>']!r})**({power.removeprefix('<mn>').removesuffix('</mn>')}))"
    assert element.tag == "mrow", text
    return _row([p for p in parts if p])


def _row(parts: list[str]) -> str:
    head, _, power = parts[0].partition("^")
    if head in FUNCTIONS:
        argument = "".join(parts[1:])
        return f"({head}({argument})**{power or 1})"
    joined = parts[0]
    for before, part in pairwise(parts):
        touching = before not in ("+", "-", "*", "(") and part not in ("+", "-", "*", ")")
        joined += ("*" if touching else "") + part
    return f"({joined})"


def value(element: Any, values: dict[str, float]) -> float:
    return float(eval(read(element, values), {"__builtins__": {}}, FUNCTIONS))


def evaluated(shown: Formulas, values: dict[str, float]) -> dict[str, Any]:
    """The entries of each line, its definitions first."""
    values = dict(values)
    for line in shown.definitions:
        left, _, right = ET.fromstring(line)
        values[ET.tostring(left, encoding="unicode")] = value(right, values)
    found = {}
    for line in shown.lines:
        left, _, right = ET.fromstring(line)
        cells = right.findall("mtr/mtd") if right.tag == "mtable" else [[right]]
        found[ET.tostring(left, encoding="unicode")] = [value(cell[0], values) for cell in cells]
    return found


def agree(program: Program) -> None:
    rng = np.random.default_rng(5)
    inputs = {i.name: rng.uniform(0.5, 2.0, (1, i.size)) for i in program.inputs}
    names = {(i.name, k): f"{i.name}_{k}" for i in program.inputs for k in range(i.size)}
    values = {symbol(name): float(inputs[n][0, k]) for (n, k), name in names.items()}
    found = evaluated(formulas(program, lambda n, k: names[n, k]), values)
    for o in program.outputs:
        expected = evaluate(program, inputs)[o.name].ravel()
        np.testing.assert_allclose(found[symbol(o.name)], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "name", ["double_pendulum_energy", "double_pendulum_energy_and_path", "spacecraft_smooth", "quaternion_pointing"]
)
def test_what_is_shown_is_what_is_computed(name: str) -> None:
    program = optimised_scene(load_scene(name))[1].program
    kept = tuple(o for o in program.outputs if not o.name.startswith("mass_"))
    agree(Program(program.name, program.inputs, program.instrs, kept))


def test_signs_powers_and_brackets() -> None:
    a, b, c = (ca.SX.sym(n) for n in "abc")
    odd = [a - (b - c), -(a + b) * c, -a / (b * c), (a + b) ** 2 / (a - 3 * c) ** 2, -(a * b) + c, a - -b]
    odd += [0.5 * a - 0.1 * b, ca.sin(a) ** 3 * ca.cos(a - b) * c, ca.sqrt(a * b) / 12, a / 3 - b * (-2), ca.sin(-a)]
    odd += [1 / (1 + 1 / a), a * (b / c) * (c + 1), 1e-7 * a, 2.5e9 * b, 123456.789 * b, -1 / 12 * a]
    agree(
        lower_expressions(
            "odd", [(Input(n, 1), s) for n, s in zip("abc", (a, b, c), strict=True)], [("y", ca.vertcat(*odd))]
        )
    )


def as_text(element: Any) -> str:
    """MathML as one would type it."""
    parts = [as_text(child) for child in element]
    match element.tag:
        case "mfrac":
            return f"({parts[0]})/({parts[1]})"
        case "msub":
            return "_".join(parts)
        case "msup" | "msubsup":
            return "_".join(parts[:-1]) + "^" + parts[-1]
        case "mspace":
            return " "
    return "".join(parts) or str(element.text)


def test_it_is_written_as_a_person_would() -> None:
    m, v, w, x = (ca.SX.sym(n) for n in ("m_B", "omega_0", "omega_1", "x"))
    wanted = {
        0.5 * (m * v**2 + x): "(1)/(2) m_B ω_0^2+(x)/(2)",
        v * m * w / 2 + w * v * m / 2: "m_B ω_0 ω_1",
        x - (-v): "x+ω_0",
        -(v - x) * m: "−m_B (ω_0−x)",
        (m * x * v) / (x * w): "(m_B ω_0)/(ω_1)",
        2 * x - x - x: "0",
        ca.sin(x) ** 2 * x * m: "m_B x sin^2 x",
        ca.power(v, 3) * 0.25: "(ω_0^3)/(4)",
        3 * (v + 2 * w): "3 (ω_0+2 ω_1)",
        -x: "−x",
        -0.3 * x: "−0.3 x",
        1 * x + 0 * v: "x",
    }
    inputs = [(Input(s.name(), 1), s) for s in (m, v, w, x)]
    shown = formulas(lower_expressions("p", inputs, [(f"y{k}", e) for k, e in enumerate(wanted)]), lambda name, _: name)
    written = [as_text(ET.fromstring(line)).partition("=")[2] for line in shown.lines]
    assert written == list(wanted.values())


def test_what_nobody_reads_is_counted() -> None:
    x = ca.SX.sym("x")
    long = x
    for k in range(LARGEST + 1):
        long = ca.sin(long) + k
    shown = formulas(lower_expressions("long", [(Input("x", 1), x)], [("y", long)]), lambda n, k: n)
    assert shown.lines == ()
    assert shown.operations > LARGEST


@pytest.mark.parametrize("name", [n for n in builtin_names() if load_scene(n).mechanism.u.size1() < 3])
def test_all_of_a_scene_is_well_formed(name: str) -> None:
    scene = load_scene(name)
    shown = equations(scene, optimised_scene(scene)[0], sg.build(scene).module)
    parts = [f for _, f in (*shown.written, *shown.computed)]
    assert all(f.lines for f in parts)
    for line in [x for f in parts for x in (*f.definitions, *f.lines)] + [x for x, _, _ in shown.derived]:
        ET.fromstring(line)
    assert {x.partition(",")[0] for x, _ in shown.written} >= {"The mechanism", scene.constraints[0].name}


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("psi_u Q^-1 G", "ψuQ−1G"),
        ("-psi_q C Q^-1 P - X + Theta1 psi' + Theta2 psi", "−ψqCQ−1P−X+Θ1ψ′+Θ2ψ"),
        ("J^T (J Q^-1 J^T)^+ (b - J Q^-1 P)", "JT(JQ−1JT)+(b−JQ−1P)"),
        ("L^-T, its nonzeros", "L−T,itsnonzeros"),
        ("psi^(4) = T0 psi + T1 psi', psi^(r-1)", "ψ(4)=T0ψ+T1ψ′,ψ(r−1)"),
    ],
)
def test_textbook_formulas(text: str, wanted: str) -> None:
    assert "".join(ET.fromstring(formula(text)).itertext()) == wanted


def test_symbols_as_the_user_named_them() -> None:
    shown = {n: "".join(ET.fromstring(symbol(n)).itertext()) for n in ("theta_0", "m_B", "r_dot_1", "velocity", "c12")}
    assert shown == {"theta_0": "θ0", "m_B": "mB", "r_dot_1": "r′1", "velocity": "velocity", "c12": "c12"}


def test_pictures_tell_what_an_entry_depends_on() -> None:
    p, q = ca.SX.sym("p"), ca.SX.sym("q")
    matrix = ca.vertcat(ca.horzcat(0, 2), ca.horzcat(p * p, p + q))
    program = lower_expressions("m", [(Input("p", 1, "parameter"), p), (Input("q", 1), q)], [("M", matrix)])
    assert kinds(program, "M") == [["zero", "number"], ["parameters", "state"]]
    root = ET.fromstring(picture("M", kinds(program, "M")))
    assert [t.text for t in root.iter("title")][3] == "M[1][1]: of the state"


def test_what_prepare_computes_has_no_name_of_the_users() -> None:
    """A parameter called c: the computed c0, c1, ... of the C are other letters on the page."""
    q, u, tau = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau", 2)
    p = sg.Parameters(c=sg.Parameter([2.0, 0.3]), m=sg.Parameter(3.0))
    mechanism = sg.Mechanism(q=q, u=u, tau=tau, Q=p.m * ca.SX.eye(2), P=-p.c * u, G=ca.SX.eye(2) / p.c[0])
    scene = sg.Scene("friction", mechanism, [sg.Nonholonomic("still", u, Theta=-1.0)], parameters=p)
    formulation, program = optimised_scene(scene)
    module = plan(formulation, program, Target("float64", "friction"))
    assert [f.name for f in module.model if f.name not in ("c", "m")]
    shown = dict(equations(scene, formulation, module).computed)["Once, in prepare"]
    names = {"".join(ET.fromstring(line).itertext()).split("=")[0] for line in shown.lines}
    assert not names & {"c", "c0", "c1", "m"}


def test_passive_constraints_are_told() -> None:
    """The loop and its forces, and of S and z formulas that hold with them; the paper numbers none of these."""
    scene = load_scene("four_bar")
    formulation = derived_scene(scene)[0]
    told = {q.name: (q.equation, q.formula) for q in formulation.quantities}
    assert told["psi"][0] == "Eq. (3)"
    assert told["S"] == ("", "psi_u N G, N = Q^-1 - Q^-1 J^T A^-1 J Q^-1, A = J Q^-1 J^T")
    assert told["z"] == ("", "-psi_u N P + psi_u Q^-1 J^T A^-1 j - X + Theta psi")
    written = dict(_written(scene))
    assert formula("Q u' = P + G tau + J^T lam") in written["The mechanism"].lines[0]
    first, chi = written["loop, passive"].lines
    assert first == mathml(formula("chi = 0"))
    assert "<mi>χ</mi>" in chi
