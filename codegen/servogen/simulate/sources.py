"""Scene -> the C of its closed loop: controller, plant, stop expressions, and the loop that calls them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca

from servogen.compiler import build, build_plant, compile_functions, target_for
from servogen.derive.formulation import MassTreatment, Quantity
from servogen.package import Package, write
from servogen.plan.module import Module, StructField
from servogen.render.render import environment, render
from servogen.scene.scene import Scene
from servogen.scene.solver import Scalar
from servogen.simulate.simulation import Simulation
from servogen.verify.harness import firmware_sim
from servogen.version import VERSION


@dataclass(frozen=True, eq=False)
class LoopSources:
    """Everything that is compiled: the packages, and the folder of <prefix>_loop.[ch].

    watch: the stop expressions; course: the references that move.
    given: the inputs that are constant over a run (y and references) in the order of the C.
    """

    controller: Package
    plant: Package
    watch: Package | None
    course: Package | None
    folder: Path
    given: tuple[StructField, ...]

    @property
    def include_folders(self) -> tuple[Path, ...]:
        packages = [p.path for p in (self.plant, self.watch, self.course) if p is not None]
        return (self.folder, *packages, firmware_sim() / "harness", firmware_sim() / "simulate")

    @property
    def sources(self) -> tuple[Path, ...]:
        """C files beside the controller's."""
        packages = [p.path / f"{p.prefix}.c" for p in (self.plant, self.watch, self.course) if p is not None]
        hand_written = [firmware_sim() / "simulate" / name for name in ("loop.c", "record.c")]
        return (self.folder / f"{self.controller.prefix}_loop.c", *packages, *hand_written)


def write_loop(scene: Scene, simulation: Simulation, out: Path, scalar: Scalar) -> LoopSources:
    """Generate the closed loop into `out`, a folder for each package and one for the loop."""
    controller = build(scene, out / "controller", scalar)
    plant = build_plant(scene, out / "plant", scalar)
    watch = _build_watch(scene, simulation, out / "watch", scalar) if simulation.stop else None
    course = _build_course(scene, simulation, out / "course", scalar) if simulation.motion else None
    folder = out / "loop"
    folder.mkdir(parents=True, exist_ok=True)
    others = {"watch": watch.module if watch else None, "course": course.module if course else None}
    context = _context(scene, simulation, controller.module, plant.module, others)
    for suffix in ("h", "c"):
        text = environment().get_template(f"loop.{suffix}.j2").render(context)
        (folder / f"{controller.prefix}_loop.{suffix}").write_text(text, encoding="utf-8", newline="\n")
    return LoopSources(controller, plant, watch, course, folder, _given(scene))


def _build_watch(scene: Scene, simulation: Simulation, out: Path, scalar: Scalar) -> Package:
    """The stop expressions as one vector `stop`."""
    stop = Quantity("stop", ca.vertcat(*simulation.stop.values()), "", ", ".join(simulation.stop))
    no_mass = MassTreatment("identity", "no solve")
    module = compile_functions(scene, (stop,), no_mass, target_for(f"{scene.name}_watch", scalar, None))
    return write(render(module), out, module, scene)


def _build_course(scene: Scene, simulation: Simulation, out: Path, scalar: Scalar) -> Package:
    """The references that move as one vector `course`."""
    course = Quantity("course", ca.vertcat(*simulation.motion.values()), "", ", ".join(simulation.motion))
    module = compile_functions(
        scene, (course,), MassTreatment("identity", "no solve"), target_for(f"{scene.name}_course", scalar, None)
    )
    return write(render(module), out, module, scene)


def _moving(simulation: Simulation, given: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Where each moving reference stands in `course`, and in the given ones."""
    places = {f["name"]: f for f in given}
    moving, start = [], 0
    for name, expression in simulation.motion.items():
        moving.append({"start": start, "offset": places[name]["offset"], "size": expression.numel()})
        start += expression.numel()
    return moving


def _given(scene: Scene) -> tuple[StructField, ...]:
    varying = ("q", "u", "t", "tau")
    fields = [f for f in scene.input_fields() if f.name not in varying]
    return tuple(StructField(f.name, f.size, f.unit, f.text, f.default) for f in fields)


def _context(
    scene: Scene, simulation: Simulation, controller: Module, plant: Module, others: dict[str, Module | None]
) -> dict[str, Any]:
    mech = scene.mechanism
    nq, nu = mech.q.size1(), mech.u.size1()
    given = _with_offsets(_given(scene))
    parameters = _with_offsets(controller.parameters)
    return controller.context() | {
        "version": VERSION,
        "plant": plant,
        **others,
        "events": len(simulation.stop),
        "moving": _moving(simulation, given),
        "sigma_min": None if simulation.sigma_min is None else repr(simulation.sigma_min),
        "tau_max": None if simulation.tau_max is None else repr(simulation.tau_max),
        "servo": scene.kind != "controls",
        "constraint": "phi" if scene.kind == "controls" else "psi",
        "given": given,
        "given_count": sum(f["size"] for f in given),
        "offsets": {f["name"]: f["offset"] for f in parameters},
        "parameter_count": sum(f["size"] for f in parameters),
        "nq": nq,
        "nu": nu,
        "l": scene.controls,
        "m": scene.rows,
        "states": nq + nu + (scene.controls if scene.kind == "controls" else 0),
    }


def _with_offsets(fields: tuple[StructField, ...]) -> list[dict[str, Any]]:
    """Fields with their place in a flat array."""
    placed, offset = [], 0
    for f in fields:
        placed.append({"name": f.name, "size": f.size, "offset": offset})
        offset += f.size
    return placed
