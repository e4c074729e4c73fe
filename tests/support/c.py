"""C compilers for the tests: the design's strict flags, and programs run in a batch."""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from support.missing import skip_or_fail

STRICT = tuple(
    "-std=c99 -Wall -Wextra -Wpedantic -Wconversion -Wdouble-promotion -Wmissing-prototypes -Wshadow -Werror".split()
)


def compiler(name: str) -> str:
    """The path of a compiler; the test is skipped where it is missing."""
    return shutil.which(name) or skip_or_fail(f"{name} is not installed")


def run(argv: Sequence[str | Path]) -> str:
    """Standard output of a command that must succeed; its complaints are the failure's text."""
    done = subprocess.run([str(a) for a in argv], capture_output=True, text=True, stdin=subprocess.DEVNULL)
    assert done.returncode == 0, f"{argv[0]} refused:\n{done.stdout}{done.stderr}"
    return done.stdout
