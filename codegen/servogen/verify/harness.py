"""Drives firmware_sim: builds generated packages with their vectors, runs them here or on an emulated board.

The harness judges on the target; this module reads its lines, and fails whatever the lines do not prove: a missing
line, a comparison that did not take place, an exit code that disagrees.
"""

import json
import os
import re
import subprocess
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from servogen.tools import find_library, find_tool, firmware_sim, tool_path
from servogen.verify.vectors import VectorSet, data_bytes, render_vectors

Compiler = Literal["gcc", "clang", "asan"]
Progress = Callable[[str], None]

_COMPILERS = {"gcc": ("gcc", "gcc"), "clang": ("clang", "clang"), "asan": ("gcc", "gcc")}


class VectorsTooLarge(ValueError):  # noqa: N818, the name says it
    """The vectors do not fit into the board; the message says how many would."""


_SAID = 30
"""Lines of what a tool printed, at most."""


class HarnessBuildError(RuntimeError):
    """CMake or a compiler refused; the message ends with what it printed."""


@dataclass(frozen=True)
class OutputResult:
    """What the harness measured for one output of one entry point.

    compared: values held against the truth, of which `outside` were beyond their tolerance. max_ulps: largest error in
    ulps of the output's scale, over the domain's vectors. max_ratio: largest error / tolerance, at vector `worst`,
    element `element` (flat). status_mismatches, rank_mismatches: per entry point. touched: values changed under a
    negative status. overruns: guard words changed. drift: values that differed when the same vector was run again.
    hash: 64-bit FNV-1a over the statuses and the bits of all answers. histogram: values by their error, up to 0.5, 1,
    2, 4, ... ulps of the output's scale, over the domain; the last bin holds the rest. problem: empty if passed, else
    what is wrong.
    """

    entry: str
    output: str
    vectors: int
    compared: int
    outside: int
    max_ulps: float
    max_ratio: float
    worst: int
    element: int
    status_mismatches: int
    rank_mismatches: int
    touched: int
    overruns: int
    drift: int
    hash: str
    histogram: tuple[int, ...]
    problem: str

    @property
    def passed(self) -> bool:
        """Whether everything that had to be compared was compared, and was right."""
        return not self.problem


@dataclass(frozen=True, eq=False)
class Dump:
    """Every answer of one output. status: (N,). values: (N, size), NaN where the status is negative."""

    status: NDArray[np.int64]
    values: NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Cost:
    """Instructions of one call of an entry point, info included: over `vectors` vectors, the worst of them `vector`.

    stack: the most bytes any call took below its caller's, found by painting.
    """

    worst: int
    mean: int
    vector: int
    vectors: int
    stack: int


@dataclass(frozen=True, eq=False)
class HarnessResult:
    """One package on one target. preset: the build that was run (gcc, clang, asan, or the board's name).

    problems: everything wrong, in words; empty if passed. dumps: keyed by (entry, output), if they were asked for.
    costs: by entry, if they were asked for and the target counts. image: the executable.
    """

    prefix: str
    target: str
    preset: str
    outputs: tuple[OutputResult, ...]
    problems: tuple[str, ...]
    exit_code: int
    log: str
    image: Path
    dumps: Mapping[tuple[str, str], Dump] = field(default_factory=dict)
    costs: Mapping[str, "Cost"] = field(default_factory=dict)

    @property
    def passed(self) -> bool:
        """Whether the package is right on this target."""
        return not self.problems


def targets() -> list[str]:
    """The names of all targets: host, and the boards."""
    return sorted(path.parent.name for path in firmware_sim().glob("targets/*/target.json"))


def default_states(target: str, otherwise: int) -> int:
    """States to draw for a target: its own number where the board is small or slow."""
    return int(_describe(target).get("states", otherwise))


def fitting(vectors: VectorSet, target: str) -> VectorSet:
    """As many of the vectors as the target holds, evenly chosen."""
    room, size = int(_describe(target)["vector_bytes"]), data_bytes(vectors)
    count = max(entry.count for entry in vectors.entries)
    while size > room and count > 1:
        count = max(1, min(count - 1, count * room // size))
        vectors = vectors.thinned(count)
        size = data_bytes(vectors)
    return vectors


def require_target(target: str = "host", compiler: Compiler = "gcc") -> None:
    """Checks that every tool is there that `target` (on the host: `compiler`) takes.

    Raises:
        ToolMissing: naming the tool and the command that installs it.
        ValueError: there is no such target or compiler.
    """
    about = _describe(target)
    _preset(target, compiler)
    for name in ("cmake", "ctest"):
        find_tool(name, "cmake")
    find_tool("ninja", "ninja-build")
    if target == "host":
        find_tool(*_COMPILERS[compiler])
    for tool in about["tools"]:
        find_tool(tool["name"], tool["package"])
    for library in about["libraries"]:
        find_library(find_tool(library["compiler"], library["package"]), library["file"], library["package"])


def run_harness(
    packages: list[Path],
    vectors: Mapping[str, VectorSet],
    *,
    target: str = "host",
    compiler: Compiler = "gcc",
    build_dir: Path,
    dump: bool = False,
    optimisation: str = "-O2",
    timeout: float = 600.0,
    progress: Progress | None = None,
    measure: bool = False,
) -> list[HarnessResult]:
    """Builds every package with its vectors, runs it, and reads the result; one result per package, in order.

    vectors: by prefix. compiler: on the host only. build_dir: made if need be, and reused. dump: also bring back every
    answer. timeout: seconds that one package's run may take. progress: called with a line of text at each step.
    measure: also count the instructions of every entry point, on a board.

    Raises:
        ToolMissing: naming the tool and the command that installs it.
        HarnessBuildError: the code does not compile or link; the message holds the compiler's.
        ValueError: packages and vectors do not fit together, or vectors do not fit into the board.
    """
    say = progress or (lambda text: None)
    require_target(target, compiler)
    manifests = {_manifest(path)["prefix"]: _manifest(path) for path in packages}
    _check_packages(packages, manifests, vectors, target)
    build_dir = build_dir.resolve()
    say(f"{target}: writing vectors of {', '.join(manifests)}")
    for prefix in manifests:
        write_if_changed(build_dir / "vectors" / f"{prefix}_vectors.h", render_vectors(vectors[prefix]))
    say(f"{target}: building {len(manifests)} images")
    given = {"DUMP": "ON" if dump else "OFF", "MEASURE": "ON" if measure else "OFF", "OPTIMISATION": optimisation}
    commands = build_images(packages, target, compiler, build_dir, given)

    def check(prefix: str) -> HarnessResult:
        say(f"{target}: running {prefix}")
        code, log = execute(commands[f"check_{prefix}"], timeout)
        image = Path(commands[f"check_{prefix}"]["command"][-1])
        return read_log(vectors[prefix], target, _preset(target, compiler), code, log, image)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(check, manifests))


def hash_solvers(
    packages: list[Path],
    systems: int,
    *,
    target: str = "host",
    compiler: Compiler = "gcc",
    build_dir: Path,
    optimisation: str = "-O2",
    timeout: float = 600.0,
) -> dict[str, str]:
    """By prefix, of packages of `servogen.build_solver`: a hash over the bits of `systems` answers and their infos.

    8 hexadecimal digits; "failed: ..." where the image does not run to its end. Raises as run_harness does.
    """
    require_target(target, compiler)
    options = {"SOLVERS": _folders(packages), "SYSTEMS": str(systems), "OPTIMISATION": optimisation}
    commands = build_images([], target, compiler, build_dir, options)
    found = {}
    for prefix in [_manifest(path)["prefix"] for path in packages]:
        code, log = execute(commands[f"bits_{prefix}"], timeout)
        words = next((w for w in map(words_of, log.splitlines()) if w[""] == "bits"), {})
        good = code == 0 and "hash" in words
        found[prefix] = words["hash"] if good else f"failed: {complaint_of(log, code) or f'exit code {code}'}"
    return found


def read_log(
    vectors: VectorSet, target: str, preset: str, exit_code: int, log: str, image: Path = Path()
) -> HarnessResult:
    """What a run proves, from its exit code and the lines it printed; whatever is not proven is a problem."""
    lines = [words_of(line) for line in log.splitlines()]
    found = {(w["entry"], w["output"]): w for w in lines if w[""] == "result" and _complete(w)}
    head = next((w for w in lines if w[""] == "harness"), {})
    verdict = next((w for w in lines if w[""] == "verdict"), {})
    outputs: list[OutputResult] = []
    problems: list[str] = []
    if head.get("prefix") != vectors.prefix:
        problems.append("the image printed no heading of its own")
    elif int(head["prepare"]) < 0:
        problems.append(f"{vectors.prefix}_prepare returned {head['prepare']}")
    for entry in vectors.entries:
        for output in entry.outputs:
            words = found.get((entry.name, output.name))
            if words is None:
                problems.append(f"{entry.name}, {output.name}: no result was printed")
                continue
            result = _output_result(words, entry.count, entry.comparisons(output))
            outputs.append(result)
            if result.problem:
                problems.append(f"{entry.name}, {output.name}: {result.problem}")
    if not problems and (verdict.get("pass") != "1" or exit_code != 0):
        problems.append("the lines are good, the verdict is not")
    if problems and (complaint := complaint_of(log, exit_code)):
        problems.append(f"the run ended with exit code {exit_code}: {complaint}")
    return HarnessResult(
        vectors.prefix,
        target,
        preset,
        tuple(outputs),
        tuple(problems),
        exit_code,
        log,
        image,
        _dumps(lines),
        _costs(lines),
    )


def _describe(target: str) -> dict[str, Any]:
    """The target's own description, targets/<target>/target.json."""
    path = firmware_sim() / "targets" / target / "target.json"
    if not path.is_file():
        raise ValueError(f"there is no target {target!r}; there are {', '.join(targets())}")
    about: dict[str, Any] = json.loads(path.read_text())
    return about


def _preset(target: str, compiler: str) -> str:
    """The CMake preset: the compiler's on the host, the board's elsewhere."""
    if target != "host":
        return target
    if compiler not in _COMPILERS:
        raise ValueError(f"there is no compiler {compiler!r}; there are {', '.join(_COMPILERS)}")
    return compiler


def _manifest(package: Path) -> dict[str, Any]:
    path = package / "manifest.json"
    if not path.is_file():
        raise ValueError(f"{package} is no generated package: it holds no manifest.json")
    manifest: dict[str, Any] = json.loads(path.read_text())
    return manifest


def _check_packages(
    packages: list[Path], manifests: Mapping[str, dict[str, Any]], vectors: Mapping[str, VectorSet], target: str
) -> None:
    """Raises ValueError unless there are packages, each with vectors of its scalar that fit into the target."""
    if not packages:
        raise ValueError("no packages to check")
    if len(manifests) < len(packages):
        raise ValueError("two packages have the same prefix; generate one of them with another")
    room = int(_describe(target)["vector_bytes"])
    for prefix, manifest in manifests.items():
        if prefix not in vectors:
            raise ValueError(f"no vectors for the package {prefix}")
        given = vectors[prefix]
        if given.prefix != prefix or given.scalar != manifest["scalar"]:
            raise ValueError(f"{prefix} is {manifest['scalar']}, its vectors are of {given.prefix}, {given.scalar}")
        if (size := data_bytes(given)) > room:
            count = max(entry.count for entry in given.entries)
            raise VectorsTooLarge(
                f"vectors of {prefix} take {size} bytes, {target} holds {room}: "
                f"give about {count * room // size} of the {count} vectors, or fewer entry points"
            )


def build_images(
    packages: list[Path], target: str, compiler: str, build_dir: Path, options: Mapping[str, str]
) -> dict[str, dict[str, Any]]:
    """Configure and build what is in build_dir/vectors; by the test's name its command and environment.

    options: of the CMake project, without their SERVOGEN_. Raises HarnessBuildError where CMake or a compiler refuses.
    """
    build_dir = build_dir.resolve()
    settings = {
        "PACKAGES": _folders(packages),
        "VECTORS": (build_dir / "vectors").as_posix(),
        **options,
    }
    ninja = find_tool("ninja", "ninja-build").as_posix()
    given = [*(f"-DSERVOGEN_{n}={v}" for n, v in settings.items()), f"-DCMAKE_MAKE_PROGRAM={ninja}"]
    _run([find_tool("cmake", "cmake"), "--preset", _preset(target, compiler), "-B", build_dir, *given])
    _run([find_tool("cmake", "cmake"), "--build", build_dir])
    return _test_commands(build_dir)


def _folders(packages: list[Path]) -> str:
    return ";".join(p.resolve().as_posix() for p in packages)


def _environment() -> dict[str, str]:
    """The caller's, with this Python's programs in front; and without flags that would change what is checked."""
    dropped = ("CFLAGS", "CPPFLAGS", "LDFLAGS", "CC")
    kept = {name: value for name, value in os.environ.items() if name not in dropped}
    return kept | {"PATH": tool_path()}


def _run(command: list[str | Path]) -> str:
    """Runs CMake from the project's folder, where the presets are."""
    done = subprocess.run(
        command, cwd=firmware_sim(), env=_environment(), stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    if done.returncode != 0:
        raise HarnessBuildError(_complaint(command, done.stdout + done.stderr))
    return done.stdout


def _complaint(command: list[str | Path], printed: str) -> str:
    """What failed and what it said: of ninja's log the first step that failed, of CMake's what follows its error."""
    lines = printed.strip().splitlines()
    failed = next((k for k, line in enumerate(lines) if line.startswith("FAILED: ")), None)
    if failed is not None:
        output, step = lines[failed].removeprefix("FAILED: ").split()[-1], lines[failed + 1 :]
        said = list(takewhile(lambda line: not line.startswith(("[", "ninja: ")), step[1:]))
        commands = [words.split()[0] for words in step[0].split(" && ") if words.strip() not in ("", ":")]
        programs = dict.fromkeys(name for name in (Path(c).name for c in commands) if name != "cmake")
        return "\n".join([f"{', '.join(programs)} could not make {output}:", *(said[:_SAID] or ["(nothing was said)"])])
    start = next((k for k, line in enumerate(lines) if line.startswith("CMake Error")), max(len(lines) - _SAID, 0))
    return "\n".join([f"failed: {Path(command[0]).name}", *lines[start : start + _SAID]])


def _test_commands(build_dir: Path) -> dict[str, dict[str, Any]]:
    """CTest's own list of tests, by name: the command (emulator included) and its environment."""
    listing = json.loads(_run([find_tool("ctest", "cmake"), "--test-dir", build_dir, "--show-only=json-v1"]))
    tests = {}
    for test in listing["tests"]:
        properties = {p["name"]: p["value"] for p in test.get("properties", [])}
        variables = dict(pair.split("=", 1) for pair in properties.get("ENVIRONMENT", []))
        tests[test["name"]] = {"command": test["command"], "environment": variables}
    return tests


def execute(test: Mapping[str, Any], timeout: float) -> tuple[int, str]:
    """Exit code and output of one check; a check that does not end counts as exit code -1."""
    try:
        done = subprocess.run(
            test["command"],
            env=_environment() | test["environment"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=timeout,
        )
    except subprocess.TimeoutExpired as expired:
        printed = (expired.stdout or b"").decode(errors="replace")
        return -1, f"{printed}\ntimeout: no end within {timeout:g} s\n"
    return done.returncode, done.stdout.decode(errors="replace")


def words_of(line: str) -> dict[str, str]:
    """A line of key=value words as a dict; the first word, which has no key, under ''."""
    first, *rest = line.split() or [""]
    return {"": first} | dict(word.split("=", 1) for word in rest if "=" in word)


def _complete(words: Mapping[str, str]) -> bool:
    return "pass" in words and "entry" in words and "output" in words


def _output_result(words: Mapping[str, str], vectors: int, comparisons: int) -> OutputResult:
    """One `result` line, held against the numbers of vectors and comparisons there had to be."""
    numbers = {key: int(words[key]) for key in _COUNTS}
    ulps, ratio = floats_of(words["ulps"])[0], floats_of(words["ratio"])[0]
    remarks = [f"{numbers[key]} {text}" for key, text in _COUNTS.items() if text and numbers[key]]
    if numbers["outside"]:
        remarks.append(f"worst {ratio:.3g} times the tolerance at vector {numbers['worst']}[{numbers['element']}]")
    if vectors == 0 or comparisons == 0:
        remarks.append("nothing to compare")
    elif (numbers["vectors"], numbers["compared"]) != (vectors, comparisons):
        remarks.append(f"{numbers['compared']} of {comparisons} values were compared")
    if not remarks and words["pass"] != "1":
        remarks.append("the harness failed it")
    return OutputResult(
        entry=words["entry"],
        output=words["output"],
        vectors=numbers["vectors"],
        compared=numbers["compared"],
        outside=numbers["outside"],
        max_ulps=float(ulps),
        max_ratio=float(ratio),
        worst=numbers["worst"],
        element=numbers["element"],
        status_mismatches=numbers["status"],
        rank_mismatches=numbers["rank"],
        touched=numbers["touched"],
        overruns=numbers["overruns"],
        drift=numbers["drift"],
        hash=words["hash"],
        histogram=tuple(int(n) for n in words["histogram"].split(",")),
        problem="; ".join(remarks),
    )


# The whole numbers of a `result` line, and what they mean where they must be zero.
_COUNTS = {
    "vectors": "",
    "compared": "",
    "outside": "values beyond their tolerance",
    "worst": "",
    "element": "",
    "status": "wrong statuses",
    "rank": "wrong ranks",
    "touched": "values changed although the status was negative",
    "overruns": "guard words overwritten",
    "drift": "values differ when run again (not written, or dependent on what was there)",
}


def floats_of(text: str) -> NDArray[np.floating[Any]]:
    """Floats from the hexadecimal of their bits, separated by commas; 8 digits are float32, 16 float64."""
    words = text.split(",")
    kind = {8: "4", 16: "8"}[len(words[0])]
    return np.array([int(word, 16) for word in words], dtype=f"u{kind}").view(f"f{kind}")


def _dumps(lines: list[dict[str, str]]) -> dict[tuple[str, str], Dump]:
    """All `value` lines, by entry and output."""
    rows: dict[tuple[str, str], list[tuple[int, NDArray[np.floating[Any]]]]] = {}
    for words in lines:
        if words[""] == "value" and "bits" in words:
            values = floats_of(words["bits"])
            status = int(words["status"])
            rows.setdefault((words["entry"], words["output"]), []).append(
                (status, np.full_like(values, np.nan) if status < 0 else values)
            )
    return {
        key: Dump(np.array([status for status, _ in found]), np.stack([values for _, values in found]))
        for key, found in rows.items()
    }


def _costs(lines: list[dict[str, str]]) -> dict[str, Cost]:
    """All `cost` lines whose every vector was counted."""
    found = [words for words in lines if words[""] == "cost" and words["missing"] == "0"]
    return {w["entry"]: Cost(*(int(w[key]) for key in ("worst", "mean", "vector", "vectors", "stack"))) for w in found}


def complaint_of(log: str, exit_code: int) -> str:
    """A sanitizer's or the board's complaint, or the last line of a run that broke off; empty if it ended by itself."""
    lines = [line.strip() for line in log.splitlines() if line.strip() and not line.startswith("value ")]
    for line in lines:
        if re.search(r"runtime error:|ERROR: \w+Sanitizer|^fault:|^timeout:", line):
            return line
    if exit_code in (0, 1):
        return ""
    return lines[-1] if lines else "it printed nothing"


def write_if_changed(path: Path, text: str) -> None:
    """So that an unchanged header leads to no compilation."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.is_file() or path.read_text() != text:
        path.write_text(text)
