"""Machine instructions per call, counted by valgrind's callgrind: the same on every run."""

import os
import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from servogen.bench.driver import Driver
from servogen.bench.inputs import Inputs
from servogen.bench.results import Instructions

MISSING = "instructions are not counted: valgrind is not installed; on Debian or Ubuntu: apt-get install valgrind"

QUIET_LINKER = {**os.environ, "LD_BIND_NOW": "1"}  # else the first call of sin is charged for finding it


def available() -> bool:
    """Whether valgrind is on this machine."""
    return shutil.which("valgrind") is not None


def count(driver: Driver, inputs: Inputs, task: int) -> Instructions:
    """Instructions of one task, averaged over all states; only those spent inside the function called."""
    what = driver.tasks[task]
    symbol = what.contender.calls[what.output].symbol
    profile = driver.folder / "callgrind.out"
    options = ["--tool=callgrind", f"--toggle-collect={symbol}", f"--callgrind-out-file={profile}"]
    options += ["--compress-strings=no", "--compress-pos=no"]
    run = subprocess.run(
        ["valgrind", *options, *driver.command_once(inputs, task)],
        capture_output=True,
        text=True,
        env=QUIET_LINKER,
    )
    if run.returncode != 0:
        raise RuntimeError(f"valgrind failed: {run.stderr}")
    by_object = _self_cost(profile)
    total = sum(by_object.values())
    libm = sum(cost for name, cost in by_object.items() if Path(name).name.startswith("libm"))
    return Instructions(total / inputs.count, (total - libm) / inputs.count)


def collected(command: Sequence[str], *options: str) -> int:
    """Instructions of a whole program, or of what it switches on with --instr-atstart=no. RuntimeError where valgrind
    says none."""
    argv = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", *options, *command]
    run = subprocess.run(argv, capture_output=True, text=True, env=QUIET_LINKER)
    found = re.search(r"Collected : (\d+)", run.stderr)
    if found is None:
        raise RuntimeError(f"valgrind failed: {run.stderr}")
    return int(found[1])


def _self_cost(profile: Path) -> dict[str, int]:
    """Object file -> instructions executed in it."""
    costs: dict[str, int] = {}
    current, skip = "", False
    for line in profile.read_text().splitlines():
        if line.startswith("ob="):
            current = line[3:]
        elif line.startswith("calls="):
            skip = True  # the next line is the callee's inclusive cost, counted at the callee
        elif line[:1].isdigit() or line[:1] in "+-*":
            if not skip and line:
                costs[current] = costs.get(current, 0) + int(line.split()[1])
            skip = False
    return costs
