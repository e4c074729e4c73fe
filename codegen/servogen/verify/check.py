"""The cross-check: generated C against the textbook reference and the 50-digit truth, on the host or on a board."""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from servogen import exact
from servogen.compiler import build, reference
from servogen.exact_levels import kept_levels, lexicographic
from servogen.ir.balls import balls
from servogen.law.steps import STATE, SYSTEM, Apply, Cascade, Evaluate, Limit, Project, Solve
from servogen.package import Package
from servogen.results import OF_LIMITS, Control, FloatArray, Status
from servogen.scalars import EPSILON, Scalar
from servogen.scene.scene import Scene
from servogen.tools import ToolMissing
from servogen.twins.compiled import CompiledTwin
from servogen.verify.answers import BAR, amplification
from servogen.verify.campaign import VECTORS, Campaign, campaign_header, run_campaign
from servogen.verify.exact_steps import rational, walk
from servogen.verify.harness import HarnessResult, OutputResult, default_states, require_target, run_harness
from servogen.verify.truth import Truth, states_to_check
from servogen.verify.vectors import ANY_STATUS, VectorSet, ulp

STATES = 2000
HOST_COMPILERS = ("gcc", "clang")
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class OutputCheck:
    """One output of one entry point of one package on one target.

    max_ulps: largest error over the domain in ulps of the output's scale; max_ratio: largest error / tolerance over
    all states; reference_ulps: the same error of the textbook reference; histogram: as in OutputResult; problem: empty
    if passed.
    """

    scene: str
    scalar: str
    target: str
    entry: str
    output: str
    compared: int
    max_ulps: float
    reference_ulps: float | None
    max_ratio: float
    hash: str
    histogram: tuple[int, ...]
    problem: str


@dataclass(frozen=True)
class SolveCheck:
    """tau of the generated C against the exact solution of the S, z, y it computed itself.

    max_error: largest |tau - exact| / (eps kappa(S) (|tau| + |y|)), of priorities with what their levels make of kappa;
    the bar is BAR.
    """

    scene: str
    scalar: str
    compiler: str
    solved: int
    max_error: float

    @property
    def passed(self) -> bool:
        """No system beyond the bar; `solved` may be 0 where S never has full rank (then the vectors alone judge)."""
        return self.max_error <= BAR


@dataclass(frozen=True)
class Difference:
    """Largest difference between host and board, in ulps of the output's scale over the domain; 0: the same bits."""

    scene: str
    scalar: str
    entry: str
    output: str
    compared: int
    different: int
    max_ulps: float
    statuses_differ: int


@dataclass(frozen=True)
class BackToBack:
    """One package on host and board at states made on the target; `hash` is the host's, of all entry points."""

    scene: str
    scalar: str
    target: str
    vectors: int
    hash: str
    statuses: dict[str, int]
    problem: str


@dataclass(frozen=True)
class CheckReport:
    """All figures of a check; `skipped` says what this machine lacks, with the command that installs it."""

    states: int
    boundary: tuple[str, ...]
    outputs: tuple[OutputCheck, ...]
    solves: tuple[SolveCheck, ...]
    differences: tuple[Difference, ...]
    campaigns: tuple[BackToBack, ...]
    problems: tuple[str, ...]
    skipped: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """Something was checked, and all of it was right."""
        return bool(self.outputs) and not self.problems


@dataclass(frozen=True, eq=False)
class _Case:
    """One package with its truth and vectors."""

    scene: Scene
    package: Package
    truth: Truth
    vectors: VectorSet

    @property
    def scalar(self) -> Scalar:
        return self.package.module.target.scalar


def check(
    scenes: Sequence[Scene],
    target: str = "host",
    states: int | None = None,
    seed: int = 0,
    progress: Progress = lambda done, total, text: None,
    vectors: int = VECTORS,
    core: str | None = None,
) -> CheckReport:
    """Cross-check scenes in both scalars: on the host under gcc and clang, or on a board against the host.

    states: drawn a scene; None: STATES, or fewer where the board is small. vectors: states made on a board itself, at
    which its answers must be the host's bit for bit. core: a name; all packages share one, as for sg.build.
    Raises ToolMissing where the target has no compiler or emulator here.
    """
    states = default_states(target, STATES) if states is None else states
    compilers, skipped = _host_compilers()
    if target != "host":
        require_target(target)
        compilers = compilers[:1]
    campaigns: list[BackToBack] = []
    steps = _Steps(progress, 2 * len(scenes) + len(compilers) * (2 * len(scenes) + 1) + 2 * (target != "host"))
    with tempfile.TemporaryDirectory(prefix="servogen-check-") as folder:
        cases = [
            _prepare(scene, scalar, Path(folder), states, seed, steps, core) for scene in scenes for scalar in EPSILON
        ]
        runs = {}
        for compiler in compilers:
            steps.next(f"compiling and running with {compiler}")
            runs[compiler] = _run(cases, "host", compiler, Path(folder) / compiler, target != "host")
        if target != "host":
            steps.next(f"running on {target}")
            runs[target] = _run(cases, target, "gcc", Path(folder) / target, dump=True)
            steps.next(f"{vectors} states on {target} and on the host")
            campaigns = _back_to_back(cases, target, vectors, Path(folder))
        references = [_reference_ulps(case) for case in cases]
        outputs = [
            _output_check(case, name, o, ulps)
            for name, results in runs.items()
            for case, ulps, result in zip(cases, references, results, strict=True)
            for o in result.outputs
        ]
        solves = [_solve_check(case, compiler, steps) for compiler in compilers for case in cases]
        differences: list[Difference] = []
        if target != "host":
            for case, here, there in zip(cases, runs[compilers[0]], runs[target], strict=True):
                differences += _differences(case, here, there)
    problems = [f"{r.prefix} ({name}): {p}" for name, results in runs.items() for r in results for p in r.problems]
    problems += [f"{case.package.prefix}: {p}" for case in cases for p in case.truth.problems]
    problems += [p for case, ulps in zip(cases, references, strict=True) for p in _formula_problems(case, ulps)]
    problems += [f"{c.scene} {c.scalar} on {target}: {c.problem}" for c in campaigns if c.problem]
    skipped += [text for case in cases for text in _not_covered(case)]
    problems += [
        f"{s.scene} {s.scalar} ({s.compiler}): tau errs by {s.max_error:.3g} eps kappa (|tau| + |y|); "
        f"the bar is {BAR:g}"
        for s in solves
        if not s.passed
    ]
    boundary = tuple(dict.fromkeys(name for scene in scenes for name in states_to_check(scene, 0)[1]))
    return CheckReport(
        states,
        boundary,
        tuple(outputs),
        tuple(solves),
        tuple(differences),
        tuple(campaigns),
        tuple(problems),
        tuple(skipped),
    )


class _Steps:
    """Counts the steps of a check for the progress bar."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def next(self, text: str) -> None:
        self._progress(self._done, self._total, text)
        self._done += 1


def _host_compilers() -> tuple[list[str], list[str]]:
    """The compilers that are here, and what to install for the others. ToolMissing where there is none."""
    found, missing = [], []
    for compiler in HOST_COMPILERS:
        try:
            require_target("host", compiler)  # type: ignore[arg-type]
            found.append(compiler)
        except ToolMissing as problem:
            missing.append(str(problem))
    if not found:
        raise ToolMissing(missing[0])
    return found, missing


def _prepare(
    scene: Scene, scalar: Scalar, folder: Path, states: int, seed: int, steps: _Steps, core: str | None
) -> _Case:
    steps.next(f"{scene.name} {scalar}: 50-digit truth at {states} states")
    package = build(scene, folder / f"{scene.name}-{scalar}", scalar, core=core)
    truth = Truth(scene, package.module, states_to_check(scene, states, seed)[0], states)
    return _Case(scene, package, truth, truth.vector_set())


def _run(cases: list[_Case], target: str, compiler: Any, folder: Path, dump: bool = False) -> list[HarnessResult]:
    vectors = {case.package.prefix: case.vectors for case in cases}
    packages = [case.package.path for case in cases]
    return run_harness(packages, vectors, target=target, compiler=compiler, build_dir=folder, dump=dump)


def _back_to_back(cases: list[_Case], target: str, vectors: int, folder: Path) -> list[BackToBack]:
    """The campaign on the host and on the board: one hash."""
    packages = [case.package for case in cases]
    headers = {
        c.package.prefix: campaign_header(c.scene, c.package.prefix, c.scalar, c.package.manifest) for c in cases
    }
    here, there = (
        run_campaign(packages, headers, target=t, vectors=vectors, build_dir=folder / f"campaign-{t}")
        for t in ("host", target)
    )
    return [
        BackToBack(
            case.scene.name, case.scalar, target, vectors, a.hash, dict(a.entries[-1].statuses), _disagreement(a, b)
        )
        for case, a, b in zip(cases, here, there, strict=True)
    ]


def _disagreement(here: Campaign, there: Campaign) -> str:
    if here.problem or there.problem:
        return here.problem or there.problem
    names = [a.entry for a, b in zip(here.entries, there.entries, strict=True) if a.hash != b.hash]
    return f"{', '.join(names)}: other bits than on the host" if names else ""


def _output_check(case: _Case, target: str, o: OutputResult, references: dict[str, float]) -> OutputCheck:
    judged = o.entry == "control" or o.output != case.scene.system.answer
    return OutputCheck(
        case.scene.name,
        case.scalar,
        target,
        o.entry,
        o.output,
        o.compared,
        o.max_ulps,
        references.get(o.output) if judged else None,
        o.max_ratio,
        o.hash,
        o.histogram,
        o.problem,
    )


def _reference_ulps(case: _Case) -> dict[str, float]:
    """Largest error of the textbook reference over the domain, per output, in ulps of the output's scale."""
    truth = case.truth
    twin = reference(case.scene, case.scalar)
    worst: dict[str, float] = {}
    answer = case.scene.system.answer
    ranks = next(e.rank for e in case.vectors.entries if e.name == "control")
    vectors = {(e.name, o.name): o for e in case.vectors.entries for o in e.outputs}
    system = case.scene.system
    names = (system.constraint, system.matrix, system.right)
    wanted = {name: vectors[name, name] for name in names if (name, name) in vectors}
    for k in range(truth.drawn):
        inputs = {name: values[k] for name, values in truth.inputs.items()}
        status, result = twin.system(inputs)
        if status < 0:
            continue
        result = {n: v.astype(twin.dtype).astype(float) for n, v in result.items()}
        control = twin.control(**inputs)
        result[answer] = control.value.astype(float)
        # Of dependent rows its own rounding may make independent ones; such a tau says nothing of its formulas.
        other_rank = ranks is not None and control.info.rank != ranks[k]
        for name, expected in (wanted | {answer: vectors["control", answer]}).items():
            if not np.all(np.isfinite(expected.tolerance[k])) or (name == answer and other_rank):
                continue
            hi, lo = expected.hi[k].astype(float), expected.lo[k].astype(float)
            error = float(np.max(np.abs((result[name].ravel() - hi) - lo)))
            worst[name] = max(worst.get(name, 0.0), error / ulp(expected.scale, case.scalar))
    return worst


def _formula_problems(case: _Case, reference_ulps: dict[str, float]) -> list[str]:
    """Where the textbook formulas and the derivation disagree by more than half the digits: one of them is wrong.

    Rounding costs the reference, which solves with Q in float64, far less than that unless Q is nearly singular.
    """
    half = EPSILON["float64"] ** -0.5 if case.scalar == "float64" else EPSILON["float32"] ** -0.5
    return [
        f"{case.package.prefix}: {name} of the textbook formulas is off the truth by {ulps:.3g} ulps; "
        "the derivation or the reference is wrong"
        for name, ulps in reference_ulps.items()
        if not ulps < half
    ]


def _not_covered(case: _Case) -> list[str]:
    """What no vector judges, with the reason."""
    steps = {r.name: r.steps[0] for r in case.truth.law.routines if isinstance(r.steps[0], Project)}
    lines = []
    for entry in (e for e in case.vectors.entries if e.name in steps):
        unknown = int(np.sum(entry.statuses()[: case.truth.drawn] == ANY_STATUS))
        if unknown:
            of = f"{unknown} of {case.truth.drawn} states"
            nearest = f"where Newton's method finds no nearest {steps[entry.name].into}"
            lines.append(f"{case.package.prefix}: {entry.name} at {of}, {nearest}")
    return lines


def _solve_check(case: _Case, compiler: str, steps: _Steps) -> SolveCheck:
    """Hold tau against the exact solution of the system the code itself computed, at the drawn states."""
    steps.next(f"{case.scene.name} {case.scalar}: exact solutions, {compiler}")
    twin = case.package.load(compiler)
    assert isinstance(twin, CompiledTwin)
    worst, solved, step = 0.0, 0, _solve_of(case)
    for k in range(case.truth.drawn):
        inputs = {name: values[k] for name, values in case.truth.inputs.items()}
        status, S, z = _system(case, twin, k, inputs)
        answer = twin.control(**inputs)
        inexact = answer.info.status in (Status.REGULARISED, *OF_LIMITS)
        if not isinstance(step, Cascade):
            inexact |= answer.info.status == Status.RANK_DEFICIENT_INCONSISTENT or answer.info.rank < min(S.shape)
        if status < 0 or answer.info.status < 0 or inexact:
            continue
        y, behind, epsilon = _free_vector(case, k), _behind(case, k), EPSILON[case.scalar]
        if isinstance(step, Cascade):
            error = _cascade_error(step, case, k, S, z, y, answer, epsilon, behind)
        else:
            error = _solve_error(S, z, y, answer.value, epsilon, behind)
        if error is not None:
            worst, solved = max(worst, error), solved + 1
    return SolveCheck(case.scene.name, case.scalar, compiler, solved, worst)


def _solve_of(case: _Case) -> Solve | Cascade | Apply:
    """The step of control that solves the scene's system."""
    steps = case.truth.law.routine("control").steps
    return next(s for s in steps if isinstance(s, Solve | Cascade | Apply) and s.solver == SYSTEM)


def _free_vector(case: _Case, k: int) -> FloatArray:
    """y as the scalar's own arithmetic gives it."""
    free = _solve_of(case).free
    if not free:
        return np.zeros(case.scene.controls)
    if free.startswith(STATE):
        return np.asarray(case.truth.inputs[free.removeprefix(STATE)][k])
    return case.truth.points[k].rounded[free]


def _system(
    case: _Case, twin: CompiledTwin, k: int, inputs: dict[str, FloatArray]
) -> tuple[Status, FloatArray, FloatArray]:
    """The system the solver gets: the code's own words for it, and by the scalar's own arithmetic what has no entry."""
    step, law = _solve_of(case), case.truth.law
    if (step.matrix, step.right) in law.entries:
        status, (S, z) = twin.evaluate(f"{step.matrix}_{step.right}", inputs)
        return status, S, z
    status, (z,) = twin.evaluate(step.right, inputs)
    return status, case.truth.points[k].rounded[step.matrix].reshape(case.scene.system_shape), z


def _behind(case: _Case, k: int) -> exact.Matrix | None:
    """What the steps of control behind the solve make of its answer, a matrix, by the scalar's own quantities."""
    steps = case.truth.law.routine("control").steps
    solve = _solve_of(case)
    behind = [step for step in steps[steps.index(solve) + 1 :] if not isinstance(step, Limit | Evaluate)]
    if not behind:
        return None
    values = {name: balls(v) for name, v in case.truth.points[k].rounded.items()}
    l = case.scene.controls
    columns = []
    for unit in np.eye(l):
        values[solve.into] = balls(unit)
        walk(behind, values)
        columns.append(values[behind[-1].into])
    return rational([columns[j][i] for i in range(len(columns[0])) for j in range(l)], len(columns[0]), l)


def _solve_error(
    S: FloatArray, z: FloatArray, y: FloatArray, tau: FloatArray, epsilon: float, behind: exact.Matrix | None = None
) -> float:
    """|tau - exact| / (eps kappa(S) (|x| + |y|)) for the solve's answer x; times |N| where steps behind it make N x."""
    matrix = exact.rational(S)
    truth = exact.solution(matrix, exact.pinv_full(matrix), exact.rational(z), exact.rational(y))
    reach = float(np.linalg.norm(exact.nearest(truth))) + float(np.linalg.norm(y))
    if behind is not None:
        truth = behind * truth
        reach *= float(np.linalg.norm(exact.nearest(behind)))
    error = float(np.linalg.norm(exact.difference(tau, truth)))
    if error == 0.0:
        return 0.0
    sigma = np.linalg.svd(np.asarray(S, dtype=float), compute_uv=False)
    return error / (epsilon * float(sigma[0] / sigma[-1]) * reach)


def _cascade_error(
    step: Cascade,
    case: _Case,
    k: int,
    S: FloatArray,
    z: FloatArray,
    y: FloatArray,
    answer: Control,
    epsilon: float,
    behind: exact.Matrix | None,
) -> float | None:
    """The same of priorities, for the exact lexicographic optimum; None where the code has other ranks than it, or
    where a constraint is on its way in or out."""
    switches = [(rows, float(case.truth.inputs[name.removeprefix(STATE)][k][0])) for name, rows in step.switches]
    if any(0 < a < 1 for _, a in switches):
        return None
    levels = kept_levels(step.levels, switches, frozenset(j for j, (_, a) in enumerate(switches) if a >= 1))
    best = lexicographic(exact.rational(S), exact.rational(z), exact.rational(y), levels)
    if list(best.ranks) != answer.info.level_rank:
        return None
    S, x = np.asarray(S, dtype=float), exact.nearest(best.x)[:, 0]
    length = np.where(np.linalg.norm(S, axis=1) > 0, np.linalg.norm(S, axis=1), 1.0)
    own = [i for level in levels for i in level]
    factor = amplification(S, levels, best.ranks)
    missed = float(np.max(np.abs(z - S @ x)[own] / length[own], initial=0.0))
    reach = float(np.linalg.norm(x)) + float(np.linalg.norm(y)) + factor * missed
    truth = best.x
    if behind is not None:
        truth = behind * truth
        reach *= float(np.linalg.norm(exact.nearest(behind)))
    error = float(np.linalg.norm(exact.difference(answer.value, truth)))
    return error / (epsilon * factor * reach) if error else 0.0


def _differences(case: _Case, here: HarnessResult, there: HarnessResult) -> list[Difference]:
    """Value by value, host against board."""
    found = []
    for entry in case.vectors.entries:
        for output in entry.outputs:
            a, b = here.dumps[entry.name, output.name], there.dumps[entry.name, output.name]
            both = (a.status >= 0) & (b.status >= 0)
            gap = np.abs(a.values.astype(float) - b.values.astype(float))
            drawn = gap[: case.truth.drawn][both[: case.truth.drawn]]
            largest = float(np.max(drawn, initial=0.0)) / ulp(output.scale, case.scalar)
            found.append(
                Difference(
                    case.scene.name,
                    case.scalar,
                    entry.name,
                    output.name,
                    int(both.sum()) * output.size,
                    int(np.count_nonzero(gap[both])),
                    largest,
                    int(np.count_nonzero(a.status != b.status)),
                )
            )
    return found
