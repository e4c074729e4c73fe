"""Run time against error of the closed loop: step size, method and scalar, against DOP853 on the Python twin."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp

from servogen.compiler import optimised_scene, reference
from servogen.results import FloatArray
from servogen.scalars import EPSILON, Scalar
from servogen.scene.scene import Scene
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.plots import METHOD_NAMES
from servogen.simulate.simulation import METHODS, Simulation, moving_references, start_values
from servogen.simulate.trajectory import Trajectory


@dataclass(frozen=True)
class MethodRun:
    """One run: seconds its C took (the best of three), and the largest error of q and u at its end, absolute."""

    scalar: Scalar
    method: str
    step: float
    seconds: float
    error: float


MOST_EVALUATIONS = 20_000
"""Of the loop under DOP853; a smooth one takes up to ten thousand."""


_NO_FLAWS: dict[str, Any] = {
    "plant": {},
    "actuators": None,
    "noise": {},
    "quantise": {},
    "delay": 0.0,
    "hold": None,
    "disturbance": {},
}


class NotSmooth(RuntimeError):  # noqa: N818, the name says it
    """The loop's right side jumps: no integrator of high order gets through it at a tight tolerance."""


def tight_end(scene: Scene, simulation: Simulation, duration: float, start: Trajectory) -> FloatArray:
    """q and u at `duration` seconds: the textbook reference in the loop, under scipy's DOP853 at 1e-12.

    start: a run whose first row is the start (tau projected). Mass matrix and forces by CasADi's virtual machine.
    Raises NotSmooth after MOST_EVALUATIONS.
    """
    twin = reference(scene)
    mech = scene.mechanism
    fields = [f for f in scene.input_fields() if f.name not in ("q", "u", "t", "tau")]
    given = {f.name: start_values(scene, simulation)[f.name] for f in fields}
    t = ca.SX.sym("t") if mech.t is None else mech.t
    parameters = [f.symbol for f in scene.parameters or ()]
    defaults = [ca.DM(f.default) for f in scene.parameters or ()]
    others = [f.symbol for f in fields]
    arguments = [mech.q, mech.u, t, *others, *parameters]
    plant = ca.Function("plant", arguments, [mech.q_dot, mech.Q, mech.P, mech.G])
    moving = moving_references(scene, simulation, t)
    course = ca.Function("course", [t], list(moving.values()))
    nq, nu = mech.q.size1(), mech.u.size1()
    advances = bool(optimised_scene(scene)[0].law.advanced())  # the answer is tau', and tau a state

    evaluations = 0

    def rate(now: float, x: FloatArray) -> FloatArray:
        nonlocal evaluations
        evaluations += 1
        if evaluations > MOST_EVALUATIONS:
            raise NotSmooth(
                f"the textbook reference under DOP853 came to t = {now:.3g} s of {duration:.3g} s in "
                f"{evaluations - 1:,} evaluations: tau jumps along this run, so there is nothing exact to compare with"
            )
        q, u = x[:nq], x[nq : nq + nu]
        moved = course.call([ca.DM(now)])
        held = given | {n: np.array(v).ravel() for n, v in zip(moving, moved, strict=True)}
        inputs = {"q": q, "u": u, "t": now, **held} | ({"tau": x[nq + nu :]} if advances else {})
        answer = twin.control(**inputs).value
        tau = x[nq + nu :] if advances else answer
        q_dot, Q, P, G = (
            np.array(v, dtype=float) for v in plant.call([q, u, now, *(held[f.name] for f in fields), *defaults])
        )
        u_dot = np.linalg.solve(Q, P.ravel() + G @ tau)
        return np.concatenate([q_dot.ravel(), u_dot, *([answer] if advances else [])])

    x0 = np.concatenate([start.q[0], start.u[0], *([start.tau[0]] if advances else [])]).astype(float)
    with np.errstate(all="ignore"):  # trial steps may go anywhere
        done = solve_ivp(rate, (0.0, duration), x0, method="DOP853", rtol=1e-12, atol=1e-14)
    end: FloatArray = done.y[: nq + nu, -1]
    return end


def measure(
    scene: Scene,
    simulation: Simulation,
    duration: float,
    steps: Sequence[float],
    scalars: Sequence[Scalar] = tuple(EPSILON),
) -> tuple[MethodRun, ...]:
    """Every step size with every method and scalar, of the model's own loop: a machine's flaws have no exact solution.

    Runs that end early are left out. Raises NotSmooth.
    """
    simulation = replace(simulation, **_NO_FLAWS)
    loops = {scalar: ClosedLoop(scene, simulation, scalar) for scalar in scalars}
    first = next(iter(loops.values())).run(duration=duration, step=duration)
    end = tight_end(scene, simulation, duration, first)
    found = []
    for scalar, loop in loops.items():
        for method in METHODS:
            for step in steps:
                runs = []
                for _ in range(3):
                    run = loop.run(duration=duration, step=step, method=method)
                    runs.append(run.seconds)
                if run.stop.reason == "finished":
                    last = np.concatenate([run.q[-1], run.u[-1]]).astype(float)
                    found.append(MethodRun(scalar, method, run.step, min(runs), float(np.max(np.abs(last - end)))))
    return tuple(found)


def draw_methods(scene: str, duration: float, found: Sequence[MethodRun], stem: Path) -> Path:
    """Run time against error, both logarithmic; one curve a method and scalar. Returns the PNG."""
    figure = methods_figure(duration, found, (7.2, 4.2), 11)
    figure.suptitle(f"{scene}: closed loop, run time against error", fontsize=11, x=0.02, ha="left")
    file = stem.with_suffix(".png")
    with matplotlib.rc_context({"svg.hashsalt": "servogen"}):
        figure.savefig(file, dpi=160, metadata={"Software": None})
        figure.savefig(stem.with_suffix(".svg"), metadata={"Date": None, "Creator": None})
    return file


def methods_figure(
    duration: float, found: Sequence[MethodRun], size: tuple[float, float] = (4.0, 3.2), font: float = 9
) -> Figure:
    """The curves of draw_methods without a title; size in inches, font in points."""
    marks = {"rk4": "o", "dop8": "s"}
    colours = {"float64": "#0072B2", "float32": "#D55E00"}
    with matplotlib.rc_context({"font.size": font, "legend.frameon": False}):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        axis = figure.subplots()
        for scalar, method in dict.fromkeys((p.scalar, p.method) for p in found):
            points = [p for p in found if (p.scalar, p.method) == (scalar, method)]
            axis.loglog([p.error for p in points], [1e3 * p.seconds for p in points], marks[method] + "-",
                        color=colours[scalar], fillstyle="full" if method == "rk4" else "none",
                        label=f"{METHOD_NAMES[method]}, {scalar}")  # fmt: skip
        axis.set_xlabel(f"largest error of q and u at {duration:g} s")
        axis.set_ylabel("run time [ms]")
        axis.grid(True, which="major", color="#dddddd")
        axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize=font - 1, borderaxespad=0.2)
    return figure
