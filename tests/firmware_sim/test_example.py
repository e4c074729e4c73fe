"""The example firmware, built and run for each board; its package by add_subdirectory and by find_package."""

import os
import subprocess

import pytest
from servogen.tools import find_tool, firmware_sim, tool_path
from servogen.verify.generated import committed_folder
from servogen.verify.harness import targets

BOARDS = [name for name in targets() if name != "host"]
PACKAGE = committed_folder() / "double_pendulum_energy" / "f32"


def cmake(*arguments):
    command = [find_tool("cmake", "cmake"), *arguments]
    done = subprocess.run(
        [str(c) for c in command], capture_output=True, text=True, env=os.environ | {"PATH": tool_path()}
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def toolchain(board):
    return f"-DCMAKE_TOOLCHAIN_FILE={firmware_sim() / 'targets' / board / 'toolchain.cmake'}"


def build(board, folder, *options):
    """Build and run it in the emulator; what it said."""
    given = ["-G", "Ninja", toolchain(board), f"-DSERVOGEN_TARGET={board}", *options]
    cmake("-S", firmware_sim() / "example", "-B", folder, *given)
    cmake("--build", folder)
    command = [find_tool("ctest", "cmake"), "--test-dir", folder, "--verbose"]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    return done.stdout


@pytest.mark.parametrize("board", BOARDS)
def test_holds_the_last_command_while_a_sensor_fails(board, need_target, tmp_path):
    need_target(board)
    said = build(board, tmp_path, f"-DSERVOGEN_PACKAGE={PACKAGE}")
    assert "ticks=400 faults=50 moved=0 late=0 pushed=1" in said


def test_an_installed_package_is_found(need_target, tmp_path):
    need_target("cortex-m4")
    cmake("-S", PACKAGE, "-B", tmp_path / "package", "-G", "Ninja", toolchain("cortex-m4"))
    cmake("--build", tmp_path / "package")
    cmake("--install", tmp_path / "package", "--prefix", tmp_path / "prefix")
    prefix = f"-DCMAKE_PREFIX_PATH={tmp_path / 'prefix'}"
    assert "faults=50" in build("cortex-m4", tmp_path / "build", prefix, "-DCMAKE_FIND_ROOT_PATH_MODE_PACKAGE=BOTH")
