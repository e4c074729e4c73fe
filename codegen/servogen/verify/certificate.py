"""The certificate of a scene on a board: what its C costs there, and how far it errs.

Instructions are counted by the emulator (they are not cycles), worst and mean over the vectors; flash, stack and
symbols are read from the objects, compiled by the very command of the check.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path

from servogen.compiler import build
from servogen.package import Package
from servogen.plan.mathematics import Math
from servogen.scalars import Scalar
from servogen.scene.scene import Scene
from servogen.verify import objects
from servogen.verify.harness import HarnessResult, default_states, run_harness
from servogen.verify.truth import Truth, states_to_check

STATES = 100
"""Drawn for a certificate, beside the boundary states; fewer where the board is small."""


@dataclass(frozen=True)
class EntryCost:
    """One entry point. instructions: the worst call seen and the mean, at `vectors` states. stack: bytes, by the call
    graph, with the chain that takes them. operations: of the scene's own code, from the manifest. ulps: largest error
    over the domain in ulps of the outputs' scale. hash: of all statuses and answers."""

    name: str
    instructions: int
    instructions_mean: int
    worst_state: int
    vectors: int
    stack: int
    stack_chain: tuple[str, ...]
    operations: dict[str, int]
    ulps: float
    hashes: tuple[str, ...]


@dataclass(frozen=True)
class Certificate:
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
    scene: Scene, target: str, scalars: tuple[Scalar, ...] = ("float64", "float32"), math: Math = "own"
) -> list[Certificate]:
    """One certificate a scalar. Raises ToolMissing where the board has no compiler or emulator here."""
    states = min(STATES, default_states(target, STATES))
    with tempfile.TemporaryDirectory(prefix="servogen-certify-") as name:
        folder = Path(name)
        packages = [build(scene, folder / scalar, scalar, math=math) for scalar in scalars]
        truths = [Truth(scene, p.module, states_to_check(scene, states)[0], states) for p in packages]
        vectors = {p.prefix: t.vector_set() for p, t in zip(packages, truths, strict=True)}
        paths = [p.path for p in packages]
        results = run_harness(paths, vectors, target=target, build_dir=folder / "build", measure=True)
        return [_certificate(scene, p, target, r, folder) for p, r in zip(packages, results, strict=True)]


def _certificate(scene: Scene, package: Package, target: str, result: HarnessResult, folder: Path) -> Certificate:
    module, prefix = package.module, package.prefix
    compiled = objects.compile_like(folder / "build", prefix, folder / "objects")
    nm, size, objdump = (objects.tool(t, compiled.program) for t in ("nm", "size", "objdump"))
    library = objects.library_graph(objdump, nm, result.image)
    needs = objects.undefined(nm, compiled.object)
    problems = list(result.problems) + objects.wrong_symbols(needs, module.target.scalar, module.target.math == "own")
    names = [e.name for e in _entries(result)]
    section = objects.sections(size, compiled.object)
    if section["data"] + section["bss"]:
        problems.append(f"{section['data'] + section['bss']} bytes of variables with static storage")
    costs = []
    for name in names:
        entry, complaint = _entry(name, package, result, compiled, library)
        costs.append(entry)
        problems += complaint
    reached = objects.reached([f"{prefix}_{n}" for n in names], compiled.graph, library)
    width = 8 if module.target.scalar == "float64" else 4
    structs = {"params": module.parameters, "model": module.model, "input": module.inputs}
    return Certificate(
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
    name: str, package: Package, result: HarnessResult, compiled: objects.Compiled, library: dict[str, objects.Function]
) -> tuple[EntryCost, list[str]]:
    """The costs of one entry point, and what could not be proven."""
    problems: list[str] = []
    measured = next(e for e in _entries(result) if e.name == name)
    cost = result.costs.get(name)
    if cost is None:
        problems.append(f"{name}: its instructions were not counted on {result.target}")
    try:
        depth, chain = objects.stack(f"{package.prefix}_{name}", compiled.graph, library)
    except objects.StackUnknownError as problem:
        depth, chain = 0, ()
        problems.append(f"{name}: {problem}")
    operations = package.manifest["entry_points"].get(name, {}).get("operations", {})
    return EntryCost(
        name,
        cost.worst if cost else 0,
        cost.mean if cost else 0,
        cost.vector if cost else 0,
        cost.vectors if cost else 0,
        depth,
        chain,
        operations,
        measured.ulps,
        measured.hashes,
    ), problems
