"""Robots of the built-in scenes in other libraries: adam's CasADi model, and Pinocchio with Eigen in C++.

A scene file that lets its robot be exchanged defines `scene_of(robot)`, without weight and y, ROBOT_FILE and
END_EFFECTOR.
"""

import hashlib
import os
import subprocess
import sysconfig
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from servogen.bench.contenders import Call, CContender, keep_states
from servogen.bench.driver import compiler_version
from servogen.bench.inputs import Inputs
from servogen.bench.results import Output
from servogen.scene.constraints import theta_parts
from servogen.scene.mechanism import Mechanism
from servogen.scene.scene import Scene
from servogen.tools import ToolMissing

_GRAVITY = (0.0, 0.0, -9.81)
_BOOST_LIMITS = ("-DBOOST_MPL_LIMIT_LIST_SIZE=30", "-DBOOST_MPL_LIMIT_VECTOR_SIZE=30",
                 "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS", "-DBOOST_FUSION_INVOKE_MAX_ARITY=10")  # fmt: skip


class AdamRobot:
    """What a scene asks of a robot with a fixed base, from adam-robotics. ToolMissing where it is not installed."""

    def __init__(self, path: Path) -> None:
        try:
            from adam.casadi import KinDynComputations
        except ImportError:
            raise ToolMissing("adam-robotics is not installed; pip install 'servogen[peers]'") from None
        kinematics = KinDynComputations(str(path), gravity=np.array([*_GRAVITY, 0.0, 0.0, 0.0]))
        n = kinematics.NDoF
        q, u, tau = (ca.SX.sym(name, n) for name in ("q", "u", "tau"))
        world = ca.SX.eye(4)
        Q = kinematics.mass_matrix(world, q)[6:, 6:]
        P = -kinematics.bias_force(world, q, ca.SX.zeros(6), u)[6:]
        self.mechanism = Mechanism(q=q, u=u, tau=tau, Q=Q, P=P, G=ca.SX.eye(n))
        self._kinematics, self._world = kinematics, world

    def position(self, frame: str) -> Any:
        """The frame's origin in the world, 3, m."""
        return self._kinematics.forward_kinematics(frame, self._world, self.mechanism.q)[:3, 3]


def adam_scene(module: ModuleType) -> Scene:
    """What a file's `scene_of` makes of adam's model."""
    scene = module.scene_of(AdamRobot(module.ROBOT_FILE), f"{module.scene.name}_adam")
    assert isinstance(scene, Scene)
    return scene


def pinocchio_c(module: ModuleType, inputs: Inputs, capacity: int, flags: Sequence[str]) -> CContender:
    """One position constraint on a robot with a fixed base, header-only; compiled once for each set of flags.

    ToolMissing without the Python package `pin`, whose wheel holds the headers, Eigen or a C++ compiler.
    """
    source = _source(module)
    library = _compiled(source, flags)
    pointers = "\n".join(
        f"    arg[{i}] = kept_states + {inputs.states.shape[1]} * k + {s.start};"
        for i, s in enumerate(inputs.slices.values())
    )
    calls = "".join(
        f"""
int pinocchio_{output.value}(const double **arg, double *out);

static int call_{output.value}(long k, double *out)
{{
{pointers}
    return pinocchio_{output.value}(arg, out);
}}
"""
        for output in (Output.SYSTEM, Output.ANSWER)
    )
    declarations = f"static const double *arg[{len(inputs.slices)}];\n{keep_states(inputs, capacity, 'double')}{calls}"
    return CContender(
        "Pinocchio + Eigen",
        "pinocchio",
        "float64",
        False,
        (),
        declarations,
        {o: Call(f"call_{o.value}(k, out)", f"pinocchio_{o.value}") for o in (Output.SYSTEM, Output.ANSWER)},
        libraries=(str(library), "-lstdc++"),
    )


def _source(module: ModuleType) -> str:
    """C++ for the scene's robot, its joints and bodies as the Python package read them."""
    try:
        import pinocchio as pin
    except ImportError:
        raise ToolMissing("Pinocchio is not installed; pip install 'servogen[peers]'") from None
    model = pin.buildModelFromUrdf(str(module.ROBOT_FILE))
    (constraint,) = module.scene.constraints
    gains = theta_parts(constraint)
    bodies = []
    for k in range(1, model.njoints):
        inertia = model.inertias[k]
        bodies.append({
            "joint": model.joints[k].shortname(),
            "parent": int(model.parents[k]),
            "mass": repr(float(inertia.mass)),
            "centre": _numbers(inertia.lever),
            "inertia": _numbers(inertia.inertia),
        } | _placed(model.jointPlacements[k]))  # fmt: skip
    end = model.frames[model.getFrameId(module.END_EFFECTOR)]
    environment = Environment(
        loader=PackageLoader("servogen.bench", "peers"), undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, keep_trailing_newline=True, autoescape=False,
    )  # fmt: skip
    return environment.get_template("pinocchio.cpp.j2").render(
        scene=module.scene.name,
        n=model.nv,
        bodies=bodies,
        frame={"parent": int(end.parentJoint)} | _placed(end.placement),
        gravity=_numbers(np.array(_GRAVITY)),
        rates="r_dot" in [f.name for f in module.scene.input_fields()],
        Theta1=repr(float(gains["Theta1"][0, 0])),
        Theta2=repr(float(gains["Theta2"][0, 0])),
    )


def _placed(placement: Any) -> dict[str, str]:
    return {"rotation": _numbers(placement.rotation), "origin": _numbers(placement.translation)}


def _numbers(values: Any) -> str:
    return ", ".join(repr(float(v)) for v in np.ravel(values))


def _compiled(source: str, flags: Sequence[str]) -> Path:
    """The object, from the cache where it has been compiled before: it takes a minute or two."""
    command = os.environ.get("CXX", "c++")
    key = hashlib.sha256("\n".join([source, compiler_version(command), *flags]).encode()).hexdigest()[:16]
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "servogen"
    found = cache / f"pinocchio-{key}.o"
    if not found.exists():
        cache.mkdir(parents=True, exist_ok=True)
        text = cache / f"pinocchio-{key}.cpp"
        text.write_text(source)
        headers = Path(sysconfig.get_path("purelib")) / "cmeel.prefix" / "include"
        argv = [command, "-std=c++17", "-DNDEBUG", *_BOOST_LIMITS, *flags, "-isystem", str(headers),
                "-isystem", "/usr/include/eigen3", "-c", str(text), "-o", str(found)]  # fmt: skip
        run = subprocess.run(argv, capture_output=True, text=True)
        if run.returncode != 0:
            why = next((line for line in run.stderr.splitlines() if "error" in line), run.stderr)
            raise ToolMissing(f"{command} cannot compile with Pinocchio: {why.strip()}; apt-get install libeigen3-dev")
    return found
