"""Vector headers: exact numbers, equal bytes, and errors that name what does not fit."""

import dataclasses
import math
import re
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from servogen.ir.balls import ball, working
from servogen.tools import ToolMissing, find_tool, firmware_sim
from servogen.verify.harness import require_target, run_harness, targets
from servogen.verify.vectors import (
    MAX_OUTPUTS,
    EntryVectors,
    OutputVectors,
    VectorSet,
    data_bytes,
    render_vectors,
    split,
    take,
    ulp,
)


def array(header: str, name: str) -> list[str]:
    """The literals of one array of a header."""
    found = re.search(rf"static const \w+ {name}\[\d+\] = {{(.*?)}};", header, re.S)
    assert found is not None, f"no array {name}"
    return [word.strip() for word in found[1].split(",")]


@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_literals_are_exact(sample: Any, scalar: Any) -> None:
    vectors = sample.vectors(scalar=scalar)
    words = array(render_vectors(vectors), "hv_input_q")
    read = [float.fromhex(w.removesuffix("f")) if "0x" in w else math.nan for w in words]
    np.testing.assert_array_equal(np.array(read).reshape(64, 2), vectors.inputs["q"])
    assert all(word.endswith("f") == (scalar == "float32") for word in words if "0x" in word)


def test_the_same_vectors_give_the_same_bytes(sample: Any) -> None:
    assert render_vectors(sample.vectors()) == render_vectors(sample.vectors())


def test_equal_arrays_are_stored_once(sample: Any) -> None:
    """z is expected by S_z and by z; adding the one to the other costs its statuses alone."""
    both = sample.vectors()
    one = dataclasses.replace(both, entries=both.entries[:1])
    two = dataclasses.replace(both, entries=both.entries[:2])
    assert data_bytes(two) - data_bytes(one) == 64


def test_equal_rows_are_stored_once() -> None:
    output = OutputVectors.of("z", np.full((1000, 3), 0.5), 1e-9, 1.0, "float64")
    vectors = VectorSet("p", "float64", (EntryVectors("z", "plain", (output,)),))
    assert data_bytes(vectors) <= 3 * 3 * 8


@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_split_carries_twice_the_digits(scalar: Any) -> None:
    third = Fraction(1, 3)
    with working():
        hi, lo = split(np.array([[ball(third), ball(-third * 10**20)]], dtype=object), scalar)
    assert hi.dtype == lo.dtype == np.dtype(scalar)
    eps = float(np.finfo(scalar).eps)
    assert abs(Fraction(float(hi[0, 0])) + Fraction(float(lo[0, 0])) - third) < eps**2
    assert abs(float(lo[0, 0])) <= eps / 4


def test_split_of_what_is_not_finite() -> None:
    hi, lo = split([[math.nan, math.inf, 1e300]], "float32")
    assert math.isnan(hi[0, 0])
    assert np.isinf(hi[0, 1:]).all()
    assert not np.isfinite(lo).any()


@pytest.mark.parametrize(
    ("scale", "expected"),
    [(1.0, 2.0**-52), (1.99, 2.0**-52), (2.0, 2.0**-51), (0.75, 2.0**-53), (0.0, 5e-324), (1e-310, 5e-324)],
)
def test_ulp(scale: float, expected: float) -> None:
    assert ulp(scale, "float64") == expected


def test_solve_without_y_passes_null(sample: Any) -> None:
    given = {name: array for name, array in sample.vectors().entries[6].arguments.items() if name != "y"}
    header = render_vectors(replaced_entry(sample.vectors(), 6, arguments=given))
    assert "sample_solve(hv_argument_solve_S, hv_argument_solve_z, NULL, out[0], info != NULL" in header


def test_a_wide_tolerance_is_not_a_missing_one() -> None:
    output = OutputVectors.of("z", [[1.0, 1.0]], [[1e300, math.inf]], 1.0, "float32")
    header = render_vectors(VectorSet("p", "float32", (EntryVectors("z", "plain", (output,)),)))
    assert array(header, "hv_z_0_tolerance") == ["0x1.fffffep+127f", "-0x1p+0f"]


def replaced_output(vectors: VectorSet, **changes: Any) -> VectorSet:
    """With another first output of the first entry point, which is left alone."""
    entry = vectors.entries[0]
    outputs = (dataclasses.replace(entry.outputs[0], **changes), *entry.outputs[1:])
    return dataclasses.replace(vectors, entries=(dataclasses.replace(entry, outputs=outputs),))


def replaced_entry(vectors: VectorSet, index: int, **changes: Any) -> VectorSet:
    """With one entry point changed, which is left alone."""
    return dataclasses.replace(vectors, entries=(dataclasses.replace(vectors.entries[index], **changes),))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda v: dataclasses.replace(v, entries=()), "no entry point"),
        (lambda v: dataclasses.replace(v, scalar="float16"), "'float16'"),
        (lambda v: dataclasses.replace(v, entries=v.entries[:1] * 2), "given twice: S_z"),
        (lambda v: dataclasses.replace(v, inputs={}), "inputs and input_fields disagree on E_0, q, tau, u"),
        (
            lambda v: dataclasses.replace(v, input_fields=(*v.input_fields[:3], ("E_0", 2))),
            r"input E_0: shape \(64, 1\)",
        ),
        (lambda v: replaced_output(v, size=3), r"output S, hi: shape \(64, 2\), expected \(64, 3\)"),
        (lambda v: replaced_output(v, scale=math.inf), "scale is inf"),
        (lambda v: replaced_output(v, name="S z"), "no C identifier"),
        (lambda v: replaced_output(v, tolerance=np.full((64, 2), -1.0)), "negative or NaN"),
        (lambda v: replaced_output(v, tolerance=np.full((64, 2), math.nan)), "negative or NaN"),
        (lambda v: replaced_output(v, hi=np.full((64, 2), math.inf)), "vector 0: the expected value is not finite"),
        (lambda v: replaced_output(v, hi=np.zeros((64, 2), np.float32)), "hi: float32, not float64"),
        (lambda v: replaced_entry(v, 0, outputs=v.entries[0].outputs * 5), f"10 outputs; give 1 to {MAX_OUTPUTS}"),
        (lambda v: replaced_entry(v, 0, status=np.zeros(63, int)), "numbers of vectors differ"),
        (lambda v: replaced_entry(v, 0, rank=np.zeros(64, int)), "reports no rank"),
        (lambda v: replaced_entry(v, 0, status=np.full(64, -128)), r"beyond \+-127"),
        (lambda v: replaced_entry(v, 2, outputs=v.entries[0].outputs), "'control' has one output, 2 are given"),
        (lambda v: replaced_entry(v, 0, numbers=(1.0,)), "numbers belong to the call 'control'"),
        (lambda v: replaced_entry(v, 5, arguments={}), "lacks arguments: S"),
        (lambda v: replaced_entry(v, 5, arguments=v.entries[5].arguments | {"z": np.zeros((64, 1))}), "takes no z"),
    ],
)
def test_what_does_not_fit_is_named(sample: Any, spoil: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        render_vectors(spoil(sample.vectors()))


def test_vectors_that_do_not_fit_into_the_board(sample: Any, need_target: Any, tmp_path: Path) -> None:
    need_target("cortex-m4")
    rng = np.random.default_rng(0)
    output = OutputVectors.of("z", rng.uniform(size=(110_000, 20)), 1e-9, 1.0, "float64")
    vectors = VectorSet("sample", "float64", (EntryVectors("z", "plain", (output,)),))
    with pytest.raises(ValueError, match=r"cortex-m4 holds 16777216: give about \d+ of the 110000 vectors"):
        run_harness([sample.write(tmp_path)], {"sample": vectors}, target="cortex-m4", build_dir=tmp_path)


def test_packages_and_vectors_must_fit(sample: Any, tmp_path: Path) -> None:
    package = sample.write(tmp_path)
    for packages, vectors, message in (
        ([], {}, "no packages"),
        ([package], {}, "no vectors for the package sample"),
        (
            [package],
            {"sample": sample.vectors(scalar="float32")},
            "sample is float64, its vectors are of sample, float32",
        ),
        ([package, package], {"sample": sample.vectors()}, "same prefix"),
        ([tmp_path], {}, "no generated package"),
    ):
        with pytest.raises(ValueError, match=message):
            run_harness(packages, vectors, build_dir=tmp_path)


def test_take_keeps_rows_together(sample: Any) -> None:
    some = take(sample.vectors(), [5, 2])
    assert some.entries[2].count == 2
    assert some.entries[2].statuses().tolist() == [0, -1]
    np.testing.assert_array_equal(some.inputs["u"], sample.vectors().inputs["u"][[5, 2]])


def test_a_missing_tool_is_named_with_its_remedy() -> None:
    with pytest.raises(ToolMissing, match=r"no-such-tool is not installed; .*apt-get install its-package"):
        find_tool("no-such-tool", "its-package")


def test_unknown_targets_are_refused() -> None:
    with pytest.raises(ValueError, match="there are cortex-m0, cortex-m3, cortex-m33, cortex-m4, cortex-m7, host"):
        require_target("vax")
    with pytest.raises(ValueError, match="there are gcc, clang, asan"):
        require_target("host", "tcc")  # type: ignore[arg-type]


def test_every_target_has_its_files() -> None:
    """A board is one folder, and a preset of its name."""
    presets = (firmware_sim() / "CMakePresets.json").read_text()
    for target in targets():
        folder = firmware_sim() / "targets" / target
        assert (folder / "CMakeLists.txt").is_file()
        assert target == "host" or ((folder / "toolchain.cmake").is_file() and f'"name": "{target}"' in presets)
