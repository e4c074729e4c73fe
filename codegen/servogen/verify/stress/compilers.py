"""Whether gcc and clang take the package of a shape under the strict flags of the cross-check, without a word."""

import subprocess
import tempfile
from pathlib import Path

from servogen.compiler import build_solver
from servogen.scalars import Scalar
from servogen.scene.solver import Solver
from servogen.tools import find_tool

STRICT = (
    "-std=c99 -O1 -ffp-contract=off -Wall -Wextra -Wpedantic -Wconversion -Wdouble-promotion -Wmissing-prototypes "
    "-Wshadow -Werror"
).split()


def complaints(m: int, l: int, scalar: Scalar, solver: Solver) -> list[str]:
    """What gcc and clang say; [] is good. Raises ToolMissing where one is not here."""
    said = []
    with tempfile.TemporaryDirectory(prefix="servogen-strict-") as name:
        package = build_solver(m, l, name, scalar=scalar, solver=solver)
        source, target = package.path / f"{package.prefix}.c", Path(name) / "strict.o"
        for compiler in ("gcc", "clang"):
            command = [str(find_tool(compiler, compiler)), *STRICT, "-c", str(source), "-o", str(target)]
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode != 0 or done.stderr:
                said.append(f"{compiler}: {done.stderr}")
    return said
