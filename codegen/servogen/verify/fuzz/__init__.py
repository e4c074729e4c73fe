"""Fuzzing the emitted solver: libFuzzer with AddressSanitizer and UBSan, any bits as S, z, y (see target.c)."""

import os
import re
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from servogen.compiler import build_solver
from servogen.scalars import Scalar
from servogen.scene.solver import Solver
from servogen.tools import ToolMissing, find_tool

SOURCE = Path(__file__).with_name("target.c")
SHAPES = ((1, 3), (3, 1), (2, 2), (2, 3), (3, 3), (3, 7), (7, 3), (6, 12))
POLICIES = {
    "default": Solver(),
    "svd": Solver(method="svd"),
    "cod": Solver(method="cod"),
    "raw": Solver(rank="raw"),
    "damping": Solver(damping=0.5),
    "atol, raw, damping": Solver(rank="raw", atol=1.0, damping=2.0),
}
FLAGS = ("-std=c99", "-g", "-O1", "-ffp-contract=off", "-fsanitize=fuzzer,address,undefined",
         "-fno-sanitize-recover=all")  # fmt: skip
HANG = 5
"""Seconds after which one input counts as a hang; a solve takes microseconds."""


@dataclass(frozen=True)
class Fuzzed:
    """One target's run. seconds: of the processor. input: the bytes that failed, in hex; empty if none did. words: the
    sanitiser's last."""

    m: int
    l: int
    scalar: Scalar
    policy: str
    seed: int
    seconds: float
    executions: int
    input: str
    exit_code: int
    words: str

    @property
    def passed(self) -> bool:
        return not self.input and self.exit_code == 0 and self.executions > 0

    def to_json(self) -> dict[str, Any]:
        return asdict(self) | {"passed": self.passed}


@dataclass(frozen=True)
class Target:
    """One generated pseudo-inverse to fuzz."""

    m: int
    l: int
    scalar: Scalar
    policy: str

    def __str__(self) -> str:
        return f"{self.m}x{self.l} {self.scalar} {self.policy}"


def targets() -> list[Target]:
    """Every shape, scalar and policy."""
    scalars: tuple[Scalar, ...] = ("float64", "float32")
    return [Target(m, l, scalar, policy) for m, l in SHAPES for scalar in scalars for policy in POLICIES]


def fuzz(seconds: int, chosen: Sequence[Target], *, seed: int = 1, jobs: int = 1) -> Iterator[tuple[Target, Fuzzed]]:
    """`seconds` of fuzzing of each target, in turn. Raises ToolMissing without clang and its libFuzzer."""
    compiler = find_tool("clang", "clang")
    with ThreadPoolExecutor(jobs) as pool:
        found = pool.map(lambda target: run_target(compiler, target, seconds, seed), chosen)
        yield from zip(chosen, found, strict=True)


def require_fuzzer() -> None:
    """Raises ToolMissing without clang and its libFuzzer."""
    with tempfile.TemporaryDirectory(prefix="servogen-fuzz-") as name:
        build_target(find_tool("clang", "clang"), Target(1, 1, "float64", "default"), Path(name))


def run_target(compiler: Path, target: Target, seconds: int, seed: int) -> Fuzzed:
    """Build one target and run it until it fails or `seconds` have passed."""
    with tempfile.TemporaryDirectory(prefix="servogen-fuzz-") as name:
        folder = Path(name)
        program = build_target(compiler, target, folder)
        options = [f"-max_total_time={seconds}", f"-timeout={HANG}", f"-seed={seed}", "-print_final_stats=1",
                   "-use_value_profile=1", f"-artifact_prefix={folder}/"]  # fmt: skip
        corpus = folder / "corpus"
        corpus.mkdir()
        text = folder / "words.txt"
        with text.open("w") as words:
            running = subprocess.Popen([program, *options, corpus], stdout=words, stderr=words)
            _, code, usage = os.wait4(running.pid, 0)
        said = text.read_text(errors="replace")
        failed = sorted(p for p in folder.iterdir() if re.match(r"(crash|timeout|oom|leak)-", p.name))
        executions = re.search(r"number_of_executed_units: (\d+)", said)
        return Fuzzed(
            target.m,
            target.l,
            target.scalar,
            target.policy,
            seed,
            usage.ru_utime + usage.ru_stime,
            int(executions[1]) if executions else 0,
            failed[0].read_bytes().hex() if failed else "",
            os.waitstatus_to_exitcode(code),
            "\n".join(said.splitlines()[-40:]) if code else "",
        )


def build_target(compiler: Path, target: Target, folder: Path) -> Path:
    """The fuzzer's program in `folder`. Raises ToolMissing where clang has no libFuzzer."""
    solver = POLICIES[target.policy]
    package = build_solver(target.m, target.l, folder, scalar=target.scalar, solver=solver, prefix="pinv")
    real = "double" if target.scalar == "float64" else "float"
    defines = ['-DHEADER="pinv.h"', f"-DREAL={real}", f"-DROWS={target.m}", f"-DCOLUMNS={target.l}",
               f"-DDAMPED={int(solver.damping is not None)}"]  # fmt: skip
    program = folder / "fuzz"
    sources = [str(SOURCE), str(package.path / "pinv.c")]
    command = [str(compiler), *FLAGS, *defines, f"-I{folder}", *sources, "-o", str(program), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        if "libclang_rt.fuzzer" in done.stderr:
            raise ToolMissing("clang has no libFuzzer; on Debian or Ubuntu: apt-get install libclang-rt-dev")
        raise RuntimeError(f"clang refused the fuzzing target of {target}:\n{done.stderr}")
    return program
