"""From a path to MuJoCo's compiled model, read and compiled by MuJoCo itself, without what mechanics never need."""

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

from servogen.errors import SceneError


@dataclass(frozen=True, eq=False)
class Compiled:
    """source: the file's name. model: MuJoCo's. notes: what of the file is left out though it acts on the motion."""

    source: str
    model: Any
    notes: tuple[str, ...]


def compiled_model(mujoco: ModuleType, path: str | Path) -> Compiled:
    """What a file describes. SceneError for whatever MuJoCo does not read, with its words, and for equalities other
    than connect, weld and joint.

    Shapes of bodies that have an <inertial>, materials, sensors and the like are taken out before it is compiled, so
    that a mesh or picture that is not there stops no load.
    """
    file = _file(path)
    try:
        spec = mujoco.MjSpec.from_file(str(file))
        notes = [*_equalities(mujoco, spec, file.name), *_unheard(spec)]
        _leave_mechanics(mujoco, spec)
        return Compiled(file.name, spec.compile(), tuple(notes))
    except SceneError:
        raise
    except (ValueError, mujoco.FatalError) as error:
        words = " ".join(str(error).split())
        raise SceneError(f"{file.name}: MuJoCo does not read it: {words}; correct the file") from error


def _file(path: str | Path) -> Path:
    if isinstance(path, str) and ("<" in path or "\n" in path):
        raise SceneError("path is text of XML; write it to a file, and give the path of that")
    if not isinstance(path, str | Path):
        raise SceneError(f"path is of type {type(path).__name__}; give the path of an MJCF file")
    file = Path(path)
    try:
        if not file.is_file():
            raise SceneError(f"no MJCF file at {str(path)[:200]!r}; give the path of one")
        text = file.read_bytes()
    except SceneError:
        raise
    except (OSError, ValueError) as error:  # a name too long, no permission, a zero byte
        raise SceneError(f"cannot read {str(path)[:200]!r}: {error}; give the path of an MJCF file") from error
    if b"<robot" in text and b"<mujoco" not in text.partition(b"<robot")[0]:
        raise SceneError(f"{file.name} is a URDF file; load it with sg.urdf.load")
    return file


def _equalities(mujoco: ModuleType, spec: Any, source: str) -> list[str]:
    """Takes out those that are switched off, and says so; SceneError for kinds that are no constraint here."""
    kinds, notes = mujoco.mjtEq, []
    switched_off = spec.option.disableflags & int(mujoco.mjtDisableBit.mjDSBL_EQUALITY)
    for k, equality in enumerate(list(spec.equalities)):
        what = f"equality {equality.name or k + 1!r}"
        if switched_off or not equality.active:
            notes.append(f"{what} is not active and left out")
            spec.delete(equality)
        elif equality.type not in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD, kinds.mjEQ_JOINT):
            kind = kinds(equality.type).name.removeprefix("mjEQ_").lower()
            raise SceneError(
                f"{source}: {what} is of type {kind}, which is not supported (connect, weld and joint are); write it "
                'as an sg.PassiveHolonomic, and set active="false" in the file'
            )
    return notes


def _unheard(spec: Any) -> list[str]:
    """What acts on the motion in MuJoCo, and not here."""
    notes = []
    if spec.tendons:
        notes.append(f"{len(spec.tendons)} tendon(s) are left out, with their springs and dampers")
    floating_off = [body.name for body in spec.bodies if body.gravcomp]
    if floating_off:
        notes.append(f"gravcomp of {', '.join(floating_off)} is left out: they weigh in full")
    if spec.option.density or spec.option.viscosity:
        notes.append("forces of the medium (density, viscosity) are left out")
    if spec.flexes or any(body.plugin.active for body in spec.bodies):
        notes.append("flexible bodies and plugins are left out")
    return notes


def _leave_mechanics(mujoco: ModuleType, spec: Any) -> None:
    """Leaves bodies, joints, sites, equalities, and those shapes whose mass a body's inertia is made of."""
    shaped = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    unused = [*spec.sensors, *spec.actuators, *spec.keys, *spec.pairs, *spec.excludes, *spec.tendons, *spec.cameras]
    unused += [*spec.lights, *spec.skins, *spec.tuples, *spec.worldbody.geoms]
    for body in spec.bodies[1:]:
        unused += body.geoms if body.explicitinertial and not shaped else []
    for element in unused:
        spec.delete(element)
    for geom in spec.geoms:
        geom.material = ""
    needed = {geom.meshname for geom in spec.geoms}
    for element in (*spec.materials, *spec.textures, *(m for m in spec.meshes if m.name not in needed)):
        spec.delete(element)
