"""One executable of all C contenders: compiled with the flags asked for, run for values, times or one profiled call.

Files are flat float64 in the machine's order. States: the parameters, then a row a state. Values: a task (contender
and output) after the other, its outputs state by state and then its statuses. Times: ns per call, (tasks, batches).
"""

import resource
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from servogen.bench.contenders import CContender
from servogen.bench.inputs import Inputs
from servogen.bench.results import Built, Output
from servogen.render.render import environment
from servogen.results import FloatArray
from servogen.tools import c_compiler, compile_c


@dataclass(frozen=True)
class Task:
    """One contender's output, and the number of its entries."""

    contender: CContender
    output: Output
    size: int


@dataclass(frozen=True, eq=False)
class Driver:
    """The executable, and its tasks in its order."""

    executable: Path
    folder: Path
    tasks: tuple[Task, ...]

    def values(self, inputs: Inputs) -> list[tuple[FloatArray, FloatArray]]:
        """Per task: outputs (N, size), NaN where untouched, and statuses (N,)."""
        flat = self._run("values", inputs)
        answers, start, n = [], 0, inputs.count
        for task in self.tasks:
            middle, end = start + n * task.size, start + n * (task.size + 1)
            answers.append((flat[start:middle].reshape(n, task.size), flat[middle:end]))
            start = end
        return answers

    def times(self, inputs: Inputs, batch: int, batches: int, start: int) -> FloatArray:
        """Nanoseconds per call, (tasks, batches), each batch `batch` calls; task `start` is the first."""
        return self._run("time", inputs, str(batch), str(batches), str(start)).reshape(len(self.tasks), batches)

    def command_once(self, inputs: Inputs, task: int) -> list[str]:
        """The command that runs one task over all states once, for a profiler."""
        return [str(self.executable), "one", str(self._states(inputs)), str(task)]

    def _states(self, inputs: Inputs) -> Path:
        path = self.folder / "states.bin"
        np.concatenate([inputs.parameters, inputs.states.ravel()]).tofile(path)
        return path

    def _run(self, mode: str, inputs: Inputs, *more: str) -> FloatArray:
        result = self.folder / "result.bin"
        argv = [str(self.executable), mode, str(self._states(inputs)), str(result), *more]
        run = subprocess.run(argv, capture_output=True, text=True)
        if run.returncode != 0:
            raise RuntimeError(f"the bench driver failed ({run.returncode}): {run.stderr}")
        return np.fromfile(result)


def compiler_version(compiler: str) -> str:
    """The first line of `compiler --version`. ToolMissing where there is no such compiler."""
    run = subprocess.run([*c_compiler(compiler), "--version"], capture_output=True, text=True)
    return run.stdout.splitlines()[0] if run.stdout else compiler


def compile_driver(
    contenders: Sequence[CContender],
    sizes: dict[Output, int],
    inputs: Inputs,
    capacity: int,
    folder: Path,
    compiler: str,
    flags: Sequence[str],
) -> Driver:
    """Write and compile everything in `folder`. CompilerUnusable or CompilerRefused where that fails."""
    tasks = tuple(Task(c, output, sizes[output]) for c in contenders for output in c.calls)
    sources = _write(contenders, tasks, sizes, inputs, capacity, folder)
    executable = folder / "bench"
    libraries = [word for c in contenders for word in c.libraries]
    more = [f"-I{folder}", *map(str, sources), "-o", str(executable), *libraries, "-lm"]
    compile_c(c_compiler(compiler), flags, more, "the bench driver")
    return Driver(executable, folder, tasks)


def built(contender: CContender, folder: Path, compiler: str, flags: Sequence[str]) -> Built:
    """A contender's own files compiled by themselves, in the folder where compile_driver has left them."""
    seconds, objects = 0.0, [Path(word) for word in contender.libraries if word.endswith(".o")]
    for file in (f.name for f in contender.files if f.name.endswith(".c")):
        target = folder / f"{file}.o"
        start = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
        argv = [*c_compiler(compiler), *flags, f"-I{folder}", "-c", str(folder / file), "-o", str(target)]
        subprocess.run(argv, check=True, capture_output=True)
        seconds += resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - start
        objects.append(target)
    text = 0
    for compiled in objects:
        sizes = subprocess.run(["size", str(compiled)], check=True, capture_output=True, text=True)
        text += int(sizes.stdout.splitlines()[1].split()[0])
    return Built(contender.name, seconds, text, contender.operations)


def _write(
    contenders: Sequence[CContender],
    tasks: Sequence[Task],
    sizes: dict[Output, int],
    inputs: Inputs,
    capacity: int,
    folder: Path,
) -> list[Path]:
    """All files; returned are the C sources."""
    templates = environment("bench")
    texts = {f.name: f.text for c in contenders for f in c.files}
    for c in contenders:
        loop = templates.get_template("loop.c.j2").render(
            name=c.name,
            id=c.identifier,
            real=c.real,
            declarations=c.declarations,
            calls=c.calls,
            sizes=sizes,
            capacity=capacity,
        )
        texts[f"loop_{c.identifier}.c"] = loop
    texts["driver.c"] = templates.get_template("driver.c.j2").render(
        parameters=len(inputs.parameters),
        width=inputs.states.shape[1],
        capacity=capacity,
        largest=max(sizes.values()),
        tasks=[(t.contender.identifier, t.output.value, t.size) for t in tasks],
    )
    for name, text in texts.items():
        (folder / name).write_text(text)
    return [folder / name for name in texts if name.endswith(".c")]
