"""The closed loop with MuJoCo's physics as its plant: a machine that nobody here wrote, from an MJCF or URDF file."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np

from servogen.compiler import build
from servogen.errors import SceneError
from servogen.plan.module import StructField
from servogen.results import FloatArray, Info, Status
from servogen.scalars import Scalar
from servogen.scene.domain import draw_states
from servogen.scene.scene import Scene
from servogen.simulate.closed_loop import ClosedLoop, Progress
from servogen.simulate.simulation import Simulation, check_simulation, known_symbols, run_takes
from servogen.simulate.trajectory import Stop, Trajectory
from servogen.tools import ToolMissing

SAME = 1e-9
"""Two models agree where they differ by less, relative to the largest entry."""

_COMPARED = 16  # states of the domain


class MujocoLoop(ClosedLoop):
    """A scene's generated controller, and MuJoCo in the place of its plant.

    model: path of an MJCF or URDF file. The controller has one tick a step, its torques G tau act on the joints in
    between (qfrc_applied). Joints go by the names of q (a robot of sg.urdf has its joints' names), or by their order
    where the model has none of these names; those the scene does not have are locked at zero. A URDF's geometry is
    left out, and RK4 integrates it; an MJCF file keeps its geometry and its <option>, but for a timestep that must
    divide the step.
    plant: the model. differences: what is other in it than in the scene's mechanism, and what was done to it, in lines.
    Raises SceneError for a model that does not fit the scene, ToolMissing without the Python package mujoco.
    """

    def __init__(
        self, scene: Scene, simulation: Simulation | None, model: str | Path, scalar: Scalar = "float64"
    ) -> None:
        self.scene = scene
        self.simulation = simulation or Simulation()
        self.scalar = scalar
        self.target = "host"
        check_simulation(scene, self.simulation)
        self.plant = load_plant(scene, Path(model))
        self.differences = (*self.plant.remarks, *compare(scene, self.plant))
        takes = run_takes(scene)["references"]
        self._given = tuple(StructField(f.name, f.size) for f in scene.input_fields() if f.name in takes)
        self._twin: Any = build(scene, scalar=scalar).load()
        symbols = known_symbols(scene)
        stops = ca.vertcat(ca.SX(0, 1), *self.simulation.stop.values())
        self._watched = [name for name, _ in symbols]
        self._watch = ca.Function("watch", [s for _, s in symbols], [stops, ca.densify(scene.mechanism.G)])

    def run(self, **options: Any) -> Trajectory:
        """As ClosedLoop.run, with one tick a step (hold); method: none, the model's file says how it is integrated."""
        if options.get("method") is not None:
            raise SceneError("method: MuJoCo integrates as its model says (<option integrator>); leave it out")
        return replace(super().run(**options | {"hold": True, "method": None}), method="mujoco")

    def _integrate(
        self,
        inputs: dict[str, FloatArray],
        parameters: dict[str, FloatArray],
        step: float,
        steps: int,
        hold: bool,
        project: bool,
        method: int,
        progress: Progress | None,
    ) -> tuple[FloatArray, Any, Stop]:
        rows: list[FloatArray] = []
        marks: list[tuple[int, int]] = []
        self.plant.start(step, inputs["q"], inputs["u"])
        time = np.arange(steps + 1) * step
        moving = self._moving(time)
        tau, given = inputs["tau"], {f.name: inputs[f.name] for f in self._given}
        involved = self.scene.system.tau_is_state
        status = self._twin.prepare(**parameters)

        def found(stop: Stop) -> tuple[FloatArray, Any, Stop]:
            width = sum(self._sizes()) + 2
            return np.array(rows).reshape(-1, width), np.array(marks, np.int32).reshape(-1, 2), stop

        if status < 0:
            return found(Stop("controller", 0.0, "", status))
        for k, t in enumerate(time):
            q, u = self.plant.state()
            if not (np.all(np.isfinite(q)) and np.all(np.isfinite(u))) or self.plant.failed():
                return found(Stop("plant", float(time[max(k - 1, 0)]), "", Status.NONFINITE))
            state = given | {n: v[k] for n, v in moving.items()} | {"q": q, "u": u}
            if self.scene.mechanism.t is not None:
                state["t"] = np.array([t])
            if involved:
                tau, info = self._involved(k, step, project, tau, state)
                state["tau"] = tau
            else:
                control = self._twin.control(last=tau, **state)
                tau, info = control.value, control.info
            if info.status < 0:
                return found(Stop("controller", float(t), "", info.status))
            constraint = getattr(self._twin, self.scene.system.constraint)(**state)
            rows.append(np.concatenate([[t], q, u, tau, constraint, [info.sigma_min]]))
            marks.append((int(info.status), info.rank))
            values = parameters | state | {"tau": tau}
            stops, G = (np.array(v) for v in self._watch(*(values[n] for n in self._watched)))
            event = self._event(stops.ravel(), info, tau)
            if event:
                return found(Stop("event", float(t), event))
            if k == steps:
                break
            self.plant.advance(G @ tau)
            if progress is not None and k % 256 == 0:
                progress(k, steps)
        return found(Stop("finished", float(time[-1])))

    def _involved(
        self, k: int, step: float, project: bool, tau: FloatArray, state: dict[str, FloatArray]
    ) -> tuple[FloatArray, Info]:
        """tau of a controls-involved scene at tick k: the start's, projected or as it is, then stepped."""
        if k == 0 and not project:
            return tau, self._twin.control(tau=tau, **state).info
        answer = self._twin.step(step, tau=tau, **state) if k else self._twin.project(tau=tau, **state)
        return answer.value, answer.info

    def _event(self, stops: FloatArray, info: Info, tau: FloatArray) -> str:
        """The first of the simulation's events that has come, or ""."""
        margins = self.simulation
        come = [value <= 0 for value in stops]
        come += [] if margins.sigma_min is None else [info.sigma_min <= margins.sigma_min]
        come += [] if margins.tau_max is None else [bool(np.max(np.abs(tau)) > margins.tau_max)]
        return next((name for name, now in zip(margins.events, come, strict=True) if now), "")


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
    mujoco = _mujoco()
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


def _mujoco() -> ModuleType:
    try:
        import mujoco
    except ImportError:
        raise ToolMissing("MuJoCo is not installed; pip install 'servogen[mujoco]'") from None
    assert isinstance(mujoco, ModuleType)
    return mujoco


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
    frames = {} if mech.known is None else mech.known.frames
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
