"""Instructions on a board, beside what others take there: python -m servogen.bench.board.

Each scene's float32 C against CasADi's with casadi_real=float, as emitted and after a repair by hand (sinf for sin, an
f behind every literal); and our sin and cos against the board's maths library, and on this machine against its own.
"""

import argparse
import re
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from servogen.bench import instructions
from servogen.bench.contenders import casadi_c, servogen_c
from servogen.bench.inputs import drawn
from servogen.bench.results import Output, labels
from servogen.loading import load_scene
from servogen.render.mathematics import NEAR, math_context
from servogen.render.render import environment
from servogen.scalars import BITS, EPSILON, Scalar
from servogen.scene.scene import Scene
from servogen.tools import firmware_sim
from servogen.verify.harness import build_images, execute, require_target, words_of, write_if_changed
from servogen.verify.vectors import literal

STATES = 64
OUTPUTS = (Output.SYSTEM, Output.ANSWER)
SCENES = ("double_pendulum_energy", "spacecraft", "iiwa_position")
AS_EMITTED, MENDED = "CasADi as emitted", "CasADi mended by hand"


@dataclass(frozen=True)
class Count:
    """Instructions of one call on a board, call included, not cycles."""

    mean: int
    worst: int


def against_casadi(scene: Scene, target: str = "cortex-m4", states: int = STATES) -> dict[str, dict[str, Count]]:
    """By output (S, z, tau and the like), then by contender."""
    inputs = drawn(scene, states, 0)
    ours = servogen_c(scene, inputs, states, "float32", OUTPUTS)
    theirs = casadi_c(scene, inputs, states, AS_EMITTED, cse=True, scalar="float32", outputs=OUTPUTS)
    mended = {f.name.replace(theirs.identifier, "mended"): mend(f.text, theirs.identifier) for f in theirs.files}
    declarations = [
        ours.declarations.replace("static void load(", "static void load_ours(").replace("abort()", "hal_exit(1)")
    ]
    declarations.append(theirs.declarations.replace("static void load(", "static void load_theirs("))
    declarations += [
        theirs.declarations[theirs.declarations.index("\nint ") :]
        .replace(theirs.identifier, "mended")
        .replace("call_", "call_mended_")
    ]
    calls = {}
    for output in OUTPUTS:
        label = labels(scene.system)[output]
        calls[f"{label}|servogen"] = ours.calls[output].expression
        calls[f"{label}|{AS_EMITTED}"] = theirs.calls[output].expression
        calls[f"{label}|{MENDED}"] = theirs.calls[output].expression.replace("call_", "call_mended_")
    files = {f.name: f.text for f in ours.files}
    peers = {f.name: f.text for f in theirs.files} | mended
    largest = (scene.rows + 1) * scene.controls + scene.rows
    values = inputs.states.ravel(), np.asarray(inputs.parameters).ravel()
    start = "load_ours(parameters, states, BENCH_STATES);\n    load_theirs(parameters, states, BENCH_STATES);"
    header = _header(declarations, calls, largest, "float", values, states, start)
    found: dict[str, dict[str, Count]] = {}
    for name, count in count_on_board(files, peers, header, "float32", target).items():
        label, _, who = name.partition("|")
        found.setdefault(label, {})[who] = count
    return found


def mend(text: str, identifier: str) -> str:
    """CasADi's C for float as a careful user would repair it: float's functions, float's literals."""
    text = re.sub(r"\b(sin|cos|tan|sqrt|fabs|fmin|fmax|atan2|exp|log|pow|floor|ceil)\(", r"\1f(", text)
    text = re.sub(r"(?<![\w.])((?:\d+\.\d*|\.\d+)(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+)(?![\w.])", r"\1f", text)
    return text.replace(identifier, "mended")


def trigonometry(scalar: Scalar, target: str = "cortex-m4", states: int = STATES) -> dict[str, Count]:
    """Our sin, and sin and cos at once, and the maths library's: up to 2 pi, to the short reduction's end, and huge."""
    real, f = ("double", "") if scalar == "float64" else ("float", "f")
    generator = np.random.default_rng(0)
    angles = {"to 2 pi": 2 * np.pi, "to the end of the short reduction": NEAR[scalar], "huge": 1e30}
    declarations = [sine_source(scalar), "#include <math.h>"]
    values = np.concatenate([generator.uniform(-a, a, states) for a in angles.values()])
    calls = {}
    for k, name in enumerate(angles):
        x = f"({real})states[BENCH_STATES * {k} + k]"
        calls[f"{name}|own sin"] = f"(*out = own_sin({x}))"
        calls[f"{name}|own sin and cos"] = f"(pair = own_sincos({x}), out[0] = pair.sin, out[1] = pair.cos)"
        calls[f"{name}|library sin"] = f"(*out = sin{f}({x}))"
        calls[f"{name}|library sin and cos"] = f"(out[0] = sin{f}({x}), out[1] = cos{f}({x}))"
    declarations.append("own_pair pair;")
    header = _header(declarations, calls, 2, real, (values, np.zeros(1)), states, "(void)parameters;", real)
    return count_on_board({}, {}, header, scalar, target)


def sine_source(scalar: Scalar) -> str:
    """C of our own functions, named own_sin and so on."""
    context = {
        "p": "own",
        "real": "double" if scalar == "float64" else "float",
        "bits": BITS[scalar],
        "mt": math_context(scalar),
        "own_functions": ("sqrt", "reduce", "sin", "cos", "sincos"),
        "lit": None,
    }
    includes = "".join(f"#include <{name}.h>\n" for name in ("float", "math", "stddef", "stdint"))
    return includes + environment().get_template("solver/bits.c.j2").render(context)


def _header(
    declarations: Sequence[str],
    calls: Mapping[str, str],
    largest: int,
    real: str,
    values: tuple[np.ndarray, np.ndarray],
    states: int,
    start: str,
    kept: str = "double",
) -> str:
    """bench.h of firmware_sim/bench/main.c."""
    scalar: Scalar = "float32" if kept == "float" else "float64"
    rows, parameters = (", ".join(literal(float(np.dtype(scalar).type(x)), scalar) for x in v) for v in values)
    bodies = "\n".join(
        f"static void call_{n}(uint32_t k)\n{{\n    (void){expression};\n}}"
        for n, expression in enumerate(calls.values())
    )
    names = ",\n".join(f'    {{"{name.replace(" ", "_")}", call_{n}}}' for n, name in enumerate(calls))
    return "\n".join(
        [
            "#include <stddef.h>\n#include <stdint.h>",
            f"#define BENCH_STATES {states}u\n#define BENCH_CALLS {len(calls)}u",
            f"static const {kept} states[] = {{{rows}}};",
            f"static const {kept} parameters[] = {{{parameters or 0}}};",
            f"{real} out[{largest}]; /* others could read it: no store to it is dropped */",
            *declarations,
            f"static void bench_start(void)\n{{\n    {start}\n}}",
            bodies,
            "static const struct {\n    const char *name;\n    void (*call)(uint32_t);\n} bench_calls[] = {",
            names,
            "};\n",
        ]
    )


def count_on_board(
    files: Mapping[str, str], peers: Mapping[str, str], header: str, scalar: Scalar, target: str
) -> dict[str, Count]:
    """The counts that an image of these files prints, by call. ToolMissing, HarnessBuildError, RuntimeError."""
    require_target(target)
    with tempfile.TemporaryDirectory(prefix="servogen-board-") as name:
        folder = Path(name)
        for file, text in {**files, **peers, "bench.h": header}.items():
            write_if_changed(folder / file, text)
        main = folder / "main.c"
        main.write_text((firmware_sim() / "bench" / "main.c").read_text())
        own = [folder / n for n in files if n.endswith(".c")]
        options = {
            "PROGRAM": ";".join(str(p) for p in own),
            "PEERS": ";".join(str(p) for p in (main, *(folder / n for n in peers if n.endswith(".c")))),
            "PROGRAM_FOLDERS": str(folder),
            "PROGRAM_HEADER": "bench.h",
            "PROGRAM_BITS": "64" if scalar == "float64" else "32",
        }
        command = build_images([], target, "gcc", folder / "build", options)["program"]
        code, log = execute(command, 3600.0)
    if code != 0:
        raise RuntimeError(f"the image broke off on {target}: {log[-400:]}")
    lines = [words_of(line) for line in log.splitlines()]
    return {w["call"].replace("_", " "): Count(int(w["mean"]), int(w["worst"])) for w in lines if w[""] == "count"}


def on_this_machine(scalar: Scalar, states: int = STATES) -> dict[str, float]:
    """Instructions of the same functions here, by callgrind, against the C library's; mean over angles up to 2 pi."""
    real, f = ("double", "") if scalar == "float64" else ("float", "f")
    functions = {
        "own sin": "r += own_sin(x);",
        "own sin and cos": "own_pair p = own_sincos(x); r += p.sin + p.cos;",
        "library sin": f"r += sin{f}(x);",
        "library sin and cos": f"r += sin{f}(x) + cos{f}(x);",
        "": "r += x;",
    }
    cases = "\n".join(f"case {n}: {{ {body} break; }}" for n, body in enumerate(functions.values()))
    text = f"""#include <math.h>
#include <stdlib.h>
{sine_source(scalar)}
int main(int argc, char **argv)
{{
    volatile {real} r = 0;
    int k;
    (void)argc;
    for (k = 0; k < 10000; ++k) {{
        const {real} x = ({real})(-6.28 + 0.001256 * k);
        switch (atoi(argv[1])) {{
        {cases}
        }}
    }}
    return r == 12345;
}}
"""
    with tempfile.TemporaryDirectory(prefix="servogen-trig-") as name:
        source, program = Path(name) / "trig.c", Path(name) / "trig"
        source.write_text(text)
        flags = ("-O2", "-march=haswell", "-ffp-contract=off", "-std=gnu99", "-w")
        subprocess.run(["gcc", *flags, str(source), "-o", str(program), "-lm"], check=True)
        counts = [instructions.collected([str(program), str(n)]) for n in range(len(functions))]
    return {name: (n - counts[-1]) / 10000 for name, n in zip(functions, counts, strict=True) if name}


def main() -> int:
    """Print the tables; 1 where a bar is missed: 8 times fewer than as emitted, 1.5 times fewer than mended."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", nargs="*", default=list(SCENES))
    parser.add_argument("--target", default="cortex-m4")
    given = parser.parse_args()
    good = True
    for name in given.scenes:
        scene = load_scene(name)
        for label, counts in against_casadi(scene, given.target).items():
            ours, emitted, mended = (counts[who].mean for who in ("servogen", AS_EMITTED, MENDED))
            good &= emitted >= 8 * ours and mended >= 1.5 * ours
            ratios = f"{emitted / ours:.1f} and {mended / ours:.2f} times ours"
            print(
                f"{scene.name} {label} on {given.target}: {ours}; CasADi {emitted}, mended {mended}: {ratios}",
                flush=True,
            )
    for scalar in EPSILON:
        for call, count in trigonometry(scalar, given.target).items():
            print(f"{scalar} on {given.target}, {call.replace('|', ': ')}: mean {count.mean}, worst {count.worst}")
        try:
            here = on_this_machine(scalar)
        except OSError as problem:
            print(f"SKIPPED: {problem}")
            continue
        print(f"{scalar} on this machine: " + ", ".join(f"{name} {n:.0f}" for name, n in here.items()), flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main())
