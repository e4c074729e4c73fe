"""The closed loop with MuJoCo's physics as its plant: a machine that nobody here wrote, from an MJCF or URDF file."""

import ctypes as ct
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

import casadi as ca
import numpy as np

from servogen.errors import SceneError
from servogen.mjcf.library import mujoco_module
from servogen.results import FloatArray
from servogen.scalars import Scalar
from servogen.scene.domain import draw_states
from servogen.scene.mechanism import Mechanism
from servogen.scene.scene import Scene
from servogen.simulate.board import Setup
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.simulation import Simulation, known_symbols
from servogen.simulate.trajectory import Trajectory
from servogen.twins.compiled import c_real

SAME = 1e-9
"""Two models agree where they differ by less, relative to the largest entry."""

_COMPARED = 16  # states of the domain


class MujocoLoop(ClosedLoop):
    """A scene's generated controller, and MuJoCo in the place of its plant; the loop between them is the generated one.

    model: path of an MJCF or URDF file. The controller samples (one tick a row unless `hold` says otherwise), and its
    torques G tau act on the joints in between (qfrc_applied). Sensors, delay and actuators are the simulation's, as
    with the generated plant. Joints go by the names of q (a robot of sg.urdf has its joints' names), or by their order
    where the model has none of these names; those the scene does not have are locked at zero. A URDF's geometry is
    left out, and RK4 integrates it; an MJCF file keeps its geometry and its <option>, but for a timestep that must
    divide the time between two torques.
    plant: the model. differences: what is other in it than in the scene's mechanism, and what was done to it, in lines.
    Raises SceneError for a model that does not fit the scene, ToolMissing without the Python package mujoco.
    """

    def __init__(
        self, scene: Scene, simulation: Simulation | None, model: str | Path, scalar: Scalar = "float64"
    ) -> None:
        simulation = simulation or Simulation()
        if isinstance(simulation.plant, Mechanism) or simulation.plant or simulation.disturbance:
            raise SceneError(
                "MuJoCo's model is the plant: leave out plant and disturbance, and write them into the model"
            )
        self.plant = load_plant(scene, Path(model))
        super().__init__(scene, simulation, scalar)
        self.differences = (*self.plant.remarks, *compare(scene, self.plant))
        fields = [*scene.input_fields(), *scene.parameters]
        if ca.depends_on(ca.densify(scene.mechanism.G), ca.vertcat(*(f.symbol for f in fields if f.name not in "qu"))):
            raise SceneError("MuJoCo in the place of the plant takes a G of q and u alone; this one depends on more")
        self._G = ca.Function("G", [scene.mechanism.q, scene.mechanism.u], [ca.densify(scene.mechanism.G)])

    def run(self, **options: Any) -> Trajectory:
        """As ClosedLoop.run, with a controller that samples; integrated as the model's file says."""
        if options.get("method") is not None:
            raise SceneError("method: MuJoCo integrates as its model says (<option integrator>); leave it out")
        if options.get("plant"):
            raise SceneError("MuJoCo's model is the plant: write its parameters into the model")
        hold = options.get("hold") or self.simulation.hold or True
        self._broke: Exception | None = None
        found = super().run(**options | {"hold": hold, "method": None})
        if self._broke is not None:
            raise self._broke
        return replace(found, method="mujoco")

    def runs(self, *_: Any, **__: Any) -> NoReturn:
        """Not with MuJoCo: one simulator is not many, and its steps are no C of ours."""
        raise SceneError("many runs are of the generated plant; leave out MuJoCo, or run it once for each seed")

    def _physics(self, setup: Setup) -> Any:
        """MuJoCo's steps as a C function that the generated loop calls."""
        arrays, world = setup.arrays, self.plant
        world.start(setup.reals["step"] / setup.numbers["substeps"], *(arrays[x].astype(float) for x in ("q", "u")))
        real = c_real(self.scalar)
        constant = np.array(self._G(0, 0)) if self.scene.mechanism.G.is_constant() else None

        def advance(_: Any, h: float, tau: Any, x: Any) -> int:
            try:
                q, u = world.state()
                G = np.array(self._G(q, u)) if constant is None else constant
                world.advance(G @ np.ctypeslib.as_array(tau, (len(arrays["tau"]),)).astype(float))
                state = np.concatenate(world.state())
                np.ctypeslib.as_array(x, (len(state),))[:] = state
                return int(world.failed() or not np.all(np.isfinite(state)))
            except Exception as error:  # a C function cannot raise; run does
                self._broke = error
                return 1

        self._called = ct.CFUNCTYPE(ct.c_int, ct.c_void_p, real, ct.POINTER(real), ct.POINTER(real))(advance)
        return ct.cast(self._called, ct.c_void_p)


@dataclass(eq=False)
class MujocoPlant:
    """A MuJoCo model whose joints are the scene's q, in its order. places, dofs: of qpos and qvel."""

    mujoco: ModuleType
    model: Any
    data: Any
    places: FloatArray
    dofs: FloatArray
    remarks: tuple[str, ...]
    substeps: int = 1

    def start(self, step: float, q: FloatArray, u: FloatArray) -> None:
        """At rest in the file's way, then at q and u; step: between two torques, in seconds."""
        self.substeps = max(1, int(np.ceil(step / self.model.opt.timestep * (1 - 1e-9))))
        self.model.opt.timestep = step / self.substeps
        self.mujoco.mj_resetData(self.model, self.data)
        self.put(q, u)

    def put(self, q: FloatArray, u: FloatArray) -> None:
        """Another state, and everything computed there."""
        self.data.qpos[self.places], self.data.qvel[self.dofs] = q, u
        self.mujoco.mj_forward(self.model, self.data)

    def state(self) -> tuple[FloatArray, FloatArray]:
        return self.data.qpos[self.places].copy(), self.data.qvel[self.dofs].copy()

    def advance(self, force: FloatArray) -> None:
        """One step under joint forces (in the order of q) that are held."""
        self.data.qfrc_applied[self.dofs] = force
        for _ in range(self.substeps):
            self.mujoco.mj_step(self.model, self.data)

    def failed(self) -> bool:
        """Whether MuJoCo met numbers that are not finite, or too large, and started anew."""
        kinds = self.mujoco.mjtWarning
        bad = (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)
        return any(self.data.warning[kind].number > 0 for kind in bad)

    def mass_matrix(self) -> FloatArray:
        """At the present state, in the order of q."""
        nv = self.model.nv
        M = np.zeros((nv, nv))
        for k, unit in enumerate(np.eye(nv)):
            self.mujoco.mj_mulM(self.model, self.data, M[k], unit)
        return np.asarray(M[np.ix_(self.dofs, self.dofs)])


def load_plant(scene: Scene, path: Path) -> MujocoPlant:
    """The model in an MJCF or URDF file, for a scene whose q are hinge and slide joints."""
    mujoco = mujoco_module()
    mech = scene.mechanism
    if mech.C is not None or mech.D is not None:
        raise SceneError(
            f"scene {scene.name!r} has a C or D; MuJoCo takes the plant's place where q' = u, joint by joint"
        )
    try:
        is_urdf = ET.parse(path).getroot().tag == "robot"
        spec = mujoco.MjSpec.from_file(str(path))
    except OSError as error:
        raise SceneError(f"{path}: {error.strerror or error}; give an MJCF or URDF file") from None
    except (ET.ParseError, ValueError) as error:
        raise SceneError(f"{path} is no model for MuJoCo: {error}") from None
    remarks = _only_mechanics(spec) if is_urdf else []
    names = [s.name() for s in mech.q.nonzeros()]
    taken, said = _take_joints(mujoco, spec, names, path)
    try:
        model = spec.compile()
    except ValueError as error:
        raise SceneError(f"{path} is no model for MuJoCo: {error}") from None
    if is_urdf:
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    if model.nu:
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ACTUATION
        remarks.append(f"its {model.nu} actuators are switched off: the controller's torques act on the joints")
    joints = [model.joint(name).id for name in taken]
    places, dofs = (np.array(of)[joints].astype(int) for of in (model.jnt_qposadr, model.jnt_dofadr))
    return MujocoPlant(mujoco, model, mujoco.MjData(model), places, dofs, (*remarks, *said))


def _only_mechanics(spec: Any) -> list[str]:
    """A URDF without its geometry, which needs files of meshes; links that do not move keep their names."""
    spec.compiler.fusestatic = False
    shapes = [*spec.geoms, *spec.meshes]
    for shape in shapes:
        spec.delete(shape)
    return ["the URDF's geometry is left out: nothing collides"] if shapes else []


def _take_joints(mujoco: ModuleType, spec: Any, names: Sequence[str], path: Path) -> tuple[list[str], list[str]]:
    """The model's joints in the order of q, and what is to be said; the others are taken out of the model."""
    there = {joint.name: joint for joint in spec.joints}
    missing = [name for name in names if name not in there]
    said = []
    if len(missing) == len(names):
        taken = list(there)
        if len(taken) != len(names):
            raise SceneError(
                f"{path} has {len(taken)} joints ({', '.join(taken)}) and the scene {len(names)}, of other names "
                f"({', '.join(names)}); name the symbols of q as the joints"
            )
        pairs = ", ".join(f"{name} = {joint}" for name, joint in zip(names, taken, strict=True))
        said.append(f"joints are taken in their order, for none is named as in the scene: {pairs}")
    elif missing:
        raise SceneError(f"{path} has no joint {', '.join(missing)}; there are {', '.join(there)}")
    else:
        taken = list(names)
    smooth = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    for name in taken:
        if there[name].type not in smooth:
            raise SceneError(f"{path}: joint {name!r} is a ball or free joint; the plant's are hinges and slides")
    locked = [name for name in there if name not in taken]
    bound = [e for e in spec.equalities if {e.name1, e.name2} & set(locked)]
    bound += [a for a in spec.actuators if a.target in locked]
    bound += list(spec.keys) if locked else []  # a keyframe has a number for each joint
    for element in (*bound, *(there[name] for name in locked)):
        spec.delete(element)
    return taken, [*said, *([f"locked at zero, for the scene has them not: {', '.join(locked)}"] if locked else [])]


def compare(scene: Scene, plant: MujocoPlant) -> tuple[str, ...]:
    """How the file's model differs from the scene's at states of the domain, and why it may."""
    gaps = disagreement(scene, plant)
    lines = [_told(what, gap) for what, gap in gaps.items()]
    model, dofs = plant.model, plant.dofs
    for what, values in (
        ("joint damping, N m s/rad or N s/m", model.dof_damping[dofs].ravel()),
        ("armature, kg m^2 or kg", model.dof_armature[dofs]),
        ("dry friction, N m or N", model.dof_frictionloss[dofs]),
        ("joint springs, N m/rad or N/m", model.jnt_stiffness[model.dof_jntid[dofs]].ravel()),
    ):
        if np.any(values):
            lines.append(f"it adds {what}: {', '.join(f'{v:g}' for v in values)}")
    limited = model.jnt_limited[model.dof_jntid[dofs]]
    if np.any(limited):
        lines.append(f"it stops {int(np.sum(limited))} of {len(dofs)} joints at their limits")
    if model.ngeom and not model.opt.disableflags & plant.mujoco.mjtDisableBit.mjDSBL_CONTACT:
        lines.append(f"it has {model.ngeom} shapes, which may touch each other")
    return tuple(lines)


def _told(what: str, gap: float) -> str:
    return f"{what}: {f'the same to {gap:.1g}' if gap <= SAME else f'DIFFERS by {gap:.2g}'} of the largest entry"


def disagreement(scene: Scene, plant: MujocoPlant) -> dict[str, float]:
    """Largest differences at states of the domain, relative to the largest entry, parameters at their defaults.

    "mass matrix" (MuJoCo's armature included), "bias forces" (gravity, Coriolis), and "frame <name>" for the frames of
    a robot that the scene's constraints use: position and rotation.
    """
    mech = scene.mechanism
    symbols = known_symbols(scene)
    frames = {} if mech.known_rates is None else mech.known_rates.frames
    bodies = {plant.model.body(k).name for k in range(plant.model.nbody)}
    shown = {n: at for n, at in frames.items() if n in bodies}
    parts = [ca.densify(mech.Q), ca.densify(mech.P), *(ca.densify(ca.horzcat(*at)) for at in shown.values())]
    function = ca.Function("parts", [s for _, s in symbols], parts)
    states = draw_states(scene, _COMPARED) | {f.name: np.tile(f.default, (_COMPARED, 1)) for f in scene.parameters}
    states.setdefault("tau", np.zeros((_COMPARED, scene.controls)))
    ours: dict[str, list[FloatArray]] = {}
    theirs: dict[str, list[FloatArray]] = {}
    for k in range(_COMPARED):
        Q, P, *placed = (np.array(v) for v in function(*(ca.DM(states[n][k]) for n, _ in symbols)))
        plant.put(states["q"][k], states["u"][k])
        bias, passive = (f[plant.dofs] for f in (plant.data.qfrc_bias, plant.data.qfrc_passive))
        P = P.ravel()
        with_passive = np.max(np.abs(P + bias - passive)) < np.max(np.abs(P + bias))
        rows = [
            ("mass matrix", Q, plant.mass_matrix()),
            ("bias forces", -P, bias - passive if with_passive else bias),
        ]
        for (name, _), at in zip(shown.items(), placed, strict=True):
            body = plant.data.body(name)
            rows.append((f"frame {name}", at, np.column_stack([body.xpos, body.xmat.reshape(3, 3)])))
        for name, a, b in rows:
            ours.setdefault(name, []).append(a)
            theirs.setdefault(name, []).append(b)
    return {n: _gap(np.array(ours[n]), np.array(theirs[n])) for n in ours}


def _gap(ours: FloatArray, theirs: FloatArray) -> float:
    largest = float(np.max(np.abs(ours)))
    gap = float(np.max(np.abs(ours - theirs)))
    return gap / largest if largest else gap
