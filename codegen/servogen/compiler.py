"""The pipeline, on one page: derive, lower, optimise, plan, render, write."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from servogen.derive.derive import derive
from servogen.derive.formulation import Formulation, MassTreatment, Quantity
from servogen.derive.lower import lower, lower_model, lower_quantities
from servogen.derive.plant import derive_plant
from servogen.errors import SceneError
from servogen.package import Package, write
from servogen.plan.mathematics import Math
from servogen.plan.module import Module, Target
from servogen.plan.planner import plan, plan_functions, plan_solver_only
from servogen.remarks import say
from servogen.render.render import render
from servogen.scalars import EPSILON, Scalar
from servogen.scene.names import check_identifier
from servogen.scene.review import review
from servogen.scene.scene import Scene, check_scene
from servogen.scene.solver import Solver
from servogen.scene_program import SceneProgram, optimise_formulation, optimise_quantities


def build(
    scene: Scene,
    out: str | Path | None = None,
    scalar: Scalar = "float64",
    prefix: str | None = None,
    *,
    math: Math = "own",
    casadi_abi: bool = False,
) -> Package:
    """Generate the C of a scene.

    out: the package's folder; None makes a temporary one. scalar: "float64" or "float32".
    prefix: of all C names; default the scene's name, and name_f32 for float32.
    math: "own" emits sin, cos and sqrt with the package: the same bits everywhere; "libm" calls <math.h>.
    casadi_abi: also <prefix>_casadi.c, a shim by which `casadi.external` calls the control function.
    Raises SceneError for anything wrong with the scene; warns with an sg.Remark of what is odd and yet no error.
    """
    check_scene(scene, "sg.build")
    module = compile_scene(scene, target_for(scene.name, scalar, prefix, math))
    remarks = review(scene) + optimised_scene(scene)[0].remarks
    package = write(render(module, casadi_abi), out, module, scene, remarks)
    say(remarks)
    return package


def compile_scene(scene: Scene, target: Target, without: frozenset[str] = frozenset()) -> Module:
    """Scene -> Module: every stage but printing and writing. without: passes of the optimiser to leave out."""
    formulation, program = optimised_scene(scene, without)
    return plan(formulation, program, target)


@lru_cache(maxsize=128)  # all built-in scenes, and a test run's own beside them
def optimised_scene(scene: Scene, without: frozenset[str] = frozenset()) -> tuple[Formulation, SceneProgram]:
    """The stages that do not look at the target, once for a scene: its scalars and its checks share them."""
    formulation = derive(scene)
    lowered, model = lower(formulation), lower_model(scene)
    return formulation, optimise_formulation(formulation, lowered, model, without)


def build_solver(
    m: int,
    l: int,
    out: str | Path | None = None,
    scalar: Scalar = "float64",
    solver: Solver | None = None,
    prefix: str | None = None,
    *,
    math: Math = "own",
) -> Package:
    """Generate the pseudo-inverse of m x l matrices alone, tau = y + S+ (z - S y); m, l from 1 to 12.

    SceneError for other shapes, and for a solver that is no sg.Solver.
    """
    solver = Solver() if solver is None else solver
    if not isinstance(solver, Solver):
        raise SceneError(f"sg.build_solver: solver is {type(solver).__name__}; give an sg.Solver(...)")
    if not all(isinstance(n, int | np.integer) and not isinstance(n, bool) for n in (m, l)):
        raise SceneError(f"sg.build_solver({m!r}, {l!r}): give the rows and the columns of S as whole numbers, 1 to 12")
    m, l = int(m), int(l)
    module = plan_solver_only(m, l, target_for(f"pinv_{m}x{l}", scalar, prefix, math), solver)
    return write(render(module), out, module, None)


def build_plant(
    scene: Scene,
    out: str | Path | None = None,
    scalar: Scalar = "float64",
    prefix: str | None = None,
    *,
    math: Math = "own",
) -> Package:
    """Generate the C of the mechanism itself, q' and u' by Eqs. (1)-(2): `<prefix>_q_dot_u_dot`.

    out and scalar as for `build`; prefix: default <scene>_plant, and <scene>_plant_f32 for float32.
    Raises SceneError for a singular Q.
    """
    quantities, mass = derive_plant(scene)
    module = compile_functions(scene, quantities, mass, target_for(f"{scene.name}_plant", scalar, prefix, math))
    return write(render(module), out, module, scene)


def compile_functions(scene: Scene, quantities: Sequence[Quantity], mass: MassTreatment, target: Target) -> Module:
    """Quantities of a scene -> Module: one entry point, named by them, that computes all; no controller, no solver."""
    lowered, model = lower_quantities(scene, quantities, mass), lower_model(scene)
    program = optimise_quantities(scene, quantities, mass, lowered, model)
    return plan_functions(scene, quantities, mass, program, target)


def target_for(name: str, scalar: Scalar, prefix: str | None, math: Math = "own") -> Target:
    """The scalar, the prefix and the source of sin, cos and sqrt, checked."""
    if math not in ("own", "libm"):
        raise SceneError(f"math {math!r}: choose 'own' or 'libm'")
    if scalar not in EPSILON:
        raise SceneError(f"scalar {scalar!r}: choose 'float64' or 'float32'")
    default = name if scalar == "float64" else f"{name}_f32"
    return Target(scalar, check_identifier(default if prefix is None else prefix, "prefix"), math)
