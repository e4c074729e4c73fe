"""A generated package as a user takes it: on its own, and two of them inside another project, from C and from C++."""

import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from servogen.tools import find_tool, firmware_sim, tool_path

PROJECT = """
cmake_minimum_required(VERSION 3.20)
project(user LANGUAGES C CXX)
add_subdirectory(packages/sample)
add_subdirectory(packages/sample_f32)
add_executable(user user.c user_too.cpp)
target_link_libraries(user PRIVATE servogen::sample servogen::sample_f32)
"""
USER_C = """
#include "sample.h"
#include "sample_f32.h"
int too(void);
int main(void)
{
    const double S[2] = {0.0, 2.0};
    const float S_f32[2] = {0.0f, 2.0f};
    double S_pinv[2];
    float S_pinv_f32[2];
    (void)sample_pinv(S, S_pinv, 0);
    (void)sample_f32_pinv(S_f32, S_pinv_f32, 0);
    return S_pinv[1] == 0.5 && S_pinv_f32[1] == 0.5f && too() == 0 ? 0 : 1;
}
"""
USER_CXX = """
#include "sample.h"
#include "sample_f32.h"
extern "C" int too()
{
    sample_model model;
    sample_f32_model model_f32;
    return sample_prepare(&sample_params_default, &model) + sample_f32_prepare(&sample_f32_params_default, &model_f32);
}
"""


def build(source: Path, *options: str) -> Path:
    """Configures and builds `source`; the build folder."""
    cmake, folder = find_tool("cmake", "cmake"), source / "build"
    for command in ([cmake, "-S", source, "-B", folder, "-G", "Ninja", *options], [cmake, "--build", folder]):
        done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"PATH": tool_path()})
        assert done.returncode == 0, done.stdout + done.stderr
        assert "CMake Warning" not in done.stderr
    return folder


def test_two_packages_in_a_users_project(sample: Any, need_tool: Callable[..., Path], tmp_path: Path) -> None:
    need_tool("g++", "g++")
    sample.write(tmp_path / "packages")
    sample.write(tmp_path / "packages", "sample_f32", "float32")
    for name, text in (("CMakeLists.txt", PROJECT), ("user.c", USER_C), ("user_too.cpp", USER_CXX)):
        (tmp_path / name).write_text(text)
    subprocess.run([build(tmp_path) / "user"], check=True)


@pytest.mark.parametrize("toolchain", [None, "cortex-m4"])
def test_a_package_on_its_own(sample: Any, need_target: Callable[..., None], tmp_path: Path, toolchain: str) -> None:
    need_target(*([toolchain] if toolchain else []))
    package = sample.write(tmp_path)
    options = []
    if toolchain is not None:
        options = [f"-DCMAKE_TOOLCHAIN_FILE={firmware_sim() / 'targets' / toolchain / 'toolchain.cmake'}"]
    folder = build(package, *options)
    assert (folder / "libservogen_sample.a").is_file()
    flags = (folder / "build.ninja").read_text()
    assert {"-std=c99", "-ffp-contract=off"} <= set(flags.split())
