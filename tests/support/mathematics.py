"""The templates of math/ alone: a C file with functions that take whole arrays, compiled and called."""

import ctypes as ct
from pathlib import Path

import numpy as np
from servogen.render.mathematics import math_context
from servogen.render.render import environment
from servogen.scalars import BITS

from .c import run

FUNCTIONS = ("sqrt", "reduce", "sin", "cos", "sincos")

ARRAYS = """
int keep(void);
int keep(void) {{ return own_largest(NULL, 0) == 0; }}
void sin_array(long n, const {real} *x, {real} *y);
void cos_array(long n, const {real} *x, {real} *y);
void sqrt_array(long n, const {real} *x, {real} *y);
void sincos_array(long n, const {real} *x, {real} *s, {real} *c);
void sin_array(long n, const {real} *x, {real} *y) {{ long k; for (k = 0; k < n; ++k) y[k] = own_sin(x[k]); }}
void cos_array(long n, const {real} *x, {real} *y) {{ long k; for (k = 0; k < n; ++k) y[k] = own_cos(x[k]); }}
void sqrt_array(long n, const {real} *x, {real} *y) {{ long k; for (k = 0; k < n; ++k) y[k] = own_sqrt(x[k]); }}
void sincos_array(long n, const {real} *x, {real} *s, {real} *c)
{{
    long k;
    for (k = 0; k < n; ++k) {{
        const own_pair both = own_sincos(x[k]);
        s[k] = both.sin;
        c[k] = both.cos;
    }}
}}
"""


def source(scalar, functions=FUNCTIONS):
    """C of the functions, named own_sin and so on, behind the includes they need."""
    context = {
        "p": "own",
        "P": "OWN",
        "real": "double" if scalar == "float64" else "float",
        "bits": BITS[scalar],
        "mt": math_context(scalar),
        "own_functions": functions,
        "lit": None,
    }
    head = "#include <float.h>\n#include <math.h>\n#include <stddef.h>\n#include <stdint.h>\n"
    text = [environment().get_template(name).render(context) for name in ("number.c.j2", "solver/bits.c.j2")]
    return head + "\n".join(text)


def write(folder, scalar, edit=lambda text: text):
    """The C file with the array functions behind it; `edit` may plant a fault."""
    real = "double" if scalar == "float64" else "float"
    path = Path(folder) / f"own_{scalar}.c"
    path.write_text(edit(source(scalar)) + ARRAYS.format(real=real))
    return path


class Compiled:
    """sin, cos, sincos and sqrt of arrays."""

    def __init__(self, folder, scalar, compiler="gcc", flags=("-O2",), edit=lambda text: text):
        self.dtype = np.dtype(scalar)
        c = write(folder, scalar, edit)
        name = "_".join([compiler, *flags]).replace("-", "").replace("=", "")
        library = c.with_name(f"{c.stem}_{name}.so")
        run([compiler, "-std=c99", "-ffp-contract=off", *flags, "-fPIC", "-shared", c, "-o", library, "-lm"])
        self._library = ct.CDLL(str(library))

    def _call(self, name, x, outputs):
        x = np.ascontiguousarray(x, self.dtype)
        found = [np.empty_like(x) for _ in range(outputs)]
        getattr(self._library, f"{name}_array")(ct.c_long(len(x)), *(ct.c_void_p(a.ctypes.data) for a in (x, *found)))
        return found

    def sin(self, x):
        return self._call("sin", x, 1)[0]

    def cos(self, x):
        return self._call("cos", x, 1)[0]

    def sqrt(self, x):
        return self._call("sqrt", x, 1)[0]

    def sincos(self, x):
        return tuple(self._call("sincos", x, 2))
