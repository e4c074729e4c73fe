"""The closed loop in generated C, compiled on this machine: controller and plant in one library, called in chunks."""

import ctypes as ct
import math
import os
import tempfile
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from contextlib import nullcontext
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import block_diag, expm

from servogen.errors import SceneError
from servogen.results import FloatArray, Status
from servogen.scalars import EPSILON, Scalar
from servogen.scene.scene import Scene
from servogen.simulate.batch import OUTCOME, Job, Part, do, setup_struct, stop_struct
from servogen.simulate.board import Setup, run_on_board
from servogen.simulate.claim import claim_of
from servogen.simulate.ideal import ideal_decay, prescribed, value_at
from servogen.simulate.machine import Grid, grid_of, machine_arrays, plant_scene
from servogen.simulate.manifold import closed_start, drift_of
from servogen.simulate.options import Options, options_of
from servogen.simulate.runs import Runs, runs_of
from servogen.simulate.simulation import (
    METHODS,
    Simulation,
    check_simulation,
    checked,
    known_symbols,
    moving_references,
    run_takes,
    start_values,
    with_units_of_rates,
)
from servogen.simulate.sources import LoopSources, host_sources, write_loop
from servogen.simulate.spread import Draws, draw
from servogen.simulate.trajectory import Reason, Stop, Trajectory
from servogen.twins.compiled import build_library

MOST_STEPS = 5_000_000
MOST_RUNS = 10_000_000  # half a kilobyte each
_CHUNK = 4096
_REASONS: dict[int, Reason] = {
    1: "finished",
    2: "event",
    3: "controller",
    4: "plant",
    5: "stop expression",
    6: "reference",
}

Progress = Callable[[int, int], None]


def simulate(
    scene: Scene, simulation: Simulation | None = None, *, scalar: Scalar = "float64", **options: Any
) -> Trajectory:
    """Compile a scene's closed loop and run it once; see ClosedLoop and ClosedLoop.run."""
    held = (simulation or Simulation()).holding(options.get("references") or ())
    return ClosedLoop(scene, held, scalar).run(**options)


class ClosedLoop:
    """A scene's controller and plant, both generated C, compiled together; run it as often as you like.

    target: "host", or a board, in whose emulator the whole loop then runs; the rows are the host's bit for bit.
    Raises SceneError for a simulation that does not fit the scene, ToolMissing without a C compiler or emulator.
    """

    def __init__(
        self,
        scene: Scene,
        simulation: Simulation | None = None,
        scalar: Scalar = "float64",
        compiler: str | None = None,
        target: str = "host",
    ) -> None:
        if scalar not in EPSILON:
            raise SceneError(f"scalar {scalar!r}: choose 'float64' or 'float32'")
        self.scene = scene
        self.simulation = with_units_of_rates(scene, simulation or Simulation())
        self.scalar = scalar
        check_simulation(scene, self.simulation)
        self._plant = plant_scene(scene, self.simulation)
        self.target = target
        self._folder = tempfile.TemporaryDirectory(prefix="servogen-loop-")
        self._sources = write_loop(scene, self.simulation, Path(self._folder.name), scalar)
        if target == "host":
            self._file = _compile(self._sources, scalar, compiler, Path(self._folder.name))
            self._library = ct.CDLL(str(self._file))
        self._prefix = self._sources.controller.prefix
        self._given = self._sources.given

    def run(self, *, progress: Progress | None = None, replay: int | None = None, **options: Any) -> Trajectory:
        """Integrate from t = 0 by fixed steps of a Runge-Kutta method, "rk4" or "dop8"; default the simulation's.

        options: see Options. progress: called with (steps done, steps) from time to time.
        replay: a seed of `runs`, whose draw from the spread this run takes.
        """
        given = options_of(options if replay is None else options | {"seed": replay})
        plan = self._plan(given)
        if replay is not None:
            plan = plan.drawn(draw(self._plant, self._spread(given), [replay], plan.plant, plan.inputs), 0)
        began = time.perf_counter()
        rows, marks, stop = self._integrate(self._setup(plan), plan.grid.steps // plan.grid.row_every, progress)
        seconds = time.perf_counter() - began
        return replace(self._trajectory(rows, marks, stop, plan), seconds=seconds)

    def runs(
        self, count: int, *, executor: Executor | None = None, progress: Progress | None = None, **options: Any
    ) -> Runs:
        """`count` runs with seeds seed, seed + 1, ..., each of another draw and other noise, without their rows.

        spread: half-widths of uniform draws about the nominal values: {"m": 0.1} is 10 % of the plant's parameter
        either way, {"q": 0.05} as much of the start's q in its own unit, entry by entry; default the simulation's.
        executor: any of concurrent.futures (a Dask client's, say) whose workers are machines like this one; default
        threads on all cores. progress: called with (runs done, runs). The rest is as for `run`.
        """
        if self.target != "host":
            raise SceneError(f"runs go on this machine, not on {self.target}; replay one of them there")
        if not isinstance(count, int) or count < 1:
            raise SceneError(f"runs = {count!r}; give a whole number, at least 1")
        if count > MOST_RUNS:
            raise SceneError(f"runs = {count}; at most {MOST_RUNS:,} in one call, more by calls with other seeds")
        given = options_of(options)
        first = self.simulation.seed if given.seed is None else given.seed
        if not 0 <= first <= 2**32 - count:
            raise SceneError(f"seed {first!r} for {count} runs; give a whole number from 0 to {2**32 - count}")
        plan = self._plan(given)
        drawn = draw(self._plant, self._spread(given), np.arange(first, first + count), plan.plant, plan.inputs)
        job, states = self._job(plan), self._prescribed_starts(plan, drawn)
        workers = os.cpu_count() or 1
        size = max(1, min(250, count // (4 * workers)))
        parts = [slice(k, min(k + size, count)) for k in range(0, count, size)]
        found = np.empty(count, OUTCOME)
        began = time.perf_counter()
        with nullcontext(executor) if executor is not None else ThreadPoolExecutor(workers) as pool:
            tasks = {}
            for own in parts:
                arrays = {n: a[own] for n, a in drawn.arrays.items()}
                tasks[pool.submit(do, job, Part(arrays, drawn.seeds[own], states[own]))] = own
            done = 0
            for task in as_completed(tasks):
                found[tasks[task]] = task.result()
                done += tasks[task].stop - tasks[task].start
                if progress is not None:
                    progress(done, count)
        seconds = time.perf_counter() - began
        claim = claim_of(self.scene, self.simulation, plan.parameters, plan.grid.hold)
        return runs_of(self.scene.name, found, _REASONS, self.simulation.events, claim, self._sizes(), drawn, seconds)

    def _spread(self, given: Options) -> Mapping[str, Any]:
        return self.simulation.spread if given.spread is None else given.spread

    def _job(self, plan: "_Plan") -> Job:
        """What all runs share, the shared library included."""
        setup = self._setup(plan)
        claim = claim_of(self.scene, self.simulation, plan.parameters, plan.grid.hold)
        values = dict(plan.inputs) | plan.parameters
        step = plan.grid.step * plan.grid.row_every
        place: list[int] = []
        blocks, row = [], 0
        for part in prescribed(self.scene):
            blocks.append(expm(value_at(self.scene, part.matrix, values) * step))
            place += range(row, row + part.psi.size1())
            row += len(blocks[-1])
        return Job(
            library=self._file.read_bytes(),
            prefix=self._prefix,
            scalar=self.scalar,
            arrays=setup.arrays,
            reals=setup.reals,
            numbers=setup.numbers | {"frugal": int(self.simulation.sigma_min is None)},
            sizes=self._sizes(),
            claim={
                "low": claim.low,
                "high": claim.high,
                "angle": claim.angle.astype(np.int32),
                "tolerance": claim.tolerance,
                "forward": block_diag(*blocks),
                "place": np.array(place, np.int32),
            },
            rows=plan.grid.steps // plan.grid.row_every + 1,
        )

    def _prescribed_starts(self, plan: "_Plan", drawn: Draws) -> FloatArray:
        """Of each run the state of the prescribed decay at its start: psi's rates, and zeros where psi will be."""
        count = len(drawn.seeds)
        given = {f.name: plan.inputs[f.name] for f in self._given}
        columns = {n: np.tile(v, (count, 1)) for n, v in {**given, "tau": plan.inputs["tau"]}.items()}
        columns |= {n: drawn.arrays[n].astype(self.scalar) for n in ("q", "u")} | {"t": np.zeros((count, 1))}
        columns |= {n: np.tile(v, (count, 1)) for n, v in self._moving(np.zeros(1)).items()}
        columns |= plan.apart(drawn.arrays["plant"])
        symbols = known_symbols(self.scene)
        arguments = [ca.DM(columns[n].astype(float).T) for n, _ in symbols]
        parts = []
        for part in prescribed(self.scene):
            parts.append(np.zeros((count, part.psi.size1())))
            function = ca.Function("rates", [s for _, s in symbols], [ca.densify(part.rates)])
            parts.append(np.array(function.map(count).call(arguments)[0], dtype=float).T)
        return np.hstack(parts)

    def _plan(self, given: Options) -> "_Plan":
        """Everything a run is made of, checked."""
        simulation = given.on(self.simulation)
        grid = self._grid(simulation, given)
        inputs = start_values(self.scene, self.simulation, given.start, given.references)
        for name in moving_references(self.scene, self.simulation, ca.SX.sym("t")):
            if name in (given.references or {}):
                remedy = "hold its reference too (--reference, or Simulation.holding)"
                raise SceneError(f"references: {name!r} moves in this simulation; {remedy}")
        method = self.simulation.method if given.method is None else given.method
        if method not in METHODS:
            raise SceneError(f"method {method!r}; choose {' or '.join(METHODS)}")
        values, own = self._parameters(given.parameters or {}, given.plant or {})
        inputs |= closed_start(self._plant, inputs, own)
        return _Plan(simulation, grid, inputs, values, own, method, given.project)

    def _grid(self, simulation: Simulation, options: Options) -> Grid:
        duration = self.simulation.duration if options.duration is None else float(options.duration)
        step = self.simulation.step if options.step is None else float(options.step)
        hold = options.hold
        given = hold if hold is None or isinstance(hold, bool) else float(hold)
        named = (("duration", duration), ("step", step), *((("hold", given),) if isinstance(given, float) else ()))
        for name, value in named:
            if not (math.isfinite(value) and value > 0):
                raise SceneError(f"{name} = {value}; give a positive number of seconds")
        if step > duration:
            raise SceneError(f"step {step:g} s is longer than duration {duration:g} s; give a shorter step")
        grid = grid_of(simulation, duration, step, given)
        if grid.steps > MOST_STEPS:
            told = f"duration {duration} s in steps of {grid.step:g} s are {grid.steps} steps"
            raise SceneError(f"{told}; at most {MOST_STEPS}")
        return grid

    def _parameters(
        self, given: Mapping[str, Any], plant: Mapping[str, Any]
    ) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
        """The controller's parameters, and the plant's."""
        sizes = run_takes(self.scene)["parameters"]
        known = {f.name: np.asarray(f.default, float) for f in self.scene.parameters}
        values = known | checked(given, sizes, "parameters")
        own = self.simulation.plant if isinstance(self.simulation.plant, Mapping) else {}
        return values, values | checked(own, sizes, "plant") | checked(plant, sizes, "plant")

    def _setup(self, plan: "_Plan") -> Setup:
        grid, inputs = plan.grid, plan.inputs
        arrays = {
            "parameters": np.concatenate([np.zeros(0), *plan.parameters.values()]),
            "plant": np.concatenate([np.zeros(0), *plan.plant.values()]),
            **{name: inputs[name] for name in ("q", "u", "tau")},
            "given": np.concatenate([np.zeros(0), *(inputs[f.name] for f in self._given)]),
            **machine_arrays(self.scene, plan.simulation, grid.step / grid.substeps),
        }
        dtype = np.dtype(self.scalar)
        return Setup(
            {name: np.ascontiguousarray(values, dtype) for name, values in arrays.items()},
            {"step": grid.step, "tick": grid.hold or grid.step},
            {
                "substeps": grid.substeps,
                "steps": grid.steps,
                "row_every": grid.row_every,
                "tick_every": grid.tick_every,
                "delay": grid.delay,
                "seed": int(plan.simulation.seed),
                "method": METHODS.index(plan.method),
                "hold": int(grid.hold is not None),
                "frugal": 0,
                "project": int(plan.project),
            },
        )

    def _integrate(self, setup: Setup, steps: int, progress: Progress | None) -> tuple[FloatArray, Any, Stop]:
        """Rows (at most steps + 1), their marks, and the end."""
        sizes = self._sizes()
        if self.target != "host":
            work = Path(self._folder.name) / "board"
            rows, marks, (reason, detail, t) = run_on_board(self._sources, sizes, setup, self.scalar, self.target, work)
            return rows, marks, self._stop(reason, detail, t)
        rows = np.zeros((steps + 1, sum(sizes) + 2), np.dtype(self.scalar))
        marks = np.zeros((steps + 1, 3), np.int32)
        record = _Record(*sizes, steps + 1, 0, rows.ctypes.data, marks.ctypes.data)
        pointers = (a.ctypes.data for a in setup.arrays.values())
        given = setup_struct(self.scalar)(
            *pointers, *setup.reals.values(), *setup.numbers.values(), self._physics(setup)
        )
        run = (ct.c_double * (self._call("run_bytes", restype=ct.c_size_t) // 8 + 1))()  # aligned as a double is
        stop = stop_struct(self.scalar)()
        sink, user = self._library.sim_keep, ct.byref(record)
        reason = self._call("begin", run, ct.byref(given), sink, user)
        while True:
            count = _CHUNK if reason == 0 else 0
            reason = self._call("advance", run, ct.c_uint32(count), sink, user, ct.byref(stop))
            if progress is not None:
                progress(record.used - 1, steps)
            if reason != 0:
                return rows[: record.used], marks[: record.used], self._stop(stop.reason, stop.detail, stop.t)

    def _physics(self, setup: Setup) -> Any:
        """A C function in the place of the plant (sim_physics of firmware_sim/simulate/loop.h); None for the plant."""
        return None

    def _call(self, name: str, *args: Any, restype: Any = ct.c_int) -> Any:
        function = getattr(self._library, f"{self._prefix}_{name}")
        function.restype = restype
        return function(*args)

    def _sizes(self) -> tuple[int, int, int, int]:
        mech = self.scene.mechanism
        return mech.q.size1(), mech.u.size1(), self.scene.controls, self.scene.rows

    def _stop(self, number: int, detail: int, t: float) -> Stop:
        reason = _REASONS[number]
        if reason == "event":
            return Stop(reason, float(t), self.simulation.events[detail])
        return Stop(reason, float(t), "", Status(detail))

    def _trajectory(self, rows: FloatArray, marks: Any, stop: Stop, plan: "_Plan") -> Trajectory:
        grid, parameters = plan.grid, plan.parameters
        edges = np.cumsum([1, *self._sizes()])
        t, q, u, tau, constraint, sigma_min = np.split(rows, edges, axis=1)
        given = {f.name: plan.inputs[f.name] for f in self._given}
        columns = {"t": t, "q": q, "u": u, "tau": tau} | {
            n: np.tile(v, (len(t), 1)) for n, v in {**plan.plant, **given}.items()
        }
        columns |= self._moving(t[:, 0].astype(float))
        outputs = self._evaluate(self.simulation.outputs, columns)
        first = {n: v[0] for n, v in columns.items()} if len(t) else {}
        step = grid.step * grid.row_every
        return Trajectory(
            scene=self.scene.name,
            kind=self.scene.kind,
            step=step,
            hold=grid.hold,
            method=plan.method,
            t=t[:, 0],
            q=q,
            u=u,
            tau=tau,
            constraint=constraint,
            ideal=ideal_decay(self.scene, first, step, len(t), parameters, constraint[0]) if first else constraint,
            status=marks[:, 0],
            rank=marks[:, 1],
            limited=marks[:, 2],
            sigma_min=sigma_min[:, 0],
            stop=stop,
            claim=claim_of(self.scene, self.simulation, parameters, grid.hold),
            outputs=outputs,
            decay=self._decay(outputs, columns),
            parameters=parameters,
            plant=plan.plant,
            inputs=given,
            drift=drift_of(self._plant, columns),
        )

    def _moving(self, t: FloatArray) -> dict[str, FloatArray]:
        """The references that move, along the rows."""
        now = ca.SX.sym("t")
        moving = moving_references(self.scene, self.simulation, now)
        functions = {name: ca.Function(name, [now], [ca.densify(sx)]) for name, sx in moving.items()}
        return {n: np.array(f.map(len(t))(t.reshape(1, -1))).T for n, f in functions.items() if len(t)}

    def _evaluate(self, expressions: Mapping[str, Any], columns: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """Expressions along the rows, by CasADi's virtual machine: another hand than the generated C."""
        count = len(columns["t"])
        if not expressions or count == 0:
            return {name: np.zeros(count) for name in expressions}
        symbols = known_symbols(self.scene)
        function = ca.Function("outputs", [s for _, s in symbols], list(expressions.values()))
        given = [ca.DM(columns[n].astype(float).T) for n, _ in symbols]
        values = function.map(count).call(given)
        return {n: np.array(v, dtype=float).ravel() for n, v in zip(expressions, values, strict=True)}

    def _decay(self, outputs: dict[str, FloatArray], columns: dict[str, FloatArray]) -> dict[str, FloatArray]:
        """limit + (value(0) - limit) exp(rate t)."""
        decay = self.simulation.decay
        rates = self._evaluate({n: rate for n, (rate, _) in decay.items()}, columns)
        limits = self._evaluate({n: limit for n, (_, limit) in decay.items()}, columns)
        t = columns["t"][:, 0].astype(float)
        return {n: limits[n] + (outputs[n][:1] - limits[n]) * np.exp(rates[n] * t) for n in decay}


@dataclass(frozen=True, eq=False)
class _Plan:
    """A run: on which machine and grid, from which inputs, with which parameters of controller and plant."""

    simulation: Simulation
    grid: Grid
    inputs: dict[str, FloatArray]
    parameters: dict[str, FloatArray]
    plant: dict[str, FloatArray]
    method: str
    project: bool

    def apart(self, plant: FloatArray) -> dict[str, FloatArray]:
        """Parameters that lie one after the other along the last axis, by name; there may be none."""
        edges = np.cumsum([0, *(len(v) for v in self.plant.values())])
        return {n: plant[..., a:b] for n, (a, b) in zip(self.plant, pairwise(edges), strict=True)}

    def drawn(self, draws: Draws, k: int) -> "_Plan":
        """The same with the plant and the start of the k-th draw."""
        plant = self.apart(draws.arrays["plant"][k])
        return replace(self, plant=plant, inputs=self.inputs | {n: draws.arrays[n][k] for n in ("q", "u")})


class _Record(ct.Structure):
    """sim_record of firmware_sim/simulate/record.h."""

    _fields_ = [
        *((n, ct.c_int) for n in ("q", "u", "tau", "constraint")),
        *((n, ct.c_uint32) for n in ("capacity", "used")),
        ("values", ct.c_void_p),
        ("marks", ct.c_void_p),
    ]


def _compile(sources: LoopSources, scalar: Scalar, compiler: str | None, folder: Path) -> Path:
    """One shared library of all the C, a file in `folder`."""
    options = [f"-I{folder}" for folder in sources.include_folders]
    bits = "64" if scalar == "float64" else "32"
    files = [str(file) for file in host_sources(sources)]
    flags = ("-O2", f"-DSERVOGEN_SCALAR_BITS={bits}", *options, *files)
    return build_library(sources.controller, folder, compiler, flags)
