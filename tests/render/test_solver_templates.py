"""The solver's templates: clean under strict flags, nothing emitted that the shape does not need, float32 pure."""

import re
import subprocess
from pathlib import Path

import jinja2
import pytest
from servogen.plan.solver import plan_solver
from servogen.render.literals import literal
from servogen.render.solver_context import solver_context
from servogen.render.unused import without_unused
from servogen.results import OF_LIMITS, OF_PASSIVE, Status
from servogen.results import Path as SolverPath
from servogen.scene.solver import Solver

STRICT = (
    "-std=c99 -Wall -Wextra -Wpedantic -Wconversion -Wdouble-promotion -Wmissing-prototypes -Wshadow -Werror "
    "-ffp-contract=off"
).split()

TEMPLATES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parents[2] / "codegen" / "servogen" / "render" / "templates"),
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)

SOLVERS = {
    "default": Solver(),
    "raw": Solver(rank="raw"),
    "damped": Solver(damping=1e-2, atol=1e-6),
    "raw, damped": Solver(rank="raw", damping=0.1),
    "svd": Solver(method="svd"),
    "cod": Solver(method="cod"),
}

SHAPES = [(1, 1), (1, 3), (3, 1), (2, 2), (2, 3), (3, 2), (3, 7), (12, 12)]


def render(m, l, scalar, solver):
    """A whole C file around the templates, prefix pinv."""
    plan = plan_solver(m, l, scalar, solver)
    context = solver_context(plan, "pinv", lambda value: literal(value, scalar))
    uses = f"int use(const {plan.real} *S, const {plan.real} *z, {plan.real} *x, pinv_info *info);\n"
    uses += f"int use(const {plan.real} *S, const {plan.real} *z, {plan.real} *x, pinv_info *info)\n"
    uses += "{ return pinv_solve_core(S, z, NULL, x, info) + pinv_pinv_core(S, x, info); }\n"
    parts = [
        TEMPLATES.get_template(f"{name}.j2").render(context)
        for name in ("number.c", "solver/info.h", "solver/solver.c")
    ]
    text = "\n".join(["#include <math.h>\n#include <stddef.h>\n#include <stdint.h>", *parts, uses])
    return without_unused(text)  # as a package is printed


def compile_text(text, compiler, folder, *flags):
    source = folder / "pinv.c"
    source.write_text(text)
    return subprocess.run(
        [compiler, *STRICT, *flags, "-c", str(source), "-o", str(folder / "pinv.o")], capture_output=True, text=True
    )


def test_context_names_every_status_and_path():
    context = solver_context(plan_solver(2, 3, "float64", Solver()), "pinv_2x3", str)
    assert {name for name, _, _ in context["statuses"]} == {
        s.name for s in Status if s not in (*OF_LIMITS, *OF_PASSIVE)
    }
    assert {name for name, _, _ in context["paths"]} == set(SolverPath.__members__)
    assert context["P"] == "PINV_2X3"


@pytest.mark.parametrize(
    ("shape", "scalar", "compiler"),
    [(s, x, c) for s in SHAPES[:-1] for x in ("float64", "float32") for c in ("gcc", "clang")]
    + [(SHAPES[-1], "float64", "gcc")],  # the largest takes as long as all others, and is printed like 3x7
)
def test_strict_flags(shape, scalar, compiler, tmp_path, need_tool):
    """gcc finds what is not set while it optimises, clang finds all before it does."""
    need_tool(compiler, compiler)
    level = "-O0" if compiler == "clang" else "-O1" if shape == SHAPES[-1] else "-O2"
    for solver in SOLVERS.values():
        done = compile_text(render(*shape, scalar, solver), compiler, tmp_path, level)
        assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("solver", [Solver(damping=1e35), Solver(atol=1e35)])
@pytest.mark.parametrize("shape", [(1, 1), (1, 2)])
def test_strict_flags_where_no_row_is_in_range(shape, solver, tmp_path, need_tool):
    need_tool("gcc", "gcc")
    done = compile_text(render(*shape, "float32", solver), "gcc", tmp_path, "-O2")
    assert done.returncode == 0, done.stderr


def test_strict_flags_can_fail(tmp_path, need_tool):
    need_tool("gcc", "gcc")
    text = render(2, 3, "float32", Solver()) + "static int unused(void) { return 0; }\n"
    assert compile_text(text, "gcc", tmp_path).returncode != 0


@pytest.mark.parametrize(("shape", "wanted"), [((1, 3), False), ((3, 1), False), ((2, 2), True)])
def test_svd_only_where_needed(shape, wanted):
    assert ("_svd(" in render(*shape, "float64", Solver())) is wanted


def test_two_rows_need_no_iteration():
    assert "_jacobi(" not in render(2, 3, "float64", Solver())
    assert "_jacobi(" in render(3, 3, "float64", Solver())


def test_svd_method_leaves_the_normal_equations_out():
    assert "_normal_factor" not in render(3, 7, "float64", Solver(method="svd"))


def test_scaling_is_undone_only_under_the_scaled_policy():
    assert "_undo_scaling" in render(2, 3, "float64", Solver())
    assert "_undo_scaling" not in render(2, 3, "float64", Solver(rank="raw"))


@pytest.mark.parametrize("shape", SHAPES)
def test_float32_has_no_double(shape):
    text = re.sub(r"/\*.*?\*/", "", render(*shape, "float32", SOLVERS["damped"]), flags=re.DOTALL)
    assert not re.search(r"\bdouble\b", text)
    assert not re.search(r"\bsqrt\(", text)
    floats = re.findall(r"(?<![\w.])(?:\d+\.\d*|\.\d+|\d+)(?:e[+-]?\d+)?f?\b", text)
    assert floats
    assert not [t for t in floats if ("." in t or "e" in t) and not t.endswith("f")]


def test_no_double_arithmetic_on_a_cortex_m4(tmp_path, need_tool):
    need_tool("arm-none-eabi-gcc", "gcc-arm-none-eabi")
    flags = ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-O2")
    done = compile_text(render(3, 7, "float32", SOLVERS["damped"]), "arm-none-eabi-gcc", tmp_path, *flags)
    assert done.returncode == 0, done.stderr
    names = subprocess.run(["arm-none-eabi-nm", str(tmp_path / "pinv.o")], capture_output=True, text=True, check=True)
    assert "__aeabi_d" not in names.stdout


def test_only_sqrt_is_called():
    text = re.sub(r"/\*.*?\*/", "", render(3, 7, "float64", SOLVERS["damped"]), flags=re.DOTALL)
    calls = set(re.findall(r"\b([a-zA-Z_]\w*)\(", text))
    assert {c for c in calls if not c.startswith("pinv_")} <= {
        "sqrt",
        "for",
        "if",
        "UINT64_C",
        "use",
        "int",
        "defined",
        "__attribute__",
        "_Pragma",
    }


def test_enumerators_are_those_of_python(tmp_path):
    text = render(2, 3, "float64", Solver())
    found = {name: int(value) for name, value in re.findall(r"^    PINV_(\w+) = (-?\d+)", text, flags=re.MULTILINE)}
    expected = {s.name: int(s) for s in Status if s not in (*OF_LIMITS, *OF_PASSIVE)} | {
        f"PATH_{path.name}": int(path) for path in SolverPath
    }
    assert found == expected


def test_same_plan_same_bytes():
    assert render(3, 7, "float64", SOLVERS["damped"]) == render(3, 7, "float64", SOLVERS["damped"])
