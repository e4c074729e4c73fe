"""Finds the programs the harness drives, and says how to install those that are missing."""

import os
import shutil
import subprocess
import sysconfig
from pathlib import Path


class ToolMissing(RuntimeError):  # noqa: N818, the name says it
    """A program or library is not on this machine; the message names it and the command that installs it."""


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
