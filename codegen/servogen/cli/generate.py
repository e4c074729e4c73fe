"""servogen list, generate, solver: what there is, and C out of it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

import click

from servogen.cli.console import emit_json, json_option, out, table
from servogen.compiler import build, build_plant, build_solver
from servogen.errors import SceneError
from servogen.fmu.unit import build_fmu, write_fmu
from servogen.loading import builtin_names, load_scene, scene_summary
from servogen.package import Package
from servogen.plan.mathematics import Math
from servogen.plan.module import mix_of
from servogen.scalars import EPSILON, Scalar
from servogen.scene.scene import Scene
from servogen.scene.solver import Method, Solver
from servogen.scene.system import System
from servogen.simulate.machine import plant_scene
from servogen.simulate.simulation import Simulation
from servogen.simulate.wanted import load_simulation

CORE = "servogen_core"

scalar_option = click.option(
    "--scalar", type=click.Choice(list(EPSILON)), default="float64", show_default=True, help="Number type of the C."
)
out_option = click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), help="Folder for the files; made if need be."
)
math_option = click.option(
    "--math",
    type=click.Choice(["own", "libm"]),
    default="own",
    show_default=True,
    help="Where sin, cos and sqrt come from: the package itself, the same bits everywhere (off Arm sqrt is that of "
    "<math.h>, an instruction; link -lm where the compiler calls it), or <math.h>.",
)
prefix_option = click.option("--prefix", help="Prefix of all C names; default the scene's name, and _f32 for float32.")


@click.command("list")
@json_option
def list_scenes(as_json: bool) -> None:
    """The built-in scenes."""
    scenes = {name: (load_scene(name), scene_summary(name)) for name in builtin_names()}
    if as_json:
        emit_json(
            [{"name": n, "kind": s.kind, "m": s.rows, "l": s.controls, "text": t} for n, (s, t) in scenes.items()]
        )
        return
    rows = [(n, f"{s.rows}x{s.controls}", _in_words(s.system), t) for n, (s, t) in scenes.items()]
    table("Built-in scenes", ("name", "shape", "system", "what it is"), rows)


def _in_words(system: System) -> str:
    return f"{system.matrix} {system.symbol} = {system.right}"


@click.command()
@click.argument("scenes", metavar="SCENE...", nargs=-1, required=True)
@scalar_option
@prefix_option
@math_option
@out_option
@click.option(
    "--plant",
    is_flag=True,
    help="Also the mechanism itself, q' and u', as <prefix>_plant.h and .c in ./<prefix>/plant/.",
)
@click.option(
    "--fmu",
    is_flag=True,
    help="Also <prefix>.fmu, for co-simulation by FMI 3.0, sources and binary; with --plant the plant's too.",
)
@click.option("--casadi-abi", is_flag=True, help="Also <prefix>_casadi.c, by which casadi.external calls the C.")
@click.option("--batch", is_flag=True, help="Also <prefix>_batch.h and .c: control of many states at once, by vectors.")
@click.option(
    "--core",
    is_flag=True,
    help=f"What controllers can share (info, solvers, sin, cos, sqrt) goes into ./{CORE}/, or --out DIR's, beside the "
    "packages' folders; every package generated there with --core adds what it needs.",
)
@click.option(
    "--entry-points",
    metavar="NAMES",
    help="Only these C functions, as control or S,z, with prepare and what they call; default all of the scene's.",
)
@json_option
def generate(
    scenes: tuple[str, ...],
    scalar: Scalar,
    prefix: str | None,
    math: Math,
    out: Path | None,
    plant: bool,
    fmu: bool,
    casadi_abi: bool,
    batch: bool,
    core: bool,
    entry_points: str | None,
    as_json: bool,
) -> None:
    """Generate the C of each SCENE, by default into ./<prefix>/.

    Of several scenes, and with --core, --out DIR is the folder that holds the packages' folders.
    """
    if prefix is not None and len(scenes) > 1:
        raise SceneError(f"--prefix {prefix}: one prefix cannot name {len(scenes)} packages; generate them one by one")
    if core and fmu:
        raise SceneError("--fmu: a unit brings all of its C itself; leave out --core, or generate it on its own")
    names = None if entry_points is None else [name.strip() for name in entry_points.split(",") if name.strip()]
    several = len(scenes) > 1 or core
    found = []
    for scene in scenes:
        loaded, simulation = load_simulation(scene)
        own = Path(prefix or (loaded.name if scalar == "float64" else f"{loaded.name}_f32"))
        folder = (out or Path()) / own if several else out or own
        options: dict[str, Any] = {"math": math, "casadi_abi": casadi_abi, "entry_points": names, "batch": batch}
        packages = [build(loaded, folder, scalar, prefix, core=CORE if core else None, **options)]
        if plant:
            name = f"{packages[0].prefix}_plant"
            packages.append(build_plant(loaded, folder / "plant", scalar, name, math=math))
        units = []
        if fmu:
            units.append(write_fmu(packages[0], loaded, folder, plant=False, simulation=simulation))
        if fmu and plant:
            units.append(_plant_fmu(loaded, simulation, folder / "plant", packages[1], math))
        found.append((packages, units))
    _report(found, as_json)


def _plant_fmu(scene: Scene, simulation: Simulation, folder: Path, package: Package, math: Math) -> Path:
    """The plant's unit: around the package where the simulation adds nothing to the scene's mechanism."""
    if plant_scene(scene, simulation) is scene:
        return write_fmu(package, scene, folder, plant=True, simulation=simulation)
    scalar = package.module.target.scalar
    return build_fmu(scene, folder, scalar, package.prefix, plant=True, simulation=simulation, math=math)


@click.command()
@click.argument("m", type=click.IntRange(1, 12))
@click.argument("l", type=click.IntRange(1, 12))
@click.option(
    "--method",
    type=click.Choice(get_args(Method)),
    default="auto",
    show_default=True,
    help="How S+ is computed: the cheapest step proven safe, the SVD always, or a complete orthogonal decomposition "
    "(no iteration, hence a lower worst case).",
)
@click.option("--limits", is_flag=True, help="solve takes lower and upper: least squares within them, nearest to y.")
@click.option("--batch", is_flag=True, help="Also <prefix>_batch.h and .c: solve of many systems at once, by vectors.")
@scalar_option
@prefix_option
@math_option
@out_option
@json_option
def solver(
    m: int,
    l: int,
    method: Method,
    limits: bool,
    batch: bool,
    scalar: Scalar,
    prefix: str | None,
    math: Math,
    out: Path | None,
    as_json: bool,
) -> None:
    """Generate the pseudo-inverse of M x L matrices alone, by default into ./<prefix>/."""
    folder = out or Path(prefix or f"pinv_{m}x{l}" + ("" if scalar == "float64" else "_f32"))
    chosen = Solver(method=method)
    built = build_solver(m, l, folder, scalar, chosen, prefix=prefix, math=math, limits=limits, batch=batch)
    _report([([built], [])], as_json)


_Made = tuple[Sequence[Package], Sequence[Path]]
"""Of a scene its package, behind it the plant's if there is one, and the files of the same as FMUs."""


def _report(found: Sequence[_Made], as_json: bool) -> None:
    """What was made of each scene; in JSON a plant stands in its package, and several scenes are a list."""
    if as_json:
        told = [_in_json(*made) for made in found]
        emit_json(told if len(told) > 1 else told[0])
        return
    for packages, units in found:
        for package in packages:
            _show(package)
        for unit in units:
            out.print(f"  wrote    {unit}", markup=False, soft_wrap=True)


def _in_json(packages: Sequence[Package], units: Sequence[Path]) -> dict[str, Any]:
    told: list[dict[str, Any]] = [{"path": p.path, "manifest": p.manifest} for p in packages]
    for entry, unit in zip(told, units, strict=False):
        entry["fmu"] = unit
    told[0] |= {} if packages[0].core is None else {"core": packages[0].core}
    return told[0] | ({"plant": told[1]} if len(told) > 1 else {})


def _show(package: Package) -> None:
    rows = [_row(package, name, point) for name, point in package.manifest["entry_points"].items()]
    table(
        f"{package.prefix} ({package.module.target.scalar}): C functions, and operations of the scene's own code",
        ("function", "operations", "of these"),
        rows,
        right=(1,),
    )
    for reason in package.manifest["entry_points"].get("control", {}).get("skipped", []):
        out.print(f"  skipped  {reason}", markup=False)
    for file in sorted([*package.manifest["files"], "manifest.json"]):
        out.print(f"  wrote    {package.path / file}", markup=False, soft_wrap=True)
    for file in sorted(package.core.iterdir()) if package.core is not None else ():
        out.print(f"  shared   {file}", markup=False, soft_wrap=True)


def _row(package: Package, name: str, point: dict[str, Any]) -> tuple[object, ...]:
    counts = point["operations"]
    copied = any(e.name == name for e in package.module.entry_points)
    none = "none: inputs and constants as they are" if copied else "the solver alone"
    return f"{package.prefix}_{name}", counts["total"] or "", mix_of(counts) or none
