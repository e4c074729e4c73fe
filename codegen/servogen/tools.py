"""Finds the programs the harness drives, and says how to install those that are missing."""

import errno
import os
import shlex
import shutil
import subprocess
import sysconfig
import tempfile
from collections.abc import Sequence
from pathlib import Path


class ToolMissing(RuntimeError):  # noqa: N818, the name says it
    """A program or library is not on this machine; the message names it and the command that installs it."""


class CompilerRefused(RuntimeError):  # noqa: N818, the name says it
    """The C compiler did not take the generated code; the message ends with what it printed."""


class CompilerUnusable(RuntimeError):  # noqa: N818, the name says it
    """The C compiler, with the flags it was given, compiles nothing at all; the message ends with what it printed."""


def c_compiler(given: str | None = None) -> list[str]:
    """The words of a C compiler's command: as given, else $CC, else cc.

    Raises:
        ToolMissing: there is no such program.
        CompilerUnusable: the words cannot be told apart.
    """
    command = given or os.environ.get("CC", "").strip() or "cc"
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise CompilerUnusable(f"the C compiler {command!r} is no command: {error}") from None
    if shutil.which(words[0]) is None:
        raise ToolMissing(
            f"no C compiler {words[0]!r} on this machine; install one (apt-get install gcc), or name another in CC"
        )
    return words


def compile_c(command: Sequence[str], flags: Sequence[str], more: Sequence[str], what: str) -> None:
    """Runs a C compiler: command, flags that the user may have chosen, and the rest of the arguments.

    Raises:
        CompilerUnusable: with these flags it does not compile an empty function either.
        CompilerRefused: it does, but not `what`.
        OSError: the disk is full.
    """
    run = subprocess.run([*command, *flags, *more], capture_output=True, text=True, errors="replace")
    if run.returncode == 0:
        return
    if os.strerror(errno.ENOSPC) in run.stderr:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), tempfile.gettempdir())
    with tempfile.TemporaryDirectory(prefix="servogen-probe-") as folder:
        probe = Path(folder) / "probe.c"
        probe.write_text("void probe(void);\nvoid probe(void) {}\n")
        argv = [*command, *flags, "-fPIC", "-shared", str(probe), "-o", str(probe.with_suffix(".so"))]
        empty = subprocess.run(argv, capture_output=True, text=True, errors="replace")
    if empty.returncode != 0:
        said = next((line for line in empty.stderr.splitlines() if "error" in line), empty.stderr.strip())
        told = shlex.join([*command, *(word for word in flags if not word.startswith(("-I", "-D")))])
        raise CompilerUnusable(
            f"{told} compiles not even an empty function; "
            f"check CC and the flags: {said or f'it printed nothing, exit code {empty.returncode}'}"
        )
    raise CompilerRefused(f"{shlex.join(command)} refused {what}:\n{run.stderr.strip()}")


def tool_path() -> str:
    """The search path for programs: this Python's scripts (cmake and ninja from PyPI) first, then PATH."""
    return os.pathsep.join([sysconfig.get_path("scripts"), os.environ.get("PATH", os.defpath)])


def find_tool(name: str, debian_package: str) -> Path:
    """The full path of the program `name`.

    Raises:
        ToolMissing: it is neither among this Python's scripts nor on PATH.
    """
    found = shutil.which(name, path=tool_path())
    if found is None:
        raise ToolMissing(f"{name} is not installed; on Debian or Ubuntu: apt-get install {debian_package}")
    return Path(found)


def find_library(compiler: Path, file: str, debian_package: str) -> Path:
    """The full path of the library `file` (say libm.a) as `compiler` would link it.

    Raises:
        ToolMissing: the compiler does not know it.
    """
    answer = subprocess.run(
        [compiler, f"-print-file-name={file}"], capture_output=True, text=True, check=True, stdin=subprocess.DEVNULL
    ).stdout.strip()
    if answer == file:  # how gcc says that it found none
        raise ToolMissing(f"{compiler.name} has no {file}; on Debian or Ubuntu: apt-get install {debian_package}")
    return Path(answer)


def firmware_sim() -> Path:
    """The folder of the CMake project: inside an installed package, or at the root of the repository."""
    package = Path(__file__).resolve().parent
    for folder in (package / "_firmware_sim", package.parents[1] / "firmware_sim"):
        if (folder / "CMakeLists.txt").is_file():
            return folder
    raise RuntimeError("firmware_sim is in neither the package nor the repository; reinstall servogen")
