"""Shared by all tests: what to do where a tool is not installed."""

import hashlib
import importlib
import os
import pickle
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the cores are taken; a 3 x 3 expm in two threads takes 2 ms

import numpy as np
import pytest
from servogen import scene_program
from servogen.optimise.search import Optimised
from servogen.tools import CompilerRefused, CompilerUnusable, ToolMissing, compile_c, find_library, find_tool
from servogen.twins import compiled
from servogen.verify import harness
from servogen.verify.harness import require_target
from support.missing import skip_or_fail


@pytest.fixture(scope="session", autouse=True)
def one_search_a_program(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Equal scenes are optimised once in a run, whichever test and process has the first; the next run starts anew.

    Tests of the search itself call it directly.
    """
    folder = _shared_folder(tmp_path_factory, "searches")
    search = scene_program.search

    def search_once(program, states, minor, without) -> Optimised:
        said = str(program), {n: np.asarray(v).tolist() for n, v in states.items()}, sorted(minor), sorted(without)
        file = folder / hashlib.sha256(repr(said).encode()).hexdigest()
        if not file.exists():
            _keep(file, pickle.dumps(search(program, states, minor, without)))
        return pickle.loads(file.read_bytes())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene_program, "search", search_once)
        yield


@pytest.fixture(scope="session", autouse=True)
def harnesses_are_compiled_sooner() -> Iterator[None]:
    """With -O1 where a test asks for no level: the same bits and answers. Certificates and hashes ask for theirs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(harness.run_harness.__kwdefaults__, "optimisation", "-O1")
        yield


@pytest.fixture(scope="session", autouse=True)
def one_compilation_a_source(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Equal C of twins and loops is compiled once in a run, and with -O1 in place of -O2: the same bits, sooner.

    That all levels give the same bits is what verify/test_bits.py shows; who tests a level, harnesses and benchmarks
    call the compiler directly.
    """
    folder = _shared_folder(tmp_path_factory, "compiled")

    def compile_once(command: Sequence[str], flags: Sequence[str], more: Sequence[str], what: str) -> None:
        words = [*flags, *more]
        sources = [Path(word) for word in words if word.endswith(".c")]
        folders = [Path(word[2:]) for word in words if word.startswith("-I")] + [file.parent for file in sources]
        headers = [file for where in dict.fromkeys(folders) for file in sorted(where.glob("*.h"))]
        texts = [file.read_bytes() for file in (*sources, *headers)]
        said = command, [w for w in words if not w.startswith(("-I", "/"))], [hashlib.sha256(t).digest() for t in texts]
        file, library = folder / hashlib.sha256(repr(said).encode()).hexdigest(), Path(more[more.index("-o") + 1])
        if file.exists():
            library.write_bytes(file.read_bytes())
            return
        try:
            compile_c(command, ["-O1" if word == "-O2" else word for word in flags], more, what)
        except (CompilerRefused, CompilerUnusable):
            compile_c(command, flags, more, what)  # it is this one's words that a user reads
        _keep(file, library.read_bytes())

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "compile_c", compile_once)
        yield


def _shared_folder(tmp_path_factory: pytest.TempPathFactory, name: str) -> Path:
    """A folder that all processes of a run have together."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / name  # beside the workers
    folder.mkdir(exist_ok=True)
    return folder


def _keep(file: Path, content: bytes) -> None:
    """Write a file that other processes see whole or not at all."""
    partial = file.with_suffix(f".{os.getpid()}")
    partial.write_bytes(content)
    partial.replace(file)


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
