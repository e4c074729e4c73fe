"""What a board's own tools say of compiled code: symbols, sizes, and the stack by the call graph.

Frames of the package's functions are the compiler's (-fcallgraph-info=su). Library functions (soft floating point,
memcpy) come without; their frames are read from the image's disassembly, every push in a function counted.
"""

import json
import re
import shlex
import subprocess
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

FORBIDDEN = r"malloc|calloc|realloc|free|_sbrk|.*printf|puts|putchar|abort|exit|__assert_func"
DOUBLE = r"__aeabi_(d\w+|\w+2d|\w+2d_\w+)|__\w*df\w*|__(extendsfdf2|truncdfsf2)"
HELPERS = r"__aeabi_\w+|memcpy|memset|memmove|__gnu_thumb\w*|__clzsi2|__clzdi2"

_NODE = re.compile(r'node: \{ title: "(?P<title>[^"]*)" label: "(?P<label>[^"]*)"')
_EDGE = re.compile(r'edge: \{ sourcename: "(?P<source>[^"]*)" targetname: "(?P<target>[^"]*)"')
_FRAME = re.compile(r"(\d+) bytes \((static|dynamic|dynamic,bounded)\)")
_LABEL = re.compile(r"^([0-9a-f]+) <([^>]+)>:$")
_LINE = re.compile(r"^\s*[0-9a-f]+:\t((?:[0-9a-f]{4} ?)+)\s*\t(\S+)\s*(.*)$")
_JUMPS = {"b", "cbz", "cbnz"} | {f"b{c}" for c in "eq ne cs cc mi pl vs vc hi ls ge lt gt le".split()}
_ENDS = re.compile(r"^(b|b\.n|b\.w|bx|udf)$")


class StackUnknownError(RuntimeError):
    """The stack has no bound, or none can be told; the message names the function."""


@dataclass
class Function:
    """One function in the call graph: its own frame, its code where it was disassembled (bytes), what it calls."""

    frame: int
    code: int = 0
    calls: set[str] = field(default_factory=set)


@dataclass(frozen=True)
class Compiled:
    """A package's object: the file, its call graph, the compiler (program and version) and the flags it took."""

    object: Path
    graph: Mapping[str, Function]
    program: str
    compiler: str
    flags: tuple[str, ...]


def compile_like(build_dir: Path, prefix: str, out: Path) -> Compiled:
    """Compile <prefix>.c once more, by the very command of a harness build, with its call graph beside it."""
    commands = json.loads((build_dir / "compile_commands.json").read_text())
    entry = next(c for c in commands if Path(c["file"]).name == f"{prefix}.c")
    words = shlex.split(entry["command"])
    flags = [w for w in words[1 : words.index("-o")] if not w.startswith("-I")]
    out.mkdir(parents=True, exist_ok=True)
    target = out / f"{prefix}.o"
    run([words[0], *words[1 : words.index("-o")], "-fcallgraph-info=su", "-o", target, "-c", entry["file"]])
    graph = _read_graph(target.with_suffix(".ci").read_text())
    version = run([words[0], "--version"]).splitlines()[0]
    return Compiled(target, graph, words[0], version, tuple(flags))


def tool(name: str, compiler: Path | str) -> str:
    """A binary utility that belongs to a compiler: arm-none-eabi-gcc gives arm-none-eabi-nm."""
    return str(Path(compiler).with_name(Path(compiler).name.removesuffix("gcc") + name))


def run(command: Iterable[str | Path]) -> str:
    """Standard output of a command that must succeed. Raises RuntimeError with its complaints."""
    argv = [str(c) for c in command]
    done = subprocess.run(argv, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(argv)}: {done.stderr.strip()}")
    return done.stdout


def undefined(nm: str, file: Path) -> tuple[str, ...]:
    """The symbols that an object expects from elsewhere."""
    return tuple(sorted(line.split()[-1] for line in run([nm, "-u", file]).splitlines() if line.strip()))


def sizes(nm: str, file: Path) -> dict[str, tuple[str, int]]:
    """Symbol -> (nm's letter, bytes), of all symbols that have a size."""
    found = {}
    for line in run([nm, "-S", "--defined-only", file]).splitlines():
        words = line.split()
        if len(words) == 4:
            found[words[3]] = (words[2], int(words[1], 16))
    return found


def sections(size: str, file: Path) -> dict[str, int]:
    """Bytes of code, of constants, and of variables with and without a first value."""
    sums = {"text": 0, "rodata": 0, "data": 0, "bss": 0}
    for line in run([size, "-A", file]).splitlines():
        words = line.split()
        for name in sums:
            if len(words) == 3 and (words[0] == f".{name}" or words[0].startswith(f".{name}.")):
                sums[name] += int(words[1])
    return sums


def wrong_symbols(names: Iterable[str], scalar: str, own_math: bool = True) -> list[str]:
    """Of the symbols a package expects: those that it must not need, each with the reason."""
    wrong = []
    for name in names:
        if re.fullmatch(FORBIDDEN, name):
            wrong.append(f"{name}: no heap and no stdio in a controller")
        elif scalar == "float32" and re.fullmatch(DOUBLE, name):
            wrong.append(f"{name}: float64 arithmetic in a float32 package")
        elif own_math and not re.fullmatch(HELPERS, name) and not re.fullmatch(DOUBLE, name):
            wrong.append(f"{name}: neither the package's own nor the compiler's arithmetic")
    return wrong


def library_graph(objdump: str, nm: str, image: Path) -> dict[str, Function]:
    """The call graph of everything in an image, by every name a function has.

    Functions that jump into one another without a link share a frame, the sum of theirs.
    """
    names: dict[int, list[str]] = {}
    for line in run([nm, "--defined-only", image]).splitlines():
        address, kind, name = line.split()[:3]
        if kind in "tTwW" and not name.startswith("$"):
            names.setdefault(int(address, 16), []).append(name)
    functions: dict[str, Function] = {}
    joined: list[tuple[str, str]] = []
    current, open_end = "", False
    for line in run([objdump, "-d", image]).splitlines():
        if label := _LABEL.match(line):
            if open_end:
                joined.append((label[2], current))
            current = label[2]
            functions[current] = Function(0)
            for alias in names.get(int(label[1], 16), []):
                joined.append((alias, current))
            open_end = False
        elif current and (found := _LINE.match(line)):
            mnemonic, operands = found[2], found[3]
            functions[current].code += 2 * len(found[1].split())
            if mnemonic.startswith(".") or mnemonic in ("nop", "nop.w") or found[1].strip() == "0000":
                continue  # the last is a linker's padding, which reads as an instruction
            functions[current].frame += _pushed(mnemonic, operands)
            _follow(functions[current], current, mnemonic, operands, joined)
            open_end = not (_ENDS.match(mnemonic) or ("pc" in operands and mnemonic.startswith(("pop", "ldm", "ldr"))))
    return _merge(functions, joined)


def redirect(package: Mapping[str, Function], library: Mapping[str, Function]) -> dict[str, Function]:
    """The package's call graph as the image was linked: with --wrap=f, its calls of f go to __wrap_f."""

    def linked(name: str) -> str:
        return f"__wrap_{name}" if f"__wrap_{name}" in library else name

    return {n: Function(f.frame, f.code, {linked(c) for c in f.calls}) for n, f in package.items()}


def stack(entry: str, package: Mapping[str, Function], library: Mapping[str, Function]) -> tuple[int, tuple[str, ...]]:
    """The deepest stack under `entry`, in bytes, and the chain of calls that takes it.

    Raises StackUnknownError for recursion, frames without a bound and calls through pointers.
    """
    known: dict[str, tuple[int, tuple[str, ...]]] = {}
    path: list[str] = []

    def deepest(name: str) -> tuple[int, tuple[str, ...]]:
        if name in path:
            raise StackUnknownError(f"recursion: {' -> '.join([*path[path.index(name) :], name])}")
        if name not in known:
            function = package.get(name) or library.get(name)
            if function is None:
                raise StackUnknownError(f"{name}, called by {path[-1] if path else 'nobody'}: its frame is not known")
            if function.frame < 0:
                raise StackUnknownError(f"{name}: its frame has no bound")
            if name not in package and not function.code:
                raise StackUnknownError(f"{name}: it was not disassembled")
            path.append(name)
            below = max((deepest(callee) for callee in sorted(function.calls)), default=(0, ()))
            path.pop()
            known[name] = (function.frame + below[0], (name, *below[1]))
        return known[name]

    return deepest(entry)


def reached(entries: Iterable[str], package: Mapping[str, Function], library: Mapping[str, Function]) -> set[str]:
    """The library functions that the entries call, directly or not."""
    found: set[str] = set()
    todo = list(entries)
    while todo:
        name = todo.pop()
        function = package.get(name) or library.get(name)
        for callee in function.calls if function else ():
            if callee not in found:
                found.add(callee)
                todo.append(callee)
    return {name for name in found if name not in package}


def code_bytes(names: Iterable[str], library: Mapping[str, Function]) -> int:
    """The code of library functions; what has several names counts once."""
    return sum({id(library[n]): library[n].code for n in names if n in library}.values())


def _read_graph(text: str) -> dict[str, Function]:
    """The compiler's call graph; a frame without a bound is -1."""
    graph: dict[str, Function] = {}
    for found in _NODE.finditer(text):
        frame = _FRAME.search(found["label"])
        if frame:
            graph[_name(found["title"])] = Function(-1 if frame[2] == "dynamic" else int(frame[1]))
    for found in _EDGE.finditer(text):
        graph[_name(found["source"])].calls.add(_name(found["target"]))
    return graph


def _name(title: str) -> str:
    """A static function's title has its file in front."""
    return title.rsplit(":", 1)[-1]


def _pushed(mnemonic: str, operands: str) -> int:
    """Bytes that one instruction takes from the stack."""
    base = mnemonic.split(".")[0]
    if base in ("push", "vpush") or (base in ("stmdb", "stmfd") and operands.startswith("sp!")):
        registers = operands[operands.index("{") + 1 : operands.index("}")]
        width = 8 if re.match(r"d\d", registers.strip()) else 4
        return width * sum(_registers(part.strip()) for part in registers.split(","))
    if base in ("sub", "subw") and re.match(r"sp, (sp, )?#", operands):
        return int(re.search(r"#(\d+)", operands)[1])  # type: ignore[index]
    if base in ("str", "strd") and (found := re.search(r"\[sp, #-(\d+)\]!", operands)):
        return int(found[1])
    return 0


def _registers(part: str) -> int:
    numbers = [int(n) for n in re.findall(r"\d+", part)]
    return numbers[1] - numbers[0] + 1 if "-" in part else 1


def _follow(function: Function, name: str, mnemonic: str, operands: str, joined: list[tuple[str, str]]) -> None:
    """Note where a call or a jump goes."""
    target = re.search(r"<([^>+]+)(\+0x[0-9a-f]+)?>", operands)
    base = mnemonic.split(".")[0]
    if base in ("bl", "blx") and not target:
        function.calls.add("a call through a pointer")
    elif base in ("bl", "blx") and target:
        function.calls.add(target[1])
    elif target and target[1] != name and base in _JUMPS:
        joined.append((name, target[1]))


def _merge(functions: Mapping[str, Function], joined: Iterable[tuple[str, str]]) -> dict[str, Function]:
    """Names joined by jumps become one function; each of its names finds it."""
    joined = list(joined)
    group = {name: name for name in [*functions, *(n for pair in joined for n in pair)]}

    def head(name: str) -> str:
        while group[name] != name:
            name = group[name]
        return name

    for a, b in joined:
        group[head(a)] = head(b)
    merged: dict[str, Function] = {}
    for name, function in functions.items():
        whole = merged.setdefault(head(name), Function(0))
        whole.frame += function.frame
        whole.code += function.code
        whole.calls |= {head(c) if c in group else c for c in function.calls}
    return {name: merged[head(name)] for name in group if head(name) in merged}
