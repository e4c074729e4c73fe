"""Names that reach the C, and texts that stand in its comments."""

import re
import shutil
import subprocess

import casadi as ca
import pytest
import servogen as sg
from servogen.compiler import target_for
from servogen.scene.names import HEADERS, check_identifier, comment_safe
from support.c import STRICT, compiler, run
from support.missing import skip_or_fail


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("double", "a C keyword"),
        ("restrict", "a C keyword"),
        ("class", "a C++ keyword"),
        ("new", "a C++ keyword"),
        ("xor", "a C++ keyword"),
        ("I", "a standard macro"),
        ("NULL", "a standard macro"),
        ("NAN", "a standard macro"),
        ("M_PI", "a standard macro"),
        ("OVERFLOW", "a standard macro"),
        ("_Bool", "reserved"),
        ("__x", "reserved"),
        ("q", "collides with the input q"),
        ("u", "collides with the input u"),
        ("t", "collides with the input t"),
        ("tau", "collides with the input tau"),
        ("y", "collides with the input y"),
        ("dt", "collides with a keyword of the controller's calls"),
        ("last", "collides with a keyword of the controller's calls"),
        ("2nd", "not a C identifier"),
        ("m-B", "not a C identifier"),
        ("länge", "not a C identifier"),
        ("a b", "not a C identifier"),
        ("", "not a C identifier"),
        ("a\n", "not a C identifier"),
    ],
)
def test_names_of_parameters_and_references(name: str, why: str) -> None:
    with pytest.raises(sg.SceneError, match=re.escape(why)) as error:
        sg.Parameters(**{name: 1.0})
    assert f"parameter {name!r}" in str(error.value)
    with pytest.raises(sg.SceneError, match=re.escape(why)) as error:
        sg.References(**{name: 1.0})
    assert f"reference {name!r}" in str(error.value)


def test_names_of_derivatives_are_checked_too() -> None:
    with pytest.raises(sg.SceneError, match="collides"):
        sg.References(r=sg.Ref(0.0, order=2), r_ddot=1.0)


@pytest.mark.parametrize("name", ["double", "class", "I", "9lives", "a b", "", 101 * "x"])
def test_names_of_scenes_and_prefixes(name: str) -> None:
    with pytest.raises(sg.SceneError, match="scene"):
        sg.Scene(name, None, [])  # type: ignore[arg-type]
    with pytest.raises(sg.SceneError, match="prefix"):
        sg.build_solver(1, 1, prefix=name)


def test_a_folder_that_cannot_be_made_is_told(tmp_path) -> None:
    with pytest.raises(sg.SceneError, match=r"out: no folder .* can be made: File name too long; give another one"):
        sg.build_solver(1, 1, tmp_path / (300 * "x"))


@pytest.mark.parametrize(
    "name", ["m_B", "E_0", "_x", "R", "mass2", "S", "z", "model", "params", "info", "t0", "c0", "none"]
)
def test_names_that_are_fine(name: str) -> None:
    sg.Parameters(**{name: 1.0})
    sg.References(**{name: 1.0})


@pytest.mark.parametrize("command", ["gcc", "g++", "clang", "arm-none-eabi-gcc"])
def test_no_macro_of_the_headers_can_be_a_name(command: str) -> None:
    """Every object-like macro that our files see must be refused, or a member of that name would not compile."""
    language = "c++" if command == "g++" else "c"
    headers = "#include <stddef.h>\n#include <stdint.h>\n#include <math.h>\n"
    done = subprocess.run(
        [compiler(command), "-dM", "-E", "-x", language, "-"], input=headers, capture_output=True, text=True
    )
    if done.returncode != 0:
        skip_or_fail(f"{command} has no C library headers here")
    macros = re.findall(r"^#define ([A-Za-z_]\w*)(?: |$)", done.stdout, re.MULTILINE)
    assert "NAN" in macros
    allowed = []
    for name in macros:
        try:
            check_identifier(name, "parameter")
        except sg.SceneError:
            continue
        allowed.append(name)
    assert not allowed


EVIL = [
    "*/ int evil; /*",
    "*/*/",
    "/*/",
    "/*/*/*",
    "a**//",
    "ends in a star*",
    "ends in a backslash\\",
    "two\nlines\r\n#error x",
    "a trigraph ??/",
    "null \0, bell \a, escape \x1b[31m",
    "right to left \u202e and back",
    "line separator \u2028 here",
    "kg m² Ω µ",
    "\" ' %s {{ x }} {% endif %}",
]


@pytest.mark.parametrize("text", EVIL)
def test_texts_cannot_leave_their_comment(text: str) -> None:
    safe = comment_safe(text)
    assert "*/" not in safe
    assert "/*" not in safe
    assert safe.isprintable()


def test_texts_and_units_reach_the_header_safely(tmp_path: object) -> None:
    par = sg.Parameters(**{f"p{k}": sg.Parameter(1.0, text, text) for k, text in enumerate(EVIL)})
    ref = sg.References(**{f"r{k}": sg.Ref(1.0, 1, text, text) for k, text in enumerate(EVIL)})
    q, u, tau = ca.SX.sym("*/ evil", 1), ca.SX.sym("u\n#error", 1), ca.SX.sym("tau")
    total = sum((f.symbol for f in (*par, *ref) if not f.name.endswith("_dot")), ca.SX(0))
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=[[1.0]], P=[0.0], G=[[1.0]])
    scene = sg.Scene("texts", mech, [sg.Nonholonomic("*/ evil", u + q + total, -1.0)], par, ref)
    package = sg.build(scene)
    header = (package.path / "texts.h").read_text(encoding="utf-8")
    assert "kg m² Ω µ" in header
    assert package.manifest["parameters"]["p0"]["unit"] == EVIL[0]
    for command in ("gcc", "clang"):
        if shutil.which(command):
            run([command, *STRICT, "-fsyntax-only", package.path / "texts.c"])


def named(name: str) -> sg.Scene:
    q, u, tau = (ca.SX.sym(n) for n in ("q", "u", "tau"))
    return sg.Scene(name, sg.Mechanism(q=q, u=u, tau=tau, Q=1, P=0, G=1), [sg.Nonholonomic("v", u, Theta=-1.0)])


@pytest.mark.parametrize("name", ["math", "stdint", "Time", "unistd"])
def test_a_package_never_hides_a_header(name: str) -> None:
    with pytest.raises(sg.SceneError, match=f"would hide the standard header <{name.lower()}.h>; choose another name"):
        sg.build(named(name))
    assert sg.build(named(name), prefix=f"{name}_1").prefix == f"{name}_1"


def test_every_header_and_device_is_refused_as_a_file() -> None:
    for name in (*HEADERS, "aux", "CON", "lpt1"):
        for where in ({"prefix": name}, {"prefix": None, "core": name}):
            with pytest.raises(sg.SceneError, match=r"header|device|keyword|macro"):
                target_for("scene", "float64", **where)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["jac", "hess", "a__b"])
def test_names_that_casadi_keeps_are_free(name: str) -> None:
    assert (sg.build(named(name)).path / f"{name}.c").exists()
