"""The most instructions a function can take on a board: the longest path through its machine code, loops at limits.

The linked image is disassembled, and of each function the graph of its jumps is made. A loop in it counts once for each
turn that its loop in the source can make: which loop that is the compiler's line table tells, inlined functions
included, and how often that may turn verify/loops.py reads from the source. Where several come into question the
largest limit counts. The compiler may drop turns (unrolled, vectorised, peeled), never add any. In its own arithmetic,
for which there is no source, a loop turns once a bit: at most 64 times. Conditional instructions count as executed.

A bound is refused (BoundUnknownError) for recursion, for calls and jumps through registers, and for loops of unknown
limit.
"""

import re
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from servogen.verify.loops import Loop
from servogen.verify.objects import run

LIBRARY_TURNS = 64
"""Of a loop in the compiler's arithmetic, which treats words of at most 64 bits, one at a time."""

_LABEL = re.compile(r"^([0-9a-f]+) <([^>]+)>:$")
_LINE = re.compile(r"^\s*([0-9a-f]+):\t([0-9a-f ]+)\t(\S+)\s*(.*)$")
_CONDITIONS = "eq ne cs hs cc lo mi pl vs vc hi ls ge lt gt le".split()
_TARGET = re.compile(r"([0-9a-f]+) <")


class BoundUnknownError(RuntimeError):
    """The instructions have no bound, or none can be told; the message names the function and the reason."""


@dataclass(frozen=True)
class Step:
    """One instruction: where control may go next, and the function it calls on the way."""

    following: tuple[int, ...]
    calls: int | None = None
    computed: bool = False  # it jumps or calls through a register


@dataclass(eq=False)
class Machine:
    """An image's code. steps: by address; names: address -> function; addresses: the reverse, every alias."""

    steps: dict[int, Step]
    names: dict[int, str]
    addresses: dict[str, int]
    sources: "Sources"
    known: dict[int, int] = field(default_factory=dict)

    def bound(self, function: str) -> int:
        """The most instructions from the first of `function` to its return, callees included."""
        if function not in self.addresses:
            raise BoundUnknownError(f"{function} is not in the image")
        return self._bound(self.addresses[function], ())

    def turn(self, function: str, callee: str) -> int:
        """The same of one turn of the loop in `function` that calls `callee`, in which there is nothing else."""
        start = self.addresses[function]
        graph = self._graph(start, (), strict=False)
        for part in _components(graph.nodes, graph, ()):
            if any(self.steps[n].calls == self.addresses[callee] for n in part):
                heads = {n for n in part if n == start or any(n in graph.edges[m] for m in graph.nodes - part)}
                far = _distances(part, heads, graph, self, ())
                return max(far[n] for n in part if heads & set(graph.edges[n]))
        raise BoundUnknownError(f"{function}: {callee} is not called in a loop")

    def _bound(self, start: int, path: tuple[int, ...]) -> int:
        if start in path:
            raise BoundUnknownError(f"recursion: {self._name(start)}")
        if start not in self.known:
            graph = self._graph(start, (*path, start))
            self.known[start] = max(_distances(graph.nodes, {start}, graph, self, ()).values())
        return self.known[start]

    def _graph(self, start: int, path: tuple[int, ...], strict: bool = True) -> "_Graph":
        """Everything reached from `start` by steps and jumps, and what each instruction costs.

        Where not strict, calls through registers cost one instruction: the harness calls its probes so."""
        nodes: set[int] = set()
        todo = [start]
        while todo:
            at = todo.pop()
            if at in nodes:
                continue
            if at not in self.steps:
                raise BoundUnknownError(f"{self._name(start)}: it runs into data at {at:#x}")
            if self.steps[at].computed and (strict or not self.steps[at].following):
                raise BoundUnknownError(f"{self._name(start)}: a jump or call through a register at {at:#x}")
            nodes.add(at)
            todo += self.steps[at].following
        edges = {n: tuple(m for m in self.steps[n].following if m in nodes) for n in nodes}
        costs = dict.fromkeys(nodes, 1)
        for n in nodes:
            if (callee := self.steps[n].calls) is not None:
                costs[n] += self._bound(callee, path)
        return _Graph(nodes, edges, costs)

    def _name(self, address: int) -> str:
        return self.names.get(address, f"{address:#x}")


@dataclass(frozen=True, eq=False)
class _Graph:
    nodes: set[int]
    edges: Mapping[int, tuple[int, ...]]
    costs: Mapping[int, int]


@dataclass(eq=False)
class Sources:
    """Where instructions come from: address -> the source's loops around it, outermost first, across inlined calls.

    heads: addresses on the first line of their innermost loop, where it also starts: once for a turn of the one around.
    """

    loops: dict[int, tuple[Loop, ...]]
    heads: set[int]

    def turns(self, part: set[int], around: Iterable[Loop], inner: set[int]) -> int | None:
        """The limit of a loop of machine code, None where it is the library's. around: loops known to be outside;
        inner: instructions that belong to loops within."""
        within = {self.loops[n][-1] for n in inner - self.heads if self.loops.get(n)}
        known = [self._stack(n, within) for n in part - inner if n in self.loops]
        if not known:
            known = [self.loops[n] for n in part if n in self.loops]
        if not known:
            return None
        named = {loop for stack in known for loop in stack}
        return max((loop.turns for loop in named - set(around) or named), default=0)

    def _stack(self, address: int, within: set[Loop]) -> tuple[Loop, ...]:
        """The loops around an instruction, without that of a loop within which it may only start."""
        stack = self.loops[address]
        return stack[:-1] if address in self.heads and stack[-1] in within else stack


def read_machine(objdump: str, nm: str, image: Path, addr2line: str, source: Path, loops: Iterable[Loop]) -> Machine:
    """The code of an image linked with -g, and the loops of the package's one source file in it."""
    lines = [found for line in run([objdump, "-d", image]).splitlines() if (found := _LINE.match(line))]
    words = _words(run([objdump, "-s", "-j", ".text", image]))
    code = [f for f in lines if not f[3].startswith(".")]
    steps: dict[int, Step] = {}
    for k, f in enumerate(code):
        step = _step(int(f[1], 16), len(f[2].replace(" ", "")) // 2, f[3], f[4])
        steps[int(f[1], 16)] = _table(code[max(0, k - 8) : k], f[4], words) or step if step.computed else step
    names: dict[int, str] = {}
    addresses: dict[str, int] = {}
    for line in run([nm, "--defined-only", image]).splitlines():
        value, kind, name = line.split()[:3]
        if kind in "tTwW" and not name.startswith("$"):
            addresses[name] = int(value, 16) & ~1
            names.setdefault(int(value, 16) & ~1, name)
    function = dict(_within(sorted(steps), names))
    for at, step in steps.items():
        if step.calls is not None and step.calls not in names and function.get(step.calls) == function[at]:
            steps[at] = Step((step.calls,))  # v6-M has no other jump as far as that
    own = [a for a, name in function.items() if name.startswith(source.stem)]
    sources = _read_sources(addr2line, image, own, source, tuple(loops))
    return Machine(steps, names, addresses, sources)


def _within(addresses: Iterable[int], names: Mapping[int, str]) -> Iterator[tuple[int, str]]:
    """Each address with the function it is in."""
    name = ""
    for address in addresses:
        name = names.get(address, name)
        yield address, name


def _step(address: int, size: int, mnemonic: str, operands: str) -> Step:
    """What an instruction does to the flow of control."""
    follows = (address + size,)
    base, _, _ = mnemonic.partition(".")
    target = int(m[1], 16) if (m := _TARGET.search(operands)) else None
    if base in ("cbz", "cbnz"):
        return Step((*follows, int(target or 0)))
    for name in ("blx", "bx", "bl", "b"):
        condition = base.removeprefix(name)
        if base.startswith(name) and (not condition or condition in _CONDITIONS):
            if name in ("bl", "blx"):
                return Step(follows, target, computed=target is None)
            back = follows if condition else ()
            if name == "bx":  # the return; libgcc on v6-M returns through any register
                return Step(back)
            return Step((*back, int(target or 0)))
    if base in ("udf", "bkpt"):
        return Step(())
    writes_pc = re.match(r"(?:pop|ldm)", base) and re.search(r"\bpc\b", operands)
    if writes_pc or (base.startswith("ldr") and operands.startswith("pc, [sp]")) or operands == "pc, lr":
        return Step(follows if base[-2:] in _CONDITIONS else ())
    if base in ("tbb", "tbh") or re.match(r"pc\b", operands):
        return Step((), computed=True)
    return Step(follows)


def _words(dump: str) -> dict[int, int]:
    """The words of a section by address, from objdump's hexadecimal dump of it."""
    found = {}
    for line in dump.splitlines():
        if m := re.match(r"^ ([0-9a-f]+) ((?:[0-9a-f]{8} )+)", line):
            for k, word in enumerate(m[2].split()):
                found[int(m[1], 16) + 4 * k] = int.from_bytes(bytes.fromhex(word), "little")
    return found


def _table(before: list[re.Match[str]], operands: str, words: Mapping[int, int]) -> Step | None:
    """Where `mov pc, rN` goes that takes its address from a table; the code before it names table and last index."""
    text = "\n".join(f"{f[3]} {f[4]}" for f in before)
    register = re.match(r"pc, (r\d+)$", operands)
    table = register and re.search(rf"ldr {register[1]}, \[(r\d+), r\d+\]$", text)
    base = table and re.search(rf"ldr {table[1]}, \[pc, #\d+\]\s*@ \(([0-9a-f]+)", text)
    last = re.search(r"cmp r\d+, #(\d+)\nb(?:hi|ls)", text)
    if not base or not last:
        return None
    first = words.get(int(base[1], 16), -1)
    entries = [words.get(first + 4 * k) for k in range(int(last[1]) + 1)]
    return None if None in entries else Step(tuple(sorted({e & ~1 for e in entries if e is not None})))


def _read_sources(addr2line: str, image: Path, addresses: list[int], source: Path, loops: tuple[Loop, ...]) -> Sources:
    """By addr2line, which prints for each address the innermost line first and then those it was inlined into."""
    asked = "\n".join(f"{a:#x}" for a in addresses)
    done = subprocess.run(
        [addr2line, "-a", "-i", "-e", str(image)], input=asked, capture_output=True, text=True, check=True
    )
    around: dict[int, tuple[Loop, ...]] = {}

    def enclosing(line: int) -> tuple[Loop, ...]:
        if line not in around:
            around[line] = tuple(loop for loop in loops if loop.first <= line <= loop.last)
        return around[line]

    found: dict[int, tuple[Loop, ...]] = {}
    heads: set[int] = set()
    address = 0
    for text in done.stdout.splitlines():
        if text.startswith("0x"):
            address = int(text, 16)
            continue
        file, _, number = text.split(" (")[0].rpartition(":")
        if Path(file).name == source.name and number.isdigit():
            stack = enclosing(int(number))
            if address not in found and stack and stack[-1].first == int(number):
                heads.add(address)
            found[address] = (*stack, *found.get(address, ()))
    return Sources(found, heads)


def _distances(
    nodes: set[int], heads: set[int], graph: _Graph, machine: Machine, around: tuple[Loop, ...]
) -> dict[int, int]:
    """For each node the longest way to it, itself included, from the heads, to which no way leads back."""
    distance: dict[int, int] = {}
    arrives = dict.fromkeys(heads, 0)
    for part in _components(nodes, graph, heads):
        entries = {n for n in part if n in arrives}
        if not entries:
            continue
        start = max(arrives[n] for n in entries)
        one = next(iter(part))
        if len(part) == 1 and (one not in graph.edges[one] or one in heads):
            distance[one] = start + graph.costs[one]
        else:
            within = _loop(part, entries, graph, machine, around)
            distance |= {n: start + d for n, d in within.items()}
        for n in part:
            for m in graph.edges[n]:
                if m in nodes and m not in part and m not in heads:
                    arrives[m] = max(arrives.get(m, 0), distance[n])
    return distance


def _loop(
    part: set[int], entries: set[int], graph: _Graph, machine: Machine, around: tuple[Loop, ...]
) -> dict[int, int]:
    """A loop as a whole: all turns, then the way to each of its nodes. Several entries count as so many loops."""
    inner = set().union(*(p for p in _components(part, graph, entries) if len(p) > 1))
    known = [machine.sources.loops[n] for n in part if n in machine.sources.loops]
    common = set(known[0]).intersection(*known) if known else set()
    turns = machine.sources.turns(part, around, inner)
    limit = (LIBRARY_TURNS if turns is None else turns) * len(entries)
    if turns == 0:
        raise BoundUnknownError(f"a loop at {min(part):#x} is none of the source's")
    within = _distances(part, entries, graph, machine, tuple({*around, *common}))
    cycle = max(within[n] for n in part if n in within and entries & set(graph.edges[n]))
    return {n: limit * cycle + d for n, d in within.items()}


def _components(nodes: set[int], graph: _Graph, heads: Iterable[int]) -> list[set[int]]:
    """Strongly connected parts in topological order, ways back into the heads left out (Tarjan 1972)."""
    closed = set(heads)
    index: dict[int, int] = {}
    low: dict[int, int] = {}
    stack: list[int] = []
    on_stack: set[int] = set()
    parts: list[set[int]] = []

    def targets(n: int) -> list[int]:
        return [m for m in graph.edges[n] if m in nodes and m not in closed]

    for root in sorted(nodes):
        if root in index:
            continue
        work = [(root, iter(targets(root)))]
        index[root] = low[root] = len(index)
        stack.append(root)
        on_stack.add(root)
        while work:
            n, rest = work[-1]
            for m in rest:
                if m not in index:
                    index[m] = low[m] = len(index)
                    stack.append(m)
                    on_stack.add(m)
                    work.append((m, iter(targets(m))))
                    break
                if m in on_stack:
                    low[n] = min(low[n], index[m])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[n])
                if low[n] == index[n]:
                    part = set()
                    while n not in part:
                        part.add(stack.pop())
                    on_stack -= part
                    parts.append(part)
    return parts[::-1]
