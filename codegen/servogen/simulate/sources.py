"""Scene -> the C of its closed loop: controller, plant, stop expressions, and the loop that calls them."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca

from servogen.compiler import build, build_plant, compile_functions, target_for
from servogen.derive.formulation import MassTreatment, Quantity
from servogen.package import Package, write
from servogen.plan.module import Module, StructField
from servogen.render.render import environment, render
from servogen.scalars import Scalar
from servogen.scene.scene import Scene
from servogen.simulate.machine import plant_scene
from servogen.simulate.simulation import Simulation, moving_references
from servogen.tools import firmware_sim
from servogen.version import VERSION


@dataclass(frozen=True, eq=False)
class LoopSources:
    """Everything that is compiled: packages (watch: stop expressions; guide: moving references), <prefix>_loop.[ch].

    given: the inputs that are constant over a run (y and references) in the order of the C.
    """

    controller: Package
    plant: Package
    watch: Package | None
    guide: Package | None
    folder: Path
    given: tuple[StructField, ...]

    @property
    def include_folders(self) -> tuple[Path, ...]:
        packages = [p.path for p in (self.plant, self.watch, self.guide) if p is not None]
        return (self.folder, *packages, firmware_sim() / "harness", firmware_sim() / "simulate")

    @property
    def sources(self) -> tuple[Path, ...]:
        """C files beside the controller's, as they run on a board."""
        packages = [p.path / f"{p.prefix}.c" for p in (self.plant, self.watch, self.guide) if p is not None]
        hand_written = [firmware_sim() / "simulate" / name for name in ("loop.c", "machine.c", "record.c")]
        return (self.folder / f"{self.controller.prefix}_loop.c", *packages, *hand_written)


def host_sources(sources: LoopSources) -> tuple[Path, ...]:
    """C files beside the controller's as they run on this machine: many runs are summed up here alone."""
    return (*sources.sources, firmware_sim() / "simulate" / "summary.c")


def write_loop(scene: Scene, simulation: Simulation, out: Path, scalar: Scalar) -> LoopSources:
    """Generate the closed loop into `out`, a folder for each package and one for the loop."""
    controller = build(scene, out / "controller", scalar)
    plant = build_plant(plant_scene(scene, simulation), out / "plant", scalar)
    watch = _build_watch(scene, simulation, out / "watch", scalar) if simulation.stop else None
    guide = _build_guide(scene, simulation, out / "guide", scalar) if simulation.references else None
    folder = out / "loop"
    folder.mkdir(parents=True, exist_ok=True)
    context = _context(scene, controller.module, plant.module) | {
        "watch": watch.module if watch else None,
        "guide": guide.module if guide else None,
        "events": len(simulation.stop),
        "sigma_min": None if simulation.sigma_min is None else repr(simulation.sigma_min),
        "tau_max": None if simulation.tau_max is None else repr(simulation.tau_max),
    }
    for suffix in ("h", "c"):
        text = environment().get_template(f"loop.{suffix}.j2").render(context)
        (folder / f"{controller.prefix}_loop.{suffix}").write_text(text, encoding="utf-8", newline="\n")
    return LoopSources(controller, plant, watch, guide, folder, _given(scene))


def _build_watch(scene: Scene, simulation: Simulation, out: Path, scalar: Scalar) -> Package:
    """The stop expressions as one vector `stop`."""
    stop = Quantity("stop", ca.vertcat(*simulation.stop.values()), "", ", ".join(simulation.stop))
    no_mass = MassTreatment("identity", "no solve")
    module = compile_functions(scene, (stop,), no_mass, target_for(f"{scene.name}_watch", scalar, None))
    return write(render(module), out, module, scene)


def _build_guide(scene: Scene, simulation: Simulation, out: Path, scalar: Scalar) -> Package:
    """The references that move, as functions of t."""
    mech = scene.mechanism
    t = ca.SX.sym("t") if mech.t is None else mech.t
    moving = moving_references(scene, simulation, t)
    timed = scene if mech.t is not None else replace(scene, mechanism=replace(mech, t=t))
    quantities = tuple(Quantity(name, sx, "", f"{name}(t)") for name, sx in moving.items())
    no_mass = MassTreatment("identity", "no solve")
    module = compile_functions(timed, quantities, no_mass, target_for(f"{scene.name}_guide", scalar, None))
    return write(render(module), out, module, scene)


def _given(scene: Scene) -> tuple[StructField, ...]:
    varying = ("q", "u", "t", "tau")
    fields = [f for f in scene.input_fields() if f.name not in varying]
    return tuple(StructField(f.name, f.size, f.unit, f.text, f.default) for f in fields)


def _context(scene: Scene, controller: Module, plant: Module) -> dict[str, Any]:
    mech = scene.mechanism
    nq, nu = mech.q.size1(), mech.u.size1()
    given = _with_offsets(_given(scene))
    parameters = _with_offsets(controller.parameters)
    return controller.context() | {
        "version": VERSION,
        "plant": plant,
        "calls": f"loop_{'advances' if controller.law.advanced() else 'answers'}.c.j2",
        "constraint": scene.system.constraint,
        "given": given,
        "given_count": sum(f["size"] for f in given),
        "offsets": {f["name"]: f["offset"] for f in parameters},
        "parameter_count": sum(f["size"] for f in parameters),
        "nq": nq,
        "nu": nu,
        "l": scene.controls,
        "m": scene.rows,
    }


def _with_offsets(fields: tuple[StructField, ...]) -> list[dict[str, Any]]:
    """Fields with their place in a flat array."""
    placed, offset = [], 0
    for f in fields:
        placed.append({"name": f.name, "size": f.size, "offset": offset})
        offset += f.size
    return placed
