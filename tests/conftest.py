"""Shared by all tests: what to do where a tool is not installed."""

import importlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest
from servogen.tools import ToolMissing, find_library, find_tool
from servogen.verify.harness import require_target
from support.missing import skip_or_fail


@pytest.fixture(scope="session")
def need_tool() -> Callable[[str, str], Path]:
    """need_tool("valgrind", "valgrind"): its path, or the test is skipped with the command that installs it."""

    def need(name: str, debian_package: str) -> Path:
        try:
            return find_tool(name, debian_package)
        except ToolMissing as missing:
            skip_or_fail(missing)

    return need


@pytest.fixture(scope="session")
def need_library() -> Callable[[str, str, str], Path]:
    """need_library("clang", "libm.a", "libc6-dev"): its path, as that compiler would link it."""

    def need(compiler: str, file: str, debian_package: str) -> Path:
        try:
            return find_library(find_tool(compiler, compiler), file, debian_package)
        except ToolMissing as missing:
            skip_or_fail(missing)

    return need


@pytest.fixture(scope="session")
def need_target() -> Callable[..., None]:
    """need_target("cortex-m4") or need_target("host", "clang"): skips where a tool it takes is missing."""

    def need(target: str = "host", compiler: str = "gcc") -> None:
        try:
            require_target(target, compiler)
        except ToolMissing as missing:
            skip_or_fail(missing)

    return need


@pytest.fixture(scope="session")
def need_module() -> Callable[[str, str], ModuleType]:
    """need_module("pinocchio", "pin"): the module, or the test is skipped with the command that installs it."""

    def need(name: str, package: str) -> ModuleType:
        try:
            return importlib.import_module(name)
        except ImportError:
            skip_or_fail(f"{name} is not installed: pip install {package}")

    return need
