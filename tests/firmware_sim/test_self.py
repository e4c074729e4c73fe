"""The harness proves on itself that it can fail: every planted fault must be found, and for the right reason."""

import dataclasses
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from servogen.verify.harness import HarnessBuildError, HarnessResult, _complaint, read_log, run_harness
from servogen.verify.vectors import VectorSet, take, ulp
from support.mutate import mutated

BUILDS = [("host", "gcc"), ("host", "clang"), ("host", "asan"), ("cortex-m4", "gcc")]
STEP_1 = "    tau[1] = in->tau[1] + dt * S[1];\n"
CONTROL_1 = "tau[1] = S_pinv[1] * z;"
CONTROL_TOLD = CONTROL_1 + "\n        return tell(info, 0, 1);"
OUTSIDE = "volatile int k = 2;\n    if (S[k] > 1e300) {\n        return -1;\n    }\n"
REFUSED = "if (sample_S_z(model, in, S, &z) < 0) {\n        return tell(info, -1, 0);\n    }\n    if"

# Name: edits to the sample's source, and what the harness must say.
FAULTS: dict[str, tuple[list[tuple[str, str]], str]] = {
    "flipped_sign": ([("in->q[1] - in->E_0;", "in->q[1] + in->E_0;")], "S_z, z: .* beyond their tolerance"),
    "nan": ([("= model->k[1] * in->u[1];", "= (double)NAN;")], "S_z, S: .*worst inf times the tolerance"),
    "nan_once": (
        [("= model->k[1] * in->u[1];", "= in->q[0] < -1.5 ? (double)NAN : model->k[1] * in->u[1];")],
        "S_z, S: .*worst inf",
    ),
    "dropped": ([(STEP_1, "")], "step, tau: .*beyond their tolerance.*differ when run again"),
    "dropped_once": ([(STEP_1, "    if (in->q[0] < 1.5) {\n" + STEP_1 + "    }\n")], "step, tau: .*beyond"),
    "index_of_input": ([("= model->k[1] * in->u[1];", "= model->k[1] * in->u[0];")], "S_z, S: .*beyond"),
    "index_of_output": (
        [("tau[0] = S_pinv[0] * z;", "tau[1] = S_pinv[0] * z;"), (CONTROL_1, "tau[0] = S_pinv[1] * z;")],
        "control, tau: .*beyond",
    ),
    "answer_of_the_last_call": (
        [(STEP_1, "    static double last;\n    tau[1] = last;\n    last = in->tau[1] + dt * S[1];\n")],
        "step, tau: .*beyond.*differ when run again",
    ),
    "last_bit_depends_on_history": (
        [(STEP_1, "    static int n;\n    tau[1] = (in->tau[1] + dt * S[1]) * (++n % 2 ? 1.0 : 1.0 + 2.3e-16);\n")],
        "step, tau: [0-9]+ values differ when run again",
    ),
    "adds_to_output": ([(STEP_1, STEP_1.replace(" = ", " += "))], "step, tau: .*worst inf"),
    "past_the_end": (
        [("return sample_S_z(model, in, S, z);", "z[1] = 0.0;\n    return sample_S_z(model, in, S, z);")],
        r"z, z: [0-9]+ guard words overwritten",
    ),
    "before_the_start": (
        [("return sample_S_z(model, in, S, z);", "z[-1] = 0.0;\n    return sample_S_z(model, in, S, z);")],
        r"z, z: [0-9]+ guard words overwritten",
    ),
    "touched_on_failure": (
        [(REFUSED, REFUSED.replace("return tell", "tau[1] = 0.0;\n        return tell"))],
        "control, tau: 4 values changed although the status was negative",
    ),
    "wrong_status": (
        [("return tell(info, z > 0.0 || z < 0.0 ? 2 : 1, 0);", "return tell(info, 1, 0);")],
        "control, tau: 1 wrong statuses",
    ),
    "info_disagrees": (
        [(CONTROL_TOLD, CONTROL_1 + "\n        (void)tell(info, 1, 1);\n        return 0;")],
        "control, tau: [0-9]+ wrong statuses",
    ),
    "wrong_rank": (
        [(CONTROL_TOLD, CONTROL_1 + "\n        return tell(info, 0, 2);")],
        "control, tau: [0-9]+ wrong ranks",
    ),
    "refuses_everything": ([("return t0 - t0 == 0.0;", "return t0 - t0 != 0.0 && 0;")], "S_z, S: 62 wrong statuses"),
    "accepts_nan": ([("return t0 - t0 == 0.0;", "return t0 - t0 == 0.0 || 1;")], "S_z, S: 2 wrong statuses"),
    "prepare_fails": (
        [("    return 0;\n}\n\nstatic int is_finite", "    return -2;\n}\n\nstatic int is_finite")],
        "prepare returned -2",
    ),
    "prepare_forgets": ([("    model->k[1] = params->k[1];\n", "    model->k[1] = -0.5;\n")], "S_z, S: .*beyond"),
    "crash": (
        [("S_pinv[0] = t0 > 0.0", "if (t0 > 0.1) {\n        __builtin_trap();\n    }\n    S_pinv[0] = t0 > 0.0")],
        "pinv, S_pinv: no result was printed",
    ),
}

# Faults with right answers, which only a sanitizer sees: that its flags reach the generated code is proven by them.
SANITIZER_FAULTS: dict[str, tuple[list[tuple[str, str]], str]] = {
    "past_the_end": (FAULTS["past_the_end"][0], "global-buffer-overflow"),
    "reads_past_argument": (
        [("S_pinv[0] = t0 > 0.0", OUTSIDE + "    S_pinv[0] = t0 > 0.0")],
        "AddressSanitizer: (stack|global)-buffer-overflow",
    ),
    "reads_past_local": ([(STEP_1, OUTSIDE + STEP_1)], "runtime error: index 2 out of bounds"),
    "signed_overflow": (
        [(STEP_1, STEP_1 + "    volatile int most = 2147483647;\n    most = most + (dt < 1e9 ? 1 : 0);\n")],
        "runtime error: signed integer overflow",
    ),
}


def run(
    packages: list[Path], vectors: dict[str, VectorSet], build_dir: Path, **options: Any
) -> dict[str, HarnessResult]:
    """The results by prefix."""
    return {r.prefix: r for r in run_harness(packages, vectors, build_dir=build_dir, progress=print, **options)}


def missed(results: dict[str, HarnessResult], expected: dict[str, str]) -> dict[str, Any]:
    """The faults that were not found, or for another reason than the one expected."""
    return {
        name: results[name].problems
        for name, reason in expected.items()
        if results[name].passed or not any(re.search(reason, problem) for problem in results[name].problems)
    }


@pytest.mark.parametrize(("target", "compiler"), BUILDS, ids=lambda value: value)
def test_correct_package_passes(
    sample: Any, need_target: Callable[..., None], tmp_path: Path, target: str, compiler: str
) -> None:
    """Both scalars in one build, every kind of call; a tolerance of half an ulp more than needed is measured."""
    need_target(target, compiler)
    packages = [sample.write(tmp_path), sample.write(tmp_path, "sample_f32", "float32")]
    vectors = {"sample": sample.vectors(), "sample_f32": sample.vectors("sample_f32", "float32")}
    results = run(packages, vectors, tmp_path / "build", target=target, compiler=compiler)
    assert {prefix: result.problems for prefix, result in results.items()} == {"sample": (), "sample_f32": ()}
    for result in results.values():
        assert len(result.outputs) == 8
        assert all(output.compared > 0 and output.max_ratio <= 1 for output in result.outputs)
        assert 0 < result.outputs[0].max_ulps < 1  # below one ulp: lo is taken into account


@pytest.mark.parametrize(("target", "compiler"), [BUILDS[0], BUILDS[3]], ids=lambda value: value)
def test_every_planted_fault_is_found(
    sample: Any, need_target: Callable[..., None], tmp_path: Path, target: str, compiler: str
) -> None:
    need_target(target, compiler)
    packages = [sample.write(tmp_path, name, edits=edits) for name, (edits, _) in FAULTS.items()]
    vectors = {name: sample.vectors(name) for name in FAULTS}
    # at -O1 gcc would warn of what some of the faults leave unset
    results = run(packages, vectors, tmp_path / "build", target=target, compiler=compiler, optimisation="-O2")
    assert missed(results, {name: reason for name, (_, reason) in FAULTS.items()}) == {}
    assert all(result.exit_code != 0 for result in results.values())
    assert results["crash"].exit_code != 1  # taken from the process or from the board's fault handler


def test_a_run_without_end_is_a_failure(sample: Any, need_target: Callable[..., None], tmp_path: Path) -> None:
    need_target("host", "gcc")
    package = sample.write(tmp_path, edits=[(STEP_1, "    volatile int on = 1;\n    while (on) {\n    }\n" + STEP_1)])
    result = run([package], {"sample": sample.vectors(count=8)}, tmp_path / "build", timeout=1.0)["sample"]
    assert "timeout: no end within 1 s" in result.problems[-1]
    assert {output.entry for output in result.outputs if output.passed} >= {"S_z", "z", "control"}


def test_faulty_vectors_are_found(sample: Any, need_target: Callable[..., None], tmp_path: Path) -> None:
    """The package is right, what it is held against is not."""
    need_target("host", "gcc")
    good = sample.vectors()
    shifted = {name: np.roll(array, 1, axis=0) for name, array in good.inputs.items()}
    bare = [np.full_like(output.tolerance, np.inf) for output in good.entries[0].outputs]
    outputs = tuple(dataclasses.replace(o, tolerance=t) for o, t in zip(good.entries[0].outputs, bare, strict=True))
    half = tuple(dataclasses.replace(o, tolerance=o.tolerance * 1e-9) for o in good.entries[0].outputs)
    no_ulp = dataclasses.replace(good.entries[0], outputs=half)
    sets = {
        "shifted": dataclasses.replace(good, inputs=shifted),
        "empty": take(good, []),
        "uncompared": dataclasses.replace(good, entries=(dataclasses.replace(good.entries[0], outputs=outputs),)),
        "below_rounding": dataclasses.replace(good, entries=(no_ulp,)),
        "other_params": dataclasses.replace(good, params={"g": 9.8125}),
    }
    packages = [sample.write(tmp_path, name) for name in sets]
    results = run(packages, {n: dataclasses.replace(s, prefix=n) for n, s in sets.items()}, tmp_path / "build")
    reasons = {
        "shifted": "step, tau: .*beyond",
        "empty": "S_z, S: nothing to compare",
        "uncompared": "S_z, S: nothing to compare",
        "below_rounding": "S_z, S: .*beyond",
        "other_params": "S_z, S: .*beyond",
    }
    assert missed(results, reasons) == {}
    assert all(result.exit_code == 1 for result in results.values())  # the C side finds them by itself


def test_sanitizers_reach_the_generated_code(sample: Any, need_target: Callable[..., None], tmp_path: Path) -> None:
    """The plain build passes all but the first of these; under the sanitizers each aborts."""
    need_target("host", "asan")
    packages = [sample.write(tmp_path, name, edits=edits) for name, (edits, _) in SANITIZER_FAULTS.items()]
    vectors = {name: sample.vectors(name, count=8) for name in SANITIZER_FAULTS}
    plain = run(packages, vectors, tmp_path / "gcc")
    assert [name for name, result in plain.items() if not result.passed] == ["past_the_end"]
    results = run(packages, vectors, tmp_path / "asan", compiler="asan")
    assert missed(results, {name: reason for name, (_, reason) in SANITIZER_FAULTS.items()}) == {}


def test_flags_reach_the_generated_code(sample: Any, need_target: Callable[..., None], tmp_path: Path) -> None:
    """A lossy conversion must not compile; the flags are those of the design."""
    need_target("host", "gcc")
    edit = ("const double t0 = S[0]", "const int lossy = S[0];\n    (void)lossy;\n    const double t0 = S[0]")
    package = sample.write(tmp_path, edits=[edit])
    with pytest.raises(HarnessBuildError, match=r"conversion from .double. to .int."):
        run([package], {"sample": sample.vectors(count=8)}, tmp_path / "build", optimisation="-O1")
    ninja = (tmp_path / "build" / "build.ninja").read_text()
    flags = re.search(r"build packages/sample/\S+sample\.c\.o:.*?FLAGS = (.*?)\n", ninja, re.S)
    assert flags is not None
    warnings = ["all", "extra", "pedantic", "conversion", "double-promotion", "missing-prototypes", "shadow", "error"]
    wanted = {"-O1", "-std=c99", "-ffp-contract=off"} | {f"-W{name}" for name in warnings}
    assert wanted <= set(flags[1].split())


@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_figures_are_those_of_the_dumped_values(
    sample: Any, need_target: Callable[..., None], tmp_path: Path, scalar: Any
) -> None:
    """Error, worst vector and hash, computed again in Python; host and board agree where no sine is involved."""
    need_target("host", "gcc")
    need_target("cortex-m4")
    package, vectors = sample.write(tmp_path, scalar=scalar), sample.vectors(scalar=scalar)
    here = run([package], {"sample": vectors}, tmp_path / "host", dump=True)["sample"]
    board = run([package], {"sample": vectors}, tmp_path / "board", target="cortex-m4", dump=True)["sample"]
    assert here.problems == board.problems == ()
    for result in (here, board):
        found = {(o.entry, o.output): o for o in result.outputs}
        for entry in vectors.entries:
            for output in entry.outputs:
                dump, figures = result.dumps[entry.name, output.name], found[entry.name, output.name]
                assert dump.values.shape == (64, output.size)
                answered = dump.status >= 0
                error = np.abs((dump.values - output.hi) - output.lo)[answered]
                in_domain = np.flatnonzero(answered) < (64 if entry.domain is None else entry.domain)
                assert figures.max_ulps == np.max(error[in_domain] / np.dtype(scalar).type(ulp(output.scale, scalar)))
                ratio = error / output.tolerance[answered].astype(scalar)
                assert figures.max_ratio == ratio.max()
                assert np.isclose(ratio[np.flatnonzero(answered).tolist().index(figures.worst)].max(), ratio.max())
                assert figures.hash == fnv1a(dump.status, dump.values)
    np.testing.assert_array_equal(here.dumps["z", "z"].values, board.dumps["z", "z"].values)
    assert [o.hash for o in here.outputs if o.output == "z"] == [o.hash for o in board.outputs if o.output == "z"]


def fnv1a(status: np.ndarray, values: np.ndarray) -> str:
    """64-bit FNV-1a over each vector's status (4 bytes) and, if it is not negative, its values."""
    code = 0xCBF29CE484222325
    for s, row in zip(status, values, strict=True):
        for byte in np.int32(s).tobytes() + (row.tobytes() if s >= 0 else b""):
            code = ((code ^ byte) * 0x100000001B3) % 2**64
    return f"{code:016x}"


def test_float32_image_has_no_double_arithmetic(
    sample: Any, need_target: Callable[..., None], need_tool: Callable[[str, str], Path], tmp_path: Path
) -> None:
    """Nor stdio, nor a heap: whatever of these turns up in an image comes from the generated code."""
    need_target("cortex-m4")
    nm = need_tool("arm-none-eabi-nm", "binutils-arm-none-eabi")
    package = sample.write(tmp_path, "sample_f32", "float32")
    vectors = {"sample_f32": sample.vectors("sample_f32", "float32", count=8)}
    vectors["sample_f32"] = dataclasses.replace(  # without the sine: newlib's own sinf computes in double
        vectors["sample_f32"], entries=vectors["sample_f32"].entries[5:]
    )
    source = package / "sample_f32.c"
    source.write_text(mutated(source.read_text(), r"sinf\(in->q\[0\]\)", "in->q[0]"))
    vectors["sample_f32"] = dataclasses.replace(vectors["sample_f32"], input_fields=(), inputs={})
    result = run([package], vectors, tmp_path / "build", target="cortex-m4")["sample_f32"]
    symbols = subprocess.run([nm, result.image], capture_output=True, text=True, check=True).stdout
    assert not re.findall(r"\b(?:__aeabi_[df]\w+|\w*printf\w*|_?malloc\w*|_sbrk)\b", symbols)


LOG = """harness prefix=p bits=64 entries=1 prepare=0
result entry=z output=z vectors=64 compared=64 outside=0 ulps=0000000000000000 ratio=0000000000000000 worst=0 {}
verdict pass=1
""".format("element=0 status=0 rank=0 touched=0 overruns=0 drift=0 hash=0000000000000000 histogram=64 pass=1")


@pytest.mark.parametrize(
    ("old", "new", "exit_code", "reason"),
    [
        ("", "", 0, None),
        ("", "", 1, "the verdict is not"),
        ("verdict pass=1", "", 0, "the verdict is not"),
        ("verdict pass=1", "verdict pass=0", 0, "the verdict is not"),
        ("result", "rubbish", 0, "no result was printed"),
        (" pass=1", "", 0, "no result was printed"),
        ("prefix=p", "prefix=q", 0, "no heading"),
        ("vectors=64", "vectors=63", 0, "were compared"),
        ("compared=64", "compared=63", 0, "63 of 64 values were compared"),
        ("outside=0", "outside=1", 0, "beyond"),
        ("drift=0", "drift=1", 0, "run again"),
        ("64 pass=1", "64 pass=0", 0, "the harness failed it"),
        ("prepare=0", "prepare=-2", 0, "prepare returned -2"),
    ],
)
def test_python_believes_nothing_that_the_lines_do_not_prove(
    sample: Any, old: str, new: str, exit_code: int, reason: str | None
) -> None:
    vectors = sample.vectors("p")
    status = np.zeros(64, dtype=int)
    z = dataclasses.replace(vectors.entries[1], status=status)
    z = dataclasses.replace(z, outputs=(dataclasses.replace(z.outputs[0], tolerance=np.ones((64, 1))),))
    result = read_log(dataclasses.replace(vectors, entries=(z,)), "host", "gcc", exit_code, LOG.replace(old, new))
    assert result.passed == (reason is None)
    assert reason is None or any(reason in problem for problem in result.problems)


def test_an_empty_log_is_a_failure(sample: Any) -> None:
    assert not read_log(sample.vectors(), "host", "gcc", 0, "").passed


def test_what_a_tool_printed_is_told_in_few_lines() -> None:
    """Of ninja's log the first step that failed, without its command; of CMake's what follows its error."""
    command = ": && /usr/bin/cmake -E rm -f libp.a && /usr/bin/ar qc libp.a p.o && /usr/bin/ranlib libp.a && :"
    log = [
        "[1/9] Building C object p.o",
        "FAILED: libp.a ",
        command,
        "ar: libp.a: broken",
        "[2/9] Building C object q.o",
    ]
    assert _complaint(["/x/cmake", "--build"], "\n".join([*log, "ninja: build stopped."])) == (
        "ar, ranlib could not make libp.a:\nar: libp.a: broken"
    )
    silent = _complaint(["/x/cmake", "--build"], f"FAILED: p.o \n/usr/bin/cc {'-Wall ' * 90}\nninja: build stopped.")
    assert silent == "cc could not make p.o:\n(nothing was said)"
    said = "-- found\nCMake Error at CMakeLists.txt:3 (project):\n  no such thing"
    assert _complaint(["/x/cmake", "--preset"], said) == (
        "failed: cmake\nCMake Error at CMakeLists.txt:3 (project):\n  no such thing"
    )
    assert len(_complaint(["cmake"], "\n".join("x" * 500)).splitlines()) <= 31
