"""Back to back: states made on the target by the thousand, and one hash of all answers, which every target must reach.

There is no truth here, and no vector is stored: firmware_sim/harness/campaign.c makes the states of integers, the same
on every target, and hashes statuses, answers and infos. What is right was shown by the vectors; here it is shown that
the boards give it, bit for bit, at states in and out of the domain, singular and boundary ones among them.
"""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from servogen.package import Package
from servogen.render.render import environment
from servogen.results import FloatArray, Status
from servogen.scalars import Scalar
from servogen.scene.domain import boundary_states, draw_states
from servogen.scene.scene import Scene
from servogen.scene.system import PASSIVE
from servogen.verify.harness import build_images, complaint_of, execute, require_target, words_of, write_if_changed
from servogen.verify.truth import STEP_DT
from servogen.verify.vectors import literal

VECTORS = 10_000
DRAWN = 16
"""States of the domain in the table that a campaign starts from, beside the boundary states."""


@dataclass(frozen=True)
class EntryCampaign:
    """One entry point on one target. hash: over statuses, bits of all answers, and infos. statuses: how often each
    occurred. touched: outputs changed under a negative status. instructions: the most a call took, to within
    CLOCK_ERROR, at `vector`; total: those of all calls together; stack: the most bytes a call took, at every eighth
    state; all three are 0 on the host."""

    entry: str
    vectors: int
    hash: str
    statuses: Mapping[str, int]
    touched: int
    instructions: int
    vector: int
    total: int
    stack: int


@dataclass(frozen=True)
class Campaign:
    """All entry points of one package on one target. problem: empty if it ran to its end."""

    prefix: str
    target: str
    entries: tuple[EntryCampaign, ...]
    problem: str
    image: Path

    @property
    def hash(self) -> str:
        """Of all entry points together: their hashes, one after the other."""
        return "-".join(e.hash for e in self.entries) if not self.problem else f"failed: {self.problem}"


CLOCK_ERROR = 160
"""Instructions a single call's count may be too high: two ticks of the slowest clock, and the probe's own."""


def run_campaign(
    packages: Sequence[Package | tuple[Path, str]],
    headers: Mapping[str, str],
    *,
    target: str = "host",
    compiler: str = "gcc",
    optimisation: str = "-O2",
    vectors: int = VECTORS,
    build_dir: Path,
    timeout: float = 3600.0,
    jobs: int = 1,
) -> list[Campaign]:
    """Build and run the campaigns of packages (or their folders and prefixes); one result each, in order.

    headers: by prefix, from `campaign_header`. Raises ToolMissing and HarnessBuildError as run_harness does.
    """
    require_target(target, compiler)  # type: ignore[arg-type]
    named = [(p.path, p.prefix) if isinstance(p, Package) else p for p in packages]
    for _, prefix in named:
        write_if_changed(build_dir / "vectors" / f"{prefix}_campaign.h", headers[prefix])
    options = {"CAMPAIGN": str(vectors), "OPTIMISATION": optimisation}
    commands = build_images([path for path, _ in named], target, compiler, build_dir, options)

    def run(prefix: str) -> Campaign:
        command = commands[f"campaign_{prefix}"]
        code, log = execute(command, timeout)
        return read_campaign(prefix, target, code, log, vectors, Path(command["command"][-1]))

    with ThreadPoolExecutor(jobs) as pool:
        return list(pool.map(run, [prefix for _, prefix in named]))


def read_campaign(prefix: str, target: str, exit_code: int, log: str, vectors: int, image: Path = Path()) -> Campaign:
    """What a run proves; a line that is missing is a problem."""
    lines = [words_of(line) for line in log.splitlines()]
    entries = tuple(_entry(w) for w in lines if w[""] == "campaign" and "statuses" in w)
    verdict = next((w for w in lines if w[""] == "verdict"), {})
    problem = complaint_of(log, exit_code)
    if not problem and not any(w[""] == "harness" and w.get("prefix") == prefix for w in lines):
        problem = "the image printed no heading of its own"
    if not problem and (not entries or any(e.vectors != vectors for e in entries)):
        problem = "not all states were run"
    if not problem and (touched := [e.entry for e in entries if e.touched]):
        problem = f"{', '.join(touched)}: outputs were touched under a negative status"
    if not problem and (verdict.get("pass") != "1" or exit_code != 0):
        problem = "the verdict is not good"
    return Campaign(prefix, target, entries, problem, image)


def _entry(words: dict[str, str]) -> EntryCampaign:
    numbers = {name: int(words[name]) for name in ("vectors", "touched", "worst", "vector", "stack")}
    counts = [int(n) for n in words["statuses"].split(",")]
    statuses = {s.name: counts[s - min(Status)] for s in Status if counts[s - min(Status)]}
    return EntryCampaign(
        words["entry"],
        numbers["vectors"],
        words["hash"],
        statuses,
        numbers["touched"],
        numbers["worst"],
        numbers["vector"],
        int(words["total"], 16),
        numbers["stack"],
    )


def campaign_header(scene: Scene, prefix: str, scalar: Scalar, manifest: Mapping[str, Any]) -> str:
    """The C header <prefix>_campaign.h: states to start from, the domain's box, and the entry points to call.

    Of a package with <prefix>_batch.c control is called for 16 states at once, each of which is in turn the last drawn.

    Of the entry points that evaluate, the constraints' values, servo and passive, multipliers and the fused ones, which
    hold the others' code.
    """
    dtype = np.dtype(scalar).type
    fields = [f for f in scene.input_fields() if f.name in manifest["inputs"]]
    drawn = draw_states(scene, DRAWN)
    many = draw_states(scene, 1000, seed=2)
    edge = [state for _, state in boundary_states(scene)]
    with np.errstate(over="ignore"):
        rows = np.vstack(
            [_flat(fields, drawn, dtype), *(_flat(fields, state, dtype) for state in edge)] if fields else [[[0.0]]]
        )
        box = _flat(fields, many, dtype) if fields else np.zeros((1, 1), dtype)
    entries = _entries(scene, manifest, scalar)
    return (
        environment()
        .get_template("campaign.h.j2")
        .render(
            p=prefix,
            scalar=scalar,
            bits=8 * np.dtype(scalar).itemsize,
            fields=fields,
            width=max(sum(f.size for f in fields), 1),
            largest=max(e["size"] for e in entries),
            lowest=int(min(Status)),
            statuses=max(Status) - min(Status) + 1,
            states=[[literal(float(x), scalar) for x in row] for row in rows],
            low=[literal(float(x), scalar) for x in box.min(axis=0)],
            high=[literal(float(x), scalar) for x in box.max(axis=0)],
            drawn=DRAWN if fields else 1,
            entries=entries,
            batch=f"{prefix}_batch.c" in manifest["files"],
            controls=scene.controls,
        )
    )


def _flat(fields: Sequence[Any], state: Mapping[str, FloatArray], dtype: Any) -> FloatArray:
    return np.hstack([state[f.name] for f in fields]).astype(dtype)


def _entries(scene: Scene, manifest: Mapping[str, Any], scalar: Scalar) -> list[dict[str, Any]]:
    """The entry points in the order they run, as the template prints them."""
    system, number = scene.system, literal(float(np.dtype(scalar).type(STEP_DT)), scalar)
    sizes = {f.name: math.prod(scene.shape_of(f)) for f in system.functions}
    both = f"{system.matrix}_{system.right}"
    entries = []
    for name, told in manifest["entry_points"].items():
        offered, solves = system.function(name), "solver_operations" in told
        if name == both:
            entries.append(_evaluating(name, [sizes[system.matrix], sizes[system.right]]))
        elif name == "control" or (offered is not None and offered.controls):
            numbers = [number for _ in offered.arguments] if offered is not None else []
            actuals = ", ".join(["&hc_model", "&in", *numbers, "out", "&told"])
            entries.append({"name": name, "size": scene.controls, "has_info": True, "actuals": actuals})
        elif offered is not None and (solves or name == system.constraint or offered in PASSIVE):
            entries.append(_evaluating(name, [sizes[name]]))
    return entries


def _evaluating(name: str, sizes: Sequence[int]) -> dict[str, Any]:
    """An entry point that hands out quantities of these sizes."""
    actuals = ", ".join(["&hc_model", "&in", *(f"out + {sum(sizes[:k])}" for k in range(len(sizes)))])
    return {"name": name, "size": sum(sizes), "has_info": False, "actuals": actuals}
