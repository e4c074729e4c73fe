"""Scene -> <identifier>.fmu, of the controller or of the plant: the generated C in a shell of FMI 3.0."""

import hashlib
import platform
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from servogen.compiler import build, build_plant
from servogen.errors import SceneError
from servogen.fmu.description import build_description, model_description
from servogen.fmu.variables import C_TYPES, Variable, add_controller, add_plant, interface
from servogen.package import Package
from servogen.plan.mathematics import Math
from servogen.render.fold import folded
from servogen.render.render import environment
from servogen.render.solver_context import statuses
from servogen.results import FloatArray
from servogen.scalars import Scalar
from servogen.scene.scene import Scene, check_scene
from servogen.simulate.machine import HOLD_SUBSTEPS, plant_scene
from servogen.simulate.manifold import closed_start
from servogen.simulate.simulation import METHODS, Simulation, check_simulation, run_takes, start_values
from servogen.tools import firmware_sim
from servogen.twins.compiled import build_library
from servogen.version import VERSION

_ALL_TYPES = ("Float32", "Float64", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64", "Boolean")


def build_fmu(
    scene: Scene,
    out: str | Path,
    scalar: Scalar = "float64",
    prefix: str | None = None,
    *,
    plant: bool = False,
    simulation: Simulation | None = None,
    math: Math = "own",
    binary: bool = True,
    compiler: str | None = None,
) -> Path:
    """A Functional Mock-up Unit of FMI 3.0 for co-simulation, with C sources and a binary of this platform: its file.

    out: a folder, made if need be, for <prefix>.fmu; scalar, prefix (also the model identifier) and math as for
    sg.build, for the plant with <scene>_plant as default prefix.

    The controller computes tau from its inputs as they are at the start of a communication step and holds it; with
    the parameter settings.hold (seconds) it has a tick only so often. Outputs: tau, psi or phi, status, rank and the
    rest of info. The plant (plant=True) integrates Eqs. (1)-(2) over a step, tau held, with the integrator of
    `servogen simulate`; its outputs are q and u. Both together take the steps of that command's run with a hold.

    simulation: what starts, the plant's own parameters, another mechanism and disturbances come from; sensors,
    actuators and delays are the co-simulation's. binary=False: sources alone. compiler: default $CC, else cc.
    Raises SceneError for anything wrong with scene, simulation or out, ToolMissing without a C compiler.
    """
    check_scene(scene, "sg.build_fmu")
    simulation = simulation or Simulation()
    check_simulation(scene, simulation)
    with tempfile.TemporaryDirectory(prefix="servogen-fmu-") as folder:
        if plant:
            package = build_plant(plant_scene(scene, simulation), folder, scalar, prefix, math=math)
        else:
            package = build(scene, folder, scalar, prefix, math=math)
        return write_fmu(package, scene, out, plant=plant, simulation=simulation, binary=binary, compiler=compiler)


def write_fmu(
    package: Package,
    scene: Scene,
    out: str | Path,
    *,
    plant: bool,
    simulation: Simulation,
    binary: bool = True,
    compiler: str | None = None,
) -> Path:
    """The unit around a package: the scene's controller, or its plant. The rest as for build_fmu."""
    check_simulation(scene, simulation)
    unit = _plant_unit(package, scene, simulation) if plant else _controller_unit(package, scene, simulation)
    files = {f"sources/{name}": text for name, text in unit.sources().items()}
    files["modelDescription.xml"] = unit.description().encode()
    if binary:
        files[f"binaries/{_platform()}/{unit.identifier}{_suffix()}"] = unit.compiled(compiler)
    return _zipped(files, Path(out), unit.identifier)


@dataclass(frozen=True, eq=False)
class _Unit:
    package: Package
    title: str
    body: str
    variables: tuple[Variable, ...]
    numbers: Mapping[str, Any]
    experiment: dict[str, str]

    @property
    def identifier(self) -> str:
        return self.package.prefix

    @property
    def token(self) -> str:
        """Of all that an importer relies on: the variables, and the scene."""
        told = repr((self.package.manifest, self.variables, VERSION))
        return f"{{{hashlib.sha256(told.encode()).hexdigest()[:32]}}}"

    def description(self) -> str:
        return model_description(self.identifier, self.title, self.token, self.variables, METHODS, self.experiment)

    def code(self) -> str:
        types = [(t, c) for t, c in C_TYPES.items() if any(v.type == t for v in self.variables)]
        context = self.package.module.context() | {
            "identifier": self.identifier,
            "title": self.title,
            "version": VERSION,
            "token": self.token,
            "body": self.body,
            "plant": self.body == "plant",
            "variables": self.variables,
            "types": types,
            "absent_types": [t for t in _ALL_TYPES if t not in dict(types)],
            "names": [f.name for f in self.package.module.inputs],
            **self.numbers,
        }
        return folded(environment("fmu").get_template("fmu.c.j2").render(context))

    def hand_written(self) -> dict[str, Path]:
        """Files that are the same in every unit."""
        headers = Path(__file__).parent / "headers"
        found = {f.name: f for f in headers.glob("*.h")}
        if self.body == "plant":
            folder = firmware_sim()
            found |= {"loop.c": folder / "simulate/loop.c", "loop.h": folder / "simulate/loop.h"}
            found |= {"scalar.h": folder / "harness/scalar.h"}
        return found

    def definitions(self) -> dict[str, str]:
        bits = "64" if self.package.module.target.scalar == "float64" else "32"
        return {"SERVOGEN_SCALAR_BITS": bits} if self.body == "plant" else {}

    def sources(self) -> dict[str, bytes]:
        """The folder `sources` by file name."""
        names = [f"{self.identifier}.c", f"{self.identifier}.h"]
        files = {name: (self.package.path / name).read_bytes() for name in names}
        files |= {name: file.read_bytes() for name, file in self.hand_written().items()}
        files[f"{self.identifier}_fmu.c"] = self.code().encode()
        compiled = sorted(name for name in files if name.endswith(".c"))
        files["buildDescription.xml"] = build_description(self.identifier, compiled, self.definitions()).encode()
        return files

    def compiled(self, compiler: str | None) -> bytes:
        """The shared library for this machine."""
        with tempfile.TemporaryDirectory(prefix="servogen-fmu-") as folder:
            for name, content in self.sources().items():
                (Path(folder) / name).write_bytes(content)
            more = [str(Path(folder) / n) for n in self.sources() if n.endswith(".c") and n != f"{self.identifier}.c"]
            defined = [f"-D{name}={value}" for name, value in self.definitions().items()]
            flags = ("-O2", "-fvisibility=hidden", "-DFMI3_OVERRIDE_FUNCTION_PREFIX", *defined, f"-I{folder}", *more)
            return build_library(self.package, Path(folder), compiler, flags).read_bytes()


def _controller_unit(package: Package, scene: Scene, simulation: Simulation) -> _Unit:
    system, module = scene.system, package.module
    offered = {e.name for e in module.entry_points} | {r.name for r in module.law.routines}
    needs = ("control", system.constraint, *(f.name for f in system.functions if f.controls))
    missing = [name for name in needs if name not in offered]
    if missing:
        raise SceneError(f"an FMU calls {', '.join(needs)}; entry_points leave out {', '.join(missing)}")
    starts = _starts(scene, simulation)
    first = starts.pop("tau")
    found = interface(package, starts, {f.name: f.default for f in module.parameters})
    advances = bool(module.law.advanced())
    there = statuses(scene.limits is not None, bool(scene.mechanism.passive))
    said = ", ".join(f"{number} {name}" for name, number, _ in there)
    add_controller(found, scene.controls, system.constraint, scene.rows, first if advances else None, said)
    numbers = {
        "l": scene.controls,
        "m": scene.rows,
        "constraint": system.constraint,
        "advances": advances,
    }
    title = f"controller of scene {scene.name}"
    return _Unit(package, title, "controller", tuple(found.all), numbers, _experiment(simulation))


def _starts(scene: Scene, simulation: Simulation) -> dict[str, tuple[float, ...]]:
    """Every input at the start, which is brought onto the plant's passive constraints as that of a simulation is."""
    given = start_values(scene, simulation)
    given |= closed_start(plant_scene(scene, simulation), given, _plant_parameters(scene, simulation))
    return {n: _numbers(v) for n, v in given.items() if n != "t"}


def _plant_parameters(scene: Scene, simulation: Simulation) -> dict[str, FloatArray]:
    sizes = run_takes(scene)["parameters"]
    own = simulation.plant if isinstance(simulation.plant, Mapping) else {}
    defaults = {f.name: np.asarray(f.default, float) for f in scene.parameters}
    return defaults | {n: np.broadcast_to(np.asarray(v, float), (sizes[n],)) for n, v in own.items()}


def _plant_unit(package: Package, scene: Scene, simulation: Simulation) -> _Unit:
    starts = _starts(scene, simulation)
    q, u = starts.pop("q"), starts.pop("u")
    own = _plant_parameters(scene, simulation)
    found = interface(package, starts, {f.name: _numbers(own[f.name]) for f in package.module.parameters})
    add_plant(found, q, u, METHODS, simulation.method, HOLD_SUBSTEPS)
    numbers = {"nq": len(q), "nu": len(u), "states": len(q) + len(u)}
    title = f"mechanism of scene {scene.name}"
    return _Unit(package, title, "plant", tuple(found.all), numbers, _experiment(simulation))


def _experiment(simulation: Simulation) -> dict[str, str]:
    step = simulation.step if simulation.hold is None else simulation.hold
    return {"startTime": "0.0", "stopTime": repr(float(simulation.duration)), "stepSize": repr(float(step))}


def _numbers(values: Any) -> tuple[float, ...]:
    return tuple(float(x) for x in np.atleast_1d(values).ravel())


def _platform() -> str:
    """The name of this machine's folder in `binaries`."""
    machine = platform.machine().lower()
    architecture = {
        "amd64": "x86_64",
        "x86_64": "x86_64",
        "arm64": "aarch64",
        "aarch64": "aarch64",
        "i386": "x86",
        "i686": "x86",
    }
    system = {"win32": "windows", "darwin": "darwin"}.get(sys.platform, sys.platform)
    return f"{architecture.get(machine, machine)}-{system}"


def _suffix() -> str:
    return {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")


def _zipped(files: dict[str, bytes], out: Path, identifier: str) -> Path:
    """<out>/<identifier>.fmu; the same files make the same bytes."""
    file = out / f"{identifier}.fmu"
    try:
        out.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise SceneError(f"out: {out} is a file, or lies below one; give a folder for {file.name}") from None
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(files):
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            entry.external_attr = (0o755 if name.startswith("binaries/") else 0o644) << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, files[name])
    return file
