"""Evidence for assessors (bench/assess.py prints it).

MISRA C:2012 by cppcheck's addon; clang-tidy; and the branches of the solver that the families of `servogen stress`
take, by gcov. Findings and branches that stand are listed with their reasons in evidence.toml; what is not listed there
fails.
"""

import ctypes
import json
import re
import shutil
import subprocess
import tempfile
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from servogen.compiler import build_solver
from servogen.scalars import Scalar
from servogen.scene.solver import Solver
from servogen.tools import find_tool
from servogen.twins.compiled import CROSS_CHECK_FLAGS, CompiledSolver, stack_source
from servogen.verify.stress import FAMILIES, stress
from servogen.verify.stress.bench import SolverTwin
from servogen.verify.stress.families import CORE

TIDY = "clang-analyzer-*,bugprone-*,cert-*,misc-*,portability-*,performance-*"
NOT_TIDY = (
    "bugprone-easily-swappable-parameters",  # every matrix is a pointer to a scalar
    "misc-include-cleaner",
)
_DUMP = "void __gcov_dump(void);\nvoid dump_coverage(void);\nvoid dump_coverage(void) { __gcov_dump(); }\n"
SHAPES = ((1, 3), (4, 1), (2, 2), (3, 7), (7, 3))
"""One of each kind of solver: one row, one column, square, wide, tall."""


@dataclass(frozen=True)
class Finding:
    """One finding of an analyser: rule or check, and where."""

    file: str
    line: int
    rule: str


@dataclass(frozen=True)
class Branch:
    """A branch that no test took: the function, and its line as it stands."""

    function: str
    line: int
    text: str
    reason: str


@cache
def listed() -> dict[str, Any]:
    """evidence.toml."""
    return tomllib.loads((Path(__file__).parent / "evidence.toml").read_text())


def misra(files: Iterable[Path], *flags: str) -> list[Finding]:
    """All findings of cppcheck's MISRA addon; its own warning of unset variables counts as rule 9.1. ToolMissing."""
    found = []
    for file in files:
        command = [str(find_tool("cppcheck", "cppcheck")), "--std=c99", "--addon=misra", "--quiet", "--enable=style"]
        template = "--template={file}|{line}|{id}"
        done = subprocess.run([*command, template, *flags, str(file)], capture_output=True, text=True)
        for text in done.stderr.splitlines():
            _, line, rule = text.rsplit("|", 2) if text.count("|") >= 2 else ("", "0", "")
            rule = "misra-c2012-9.1" if rule in ("uninitvar", "ctuuninitvar") else rule
            if rule.startswith("misra-c2012-"):
                found.append(Finding(file.name, int(line), rule.removeprefix("misra-c2012-")))
    return found


def unlisted(findings: Iterable[Finding]) -> list[Finding]:
    """Those that are not advisory rules of MISRA's and have no reason in evidence.toml."""
    rules = listed()["misra"] | listed()["tidy"]
    return [f for f in findings if not _stands(rules.get(f.rule, {}))]


def _stands(rule: dict[str, str]) -> bool:
    return rule.get("category") == "advisory" or "reason" in rule


def tidy(files: Iterable[Path], *flags: str) -> list[Finding]:
    """What clang-tidy finds in C files. ToolMissing."""
    checks = f"-*,{TIDY}," + ",".join(f"-{c}" for c in NOT_TIDY)
    found = []
    for file in files:
        command = [
            str(find_tool("clang-tidy", "clang-tidy")),
            f"--checks={checks}",
            "--quiet",
            str(file),
            "--",
            "-std=c99",
        ]
        done = subprocess.run([*command, f"-I{file.parent}", *flags], capture_output=True, text=True)
        for m in re.finditer(r":(\d+):\d+: (?:warning|error): .*\[([\w.,-]+)\]$", done.stdout, re.MULTILINE):
            found.append(Finding(file.name, int(m[1]), m[2]))
    return found


def coverage(
    shapes: Sequence[tuple[int, int]] = SHAPES, scalars: Sequence[Scalar] = ("float64", "float32"), systems: int = 12
) -> tuple[int, int, list[Branch]]:
    """Branches of the solver alone, those taken, and each of those that are not, over the families of the stress."""
    with tempfile.TemporaryDirectory(prefix="servogen-coverage-") as name:
        folder = Path(name)
        libraries: dict[Path, ctypes.CDLL] = {}

        @cache
        def make(m: int, l: int, scalar: Scalar, solver: Solver) -> SolverTwin:
            # one prefix for all, so that a line breaks in the same place whatever the shape
            where = folder / f"{m}x{l}-{scalar}-{abs(hash(solver))}"
            package = build_solver(m, l, where, scalar, solver=solver, prefix="pinv")
            source = package.path / f"{package.prefix}.c"
            library = package.path / "covered.so"
            flags = [*CROSS_CHECK_FLAGS, "-O0", "--coverage", "-fPIC", "-shared"]
            gcc = find_tool("gcc", "gcc")
            (package.path / "stack.c").write_text(stack_source(package.module) + _DUMP)
            subprocess.run([gcc, *flags, source, "stack.c", "-o", library, "-lm"], check=True, cwd=package.path)
            libraries[source] = ctypes.CDLL(str(library))
            twin: Any = CompiledSolver(package.module, libraries[source])
            return twin  # type: ignore[no-any-return]

        own = [name for name, family in FAMILIES.items() if not family.long and name != CORE]
        stress(make, systems=systems * len(shapes), shapes=shapes, scalars=scalars, families=own)
        for m, l in shapes:
            for scalar in scalars:
                for solver in (Solver(), Solver(sigma_min="exact")):
                    _at_the_edge(make(m, l, scalar, solver), m, l, scalar)
        for source, library in libraries.items():
            _without_info(library, source.stem)
        counts: dict[tuple[str, int, int], int] = {}
        lines: dict[tuple[str, int, int], tuple[str, int, str]] = {}
        for source, library in libraries.items():
            library.dump_coverage()
            text = source.read_text().splitlines()
            prefix = source.stem
            for line in _gcov(source):
                for k, branch in enumerate(line["branches"]):
                    where = _shapeless(
                        text[line["line_number"] - 1].strip().replace(prefix.upper(), "P").replace(prefix, "p")
                    )
                    key = (where, k, len(line["branches"]))
                    counts[key] = counts.get(key, 0) + branch["count"]
                    lines[key] = (line.get("function_name", "").replace(prefix, "p"), line["line_number"], where)
    missed = [Branch(*lines[key], _reason(lines[key][2])) for key, count in counts.items() if count == 0]
    return len(counts), sum(c > 0 for c in counts.values()), missed


def _shapeless(text: str) -> str:
    """A line of C as its template has it: numbers as N, so that shapes and scalars count together."""
    number = r"UINT(?:32|64)_C\(0x[0-9a-f]+\)|\b\d[\d.]*(?:e[+-]?\d+)?f?\b"
    return re.sub(r"\s*/\*.*\*/", "", re.sub(number, "N", text))


def _at_the_edge(twin: SolverTwin, m: int, l: int, scalar: Scalar) -> None:
    """What no family draws: no y, no S at all, numbers at both ends of the range, and what is none."""
    generator = np.random.default_rng(0)
    ends = [10.0**e for e in ((-300, -160, 0, 150, 300) if scalar == "float64" else (-40, -24, 0, 18, 36))]
    for base in (generator.standard_normal((m, l)), np.zeros((m, l)), np.ones((m, l)), np.eye(m, l)):
        for S_size in (*ends, np.nan, np.inf):
            for z_size in (0.0, *ends, np.nan):
                with np.errstate(all="ignore"):
                    S = (base * S_size * generator.choice(ends[1:4], (m, 1)) ** generator.integers(0, 2)).astype(scalar)
                    z = (z_size * generator.standard_normal(m)).astype(scalar)
                for y in (None, np.zeros(l, scalar), (ends[2] * generator.standard_normal(l)).astype(scalar),
                          (np.float64(z_size) * np.ones(l)).astype(scalar)):  # fmt: skip
                    twin.solve(S, z, y)
                twin.pinv(S)
    short, long = (1e-36, 1e186) if scalar == "float64" else (3e-5, 4e22)
    for _ in range(8):  # y far along a small S
        S = short * generator.uniform(1.0, 2.0, (m, l)).astype(scalar)
        twin.solve(S, np.ones(m, scalar), long / short * S[0])


def _without_info(library: ctypes.CDLL, prefix: str) -> None:
    """The functions as a caller has them who asks for nothing but the answer."""
    for value in (0.0, 1.0, float("nan")):
        S, out = ((ctypes.c_double * 200)(*[value] * 200) for _ in range(2))
        getattr(library, f"{prefix}_pinv")(S, out, None)
        getattr(library, f"{prefix}_solve")(S, S, None, out, None)


def _gcov(source: Path) -> list[dict[str, Any]]:
    command = [shutil.which("gcov") or "gcov", "--json-format", "--stdout", "--branch-probabilities"]
    data = next(source.parent.glob(f"*{source.stem}.gcda"))
    done = subprocess.run([*command, data], cwd=source.parent, capture_output=True, text=True, check=True)
    files = [f for text in done.stdout.splitlines() for f in json.loads(text)["files"]]
    return [line for f in files if Path(f["file"]).name == source.name for line in f["lines"]]


def _reason(text: str) -> str:
    return next((b["reason"] for b in listed().get("branch", ()) if re.search(b["line"], text)), "")
