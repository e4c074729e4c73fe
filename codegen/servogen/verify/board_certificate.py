"""The certificate of a scene on a board: what its C costs there, and how far it errs.

Instructions are counted by the emulator (they are not cycles), worst and mean over the vectors; flash, stack and
symbols are read from the objects, compiled by the very command of the check. What was seen is held to what was proven:
the instructions to the longest path through the machine code (verify/bound.py), the stack, found by painting, to that
of the call graph.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from servogen.compiler import build
from servogen.package import Package
from servogen.plan.mathematics import Math
from servogen.scalars import Scalar
from servogen.scene.scene import Scene
from servogen.verify import objects
from servogen.verify.bound import BoundUnknownError, Machine, read_machine
from servogen.verify.harness import HarnessResult, default_states, fitting, run_harness
from servogen.verify.loops import LoopUnboundedError, loops_of
from servogen.verify.truth import Truth, states_to_check
from servogen.verify.vectors import VectorSet

STATES = 100
"""Drawn for a certificate, beside the boundary states; fewer where the board is small."""

RESOLUTION = 2
"""Instructions of one call that the counter may be off: two of its ticks over 100 calls."""


@dataclass(frozen=True)
class EntryCost:
    """One entry point. instructions: the worst call seen and the mean, at `vectors` states; bound: the most there can
    be, 0 where none is known. stack: bytes, by the call graph, with the chain that takes them; stack_seen: the most
    that any state took. operations: of the scene's own code, from the manifest. ulps: largest error
    over the domain in ulps of the outputs' scale. hash: of all statuses and answers."""

    name: str
    instructions: int
    instructions_mean: int
    bound: int
    worst_state: int
    vectors: int
    stack: int
    stack_seen: int
    stack_chain: tuple[str, ...]
    operations: dict[str, int]
    ulps: float
    hashes: tuple[str, ...]


@dataclass(frozen=True)
class BoardCertificate:
    """One package on one board. flash: bytes of code and constants of the package; library: of the compiler's
    arithmetic that it calls; ram: bytes of variables with static storage; state: bytes of the structs the caller
    keeps. problems: empty if everything was proven."""

    scene: str
    scalar: Scalar
    target: str
    prefix: str
    math: Math
    compiler: str
    flags: tuple[str, ...]
    flash: int
    library: int
    ram: int
    state: dict[str, int]
    functions: dict[str, int]
    needs: tuple[str, ...]
    entries: tuple[EntryCost, ...]
    problems: tuple[str, ...]

    @property
    def stack(self) -> int:
        """The deepest of all entry points, in bytes."""
        return max((e.stack for e in self.entries), default=0)


def certify(
    scene: Scene,
    targets: Sequence[str],
    scalars: tuple[Scalar, ...] = ("float64", "float32"),
    math: Math = "own",
    optimisation: str = "-O2",
) -> list[BoardCertificate]:
    """One certificate a board and scalar. Raises ToolMissing where a board has no compiler or emulator here."""
    with tempfile.TemporaryDirectory(prefix="servogen-certify-") as name:
        folder = Path(name)
        packages = [build(scene, folder / scalar, scalar, math=math) for scalar in scalars]
        paths = [p.path for p in packages]
        vectors: dict[int, dict[str, VectorSet]] = {}
        found = []
        for target in targets:
            states = min(STATES, default_states(target, STATES))
            if states not in vectors:
                vectors[states] = {p.prefix: _vectors(scene, p, states) for p in packages}
            work = folder / target
            options: dict[str, Any] = {"target": target, "measure": True, "optimisation": optimisation}
            given = {prefix: fitting(one, target) for prefix, one in vectors[states].items()}
            results = run_harness(paths, given, build_dir=work / "build", **options)
            found += [_certificate(scene, p, target, r, work) for p, r in zip(packages, results, strict=True)]
        return found


def _vectors(scene: Scene, package: Package, states: int) -> VectorSet:
    return Truth(scene, package.module, states_to_check(scene, states)[0], states).vector_set()


def _certificate(scene: Scene, package: Package, target: str, result: HarnessResult, folder: Path) -> BoardCertificate:
    module, prefix = package.module, package.prefix
    compiled = objects.compile_like(folder / "build", prefix, folder / "objects")
    nm, size, objdump = (objects.tool(t, compiled.program) for t in ("nm", "size", "objdump"))
    library = objects.library_graph(objdump, nm, result.image)
    compiled = replace(compiled, graph=objects.redirect(compiled.graph, library))
    needs = objects.undefined(nm, compiled.object)
    problems = list(result.problems) + objects.wrong_symbols(needs, module.target.scalar, module.target.math == "own")
    names = [e.name for e in _entries(result)]
    section = objects.sections(size, compiled.object)
    if section["data"] + section["bss"]:
        problems.append(f"{section['data'] + section['bss']} bytes of variables with static storage")
    costs = []
    machine, complaint = _machine(package, result, compiled)
    problems += complaint
    for name in names:
        entry, complaint = _entry(name, package, result, compiled, library, machine)
        costs.append(entry)
        problems += complaint
    reached = objects.reached([f"{prefix}_{n}" for n in names], compiled.graph, library)
    width = 8 if module.target.scalar == "float64" else 4
    structs = {"params": module.parameters, "model": module.model, "input": module.inputs}
    return BoardCertificate(
        scene=scene.name,
        scalar=module.target.scalar,
        target=target,
        prefix=prefix,
        math=module.target.math,
        compiler=compiled.compiler,
        flags=compiled.flags,
        flash=section["text"] + section["rodata"],
        library=objects.code_bytes(reached, library),
        ram=section["data"] + section["bss"],
        state={name: width * sum(f.size for f in fields) for name, fields in structs.items()},
        functions={n: s for n, (kind, s) in objects.sizes(nm, compiled.object).items() if kind in "tT"},
        needs=needs,
        entries=tuple(costs),
        problems=tuple(problems),
    )


def _machine(package: Package, result: HarnessResult, compiled: objects.Compiled) -> tuple[Machine | None, list[str]]:
    """The image's code with the limits of the package's loops, or why there is none."""
    solvers = package.module.solvers.values()
    most = max((min(s.m, s.l) for s in solvers), default=1)
    sizes = {"rank": most, "steps": most, "rows": max((s.m for s in solvers), default=1), "spanned": most}
    source = package.path / f"{package.prefix}.c"
    try:
        loops = loops_of(source.read_text(), sizes)
    except LoopUnboundedError as problem:
        return None, [f"{source.name}, {problem}"]
    objdump, nm, addr2line = (objects.tool(t, compiled.program) for t in ("objdump", "nm", "addr2line"))
    return read_machine(objdump, nm, result.image, addr2line, source, loops), []


@dataclass(frozen=True)
class _Named:
    name: str
    ulps: float
    hashes: tuple[str, ...]


def _entries(result: HarnessResult) -> list[_Named]:
    """The entry points of a run, in order, with their largest error and the hashes of their outputs."""
    names = list(dict.fromkeys(o.entry for o in result.outputs))
    return [
        _Named(
            name,
            max(o.max_ulps for o in result.outputs if o.entry == name),
            tuple(o.hash for o in result.outputs if o.entry == name),
        )
        for name in names
    ]


def _entry(
    name: str,
    package: Package,
    result: HarnessResult,
    compiled: objects.Compiled,
    library: dict[str, objects.Function],
    machine: Machine | None,
) -> tuple[EntryCost, list[str]]:
    """The costs of one entry point, and what could not be proven."""
    problems: list[str] = []
    measured = next(e for e in _entries(result) if e.name == name)
    cost = result.costs.get(name)
    symbol, bound = f"{package.prefix}_{name}", 0
    if cost is None:
        problems.append(f"{name}: its instructions were not counted on {result.target}")
    try:
        depth, chain = objects.stack(symbol, compiled.graph, library)
        if cost is not None and cost.stack > depth:
            problems.append(f"{name}: {cost.stack} bytes of stack were taken, {depth} were proven")
    except objects.StackUnknownError as problem:
        depth, chain = 0, ()
        problems.append(f"{name}: {problem}")
    try:
        bound = machine.turn(f"hv_repeat_{name}", symbol) if machine is not None else 0
        if machine is not None and cost is not None and cost.worst > bound + RESOLUTION:
            problems.append(f"{name}: {cost.worst} instructions were counted, {bound} were proven to be the most")
    except BoundUnknownError as problem:
        problems.append(f"{name}: no bound of its instructions: {problem}")
    operations = package.manifest["entry_points"].get(name, {}).get("operations", {})
    return EntryCost(
        name,
        cost.worst if cost else 0,
        cost.mean if cost else 0,
        bound,
        cost.vector if cost else 0,
        cost.vectors if cost else 0,
        depth,
        cost.stack if cost else 0,
        chain,
        operations,
        measured.ulps,
        measured.hashes,
    ), problems
