"""The hand-written sample package: its truth, its copies under other names, and copies with planted faults."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pytest
from servogen.ir.balls import NAN, ZERO, Ball, balls, working
from servogen.verify.vectors import ANY_ANSWER, EntryVectors, OutputVectors, Scalar, VectorSet

SAMPLE = Path(__file__).parent / "sample"
TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("servogen", "render/templates"),
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
MANIFEST = '{{"prefix": "{prefix}", "scalar": "{scalar}"}}\n'
DT = 0.125
PARAMS = {"k": [0.75, 2.0], "g": 9.8125}
FIELDS = (("q", 2), ("u", 2), ("tau", 2), ("E_0", 1))


@dataclass(frozen=True)
class Sample:
    """What the tests of this folder do with the sample package."""

    def vectors(self, prefix: str = "sample", scalar: Scalar = "float64", count: int = 64, seed: int = 1) -> VectorSet:
        """Random states; vector 1 has S = 0, vectors 2 and 3 an input that is not finite (if there are so many)."""
        rng = np.random.default_rng(seed)
        inputs = {name: rng.uniform(-2, 2, (count, size)).astype(scalar) for name, size in FIELDS}
        for name in ("q", "u"):
            inputs[name][1:2] = 0
        inputs["q"][2:3, 1] = np.nan
        inputs["E_0"][3:4] = -np.inf
        rows = [_truth(inputs, k) for k in range(count)]
        column = {name: np.array([row[name] for row in rows], dtype=object).reshape(count, -1) for name in rows[0]}
        S_given = rng.uniform(-1, 1, (count, 2)).astype(scalar)
        z_given, y_given = (rng.uniform(-1, 1, (count, size)).astype(scalar) for size in (1, 2))
        solved = [_solve(*rows) for rows in zip(S_given, z_given, y_given, strict=True)]
        column["solve"] = np.array(solved, dtype=object).reshape(count, 2)
        column["S_pinv"] = np.array([_pinv(row) for row in S_given], dtype=object).reshape(count, 2)
        eps = float(np.finfo(scalar).eps)

        def output(name: str, of: str, scale: float, ulps: float = 8) -> OutputVectors:
            norm = np.array([[float(abs(x)) for x in row] for row in column[of]]).reshape(count, -1)
            tolerance = ulps * eps * (scale + np.nan_to_num(norm).max(axis=1, initial=0, keepdims=True))
            return OutputVectors.of(name, column[of].reshape(count, norm.shape[1]), tolerance, scale, scalar)

        plain = np.where(np.isin(np.arange(count), (2, 3)), -1, 0)
        control = plain.copy()
        control[1:2] = 2
        rank = np.where(control == 0, 1, 0)
        S, z, tau = output("S", "S", 4.0), output("z", "z", 50.0), output("tau", "tau", 20.0, 64)
        entries = (
            EntryVectors("S_z", "plain", (S, z), plain),
            EntryVectors("z", "plain", (z,), np.where(plain < 0, -1, ANY_ANSWER), domain=count // 2),
            EntryVectors("control", "control", (tau,), control, rank),
            EntryVectors("project", "control", (output("tau", "project", 2.0),), plain),
            EntryVectors("step", "control", (output("tau", "step", 2.0),), plain, numbers=(DT,)),
            EntryVectors("pinv", "pinv", (output("S_pinv", "S_pinv", 100.0, 64),), arguments={"S": S_given}),
            EntryVectors(
                "solve",
                "solve",
                (output("tau", "solve", 100.0, 64),),
                arguments={"S": S_given, "z": z_given, "y": y_given},
            ),
        )
        return VectorSet(prefix, scalar, entries, PARAMS, FIELDS, inputs)

    def write(
        self, folder: Path, prefix: str = "sample", scalar: Scalar = "float64", edits: Sequence[tuple[str, str]] = ()
    ) -> Path:
        """A copy of the package in folder/<prefix>, with `edits` (old text, new text) made to its C source."""
        package = folder / prefix
        package.mkdir(parents=True)
        header, source = (SAMPLE / "sample.h").read_text(), (SAMPLE / "sample.c").read_text()
        for old, new in edits:
            assert source.count(old) == 1, f"{old!r} is in the source {source.count(old)} times"
            source = source.replace(old, new)
        (package / f"{prefix}.h").write_text(_rename(header, prefix, scalar))
        (package / f"{prefix}.c").write_text(_rename(source, prefix, scalar))
        (package / "CMakeLists.txt").write_text(
            TEMPLATES.get_template("CMakeLists.txt.j2").render(p=prefix, math=True, core="", batch=False)
        )
        (package / "manifest.json").write_text(MANIFEST.format(prefix=prefix, scalar=scalar))
        return package


@pytest.fixture(scope="session")
def sample() -> Sample:
    """See Sample."""
    return Sample()


def _rename(text: str, prefix: str, scalar: Scalar) -> str:
    for old, new in (("sample_", f"{prefix}_"), ('"sample.h"', f'"{prefix}.h"'), ("SAMPLE", prefix.upper())):
        text = text.replace(old, new)
    if scalar == "float32":
        text = text.replace("double", "float").replace("sin(", "sinf(").replace("fabs(", "fabsf(")
        for literal in ("0.0", "2.0", "1.5", "0.5", "9.81"):
            text = text.replace(literal, literal + "f")
    return text


def _truth(inputs: dict[str, np.ndarray], k: int) -> dict[str, list[Ball]]:
    """S, z, tau, step and project at vector k, to 60 digits."""
    with working():
        given = {name: balls(array[k]) for name, array in inputs.items()}
        q, u, tau, (E_0,) = (given[name] for name, _ in FIELDS)
        (k_0, k_1), g = PARAMS["k"], PARAMS["g"]
        S = [k_0 * u[0] + (q[0].sin() if q[0].is_finite() else NAN), k_1 * u[1]]
        z = 2 * g * q[1] - E_0
        return {
            "S": S,
            "z": [z],
            "tau": [s * z for s in _pinv(S)],
            "step": [t + DT * s for t, s in zip(tau, S, strict=True)],
            "project": tau,
        }


def _solve(S: np.ndarray, z: np.ndarray, y: np.ndarray) -> list[Ball]:
    """y + S+ (z - S y), to 60 digits."""
    with working():
        exact = balls((*S, *y, *z))
        rest = exact[4] - exact[0] * exact[2] - exact[1] * exact[3]
        return [y_j + s_j * rest for y_j, s_j in zip(exact[2:4], _pinv(S), strict=True)]


def _pinv(S: Sequence[Any]) -> list[Ball]:
    with working():
        row = balls(S)
        square = sum(s * s for s in row)
        return [s / square if square > 0 else ZERO for s in row]
