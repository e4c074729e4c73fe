"""The pipeline, on one page: survey, derive, lower, optimise, plan, render, write."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from servogen.derive.derive import derive
from servogen.derive.formulation import Formulation, MassTreatment, Quantity
from servogen.derive.lie import Drift
from servogen.derive.lower import lower, lower_model, lower_quantities
from servogen.derive.plant import derive_plant
from servogen.derive.rows import behind
from servogen.errors import SceneError
from servogen.ir.program import Program
from servogen.law.law import offered
from servogen.package import Package, write
from servogen.plan.mathematics import Math
from servogen.plan.module import Module, Target
from servogen.plan.planner import plan, plan_functions, plan_solver_only
from servogen.remarks import say
from servogen.render.render import render, render_with_core
from servogen.scalars import EPSILON, Scalar
from servogen.scene.constraints import Constraint, Output
from servogen.scene.names import check_file_name
from servogen.scene.review import review
from servogen.scene.samples import draw_samples
from servogen.scene.scene import Scene, check_scene
from servogen.scene.solver import Solver
from servogen.scene_program import SceneProgram, optimise_formulation, optimise_quantities
from servogen.survey.definiteness import survey_mass, survey_weight
from servogen.survey.degree import survey_degree
from servogen.survey.noise import survey_noise
from servogen.survey.reach import survey_reach, survey_values
from servogen.twins.reference import ReferenceTwin, reference_twin


def build(
    scene: Scene,
    out: str | Path | None = None,
    scalar: Scalar = "float64",
    prefix: str | None = None,
    *,
    math: Math = "own",
    casadi_abi: bool = False,
    entry_points: Sequence[str] | None = None,
    core: str | None = None,
    batch: bool = False,
) -> Package:
    """Generate the C of a scene.

    out: the package's folder; None makes a temporary one. scalar: "float64" or "float32".
    prefix: of all C names; default the scene's name, and name_f32 for float32.
    math: "own" emits sin, cos and sqrt with the package: the same bits everywhere; "libm" calls <math.h>.
    casadi_abi: also <prefix>_casadi.c, a shim by which `casadi.external` calls the control function.
    entry_points: the functions to generate, as ("control",), with prepare and what they call; None: all there are.
    core: a name, "servogen_core" say: what controllers of one image can share (types of status and info, solvers of
    equal shapes and options, sin, cos and sqrt) goes into <core>.h and .c in the folder <core> beside `out`, which
    each package with that core extends; the answers are the same bits.
    batch: also <prefix>_batch.h and .c, the control function of many states at once, by vectors: the same bits, on one
    core of a PC with AVX2 several times as many states a second; `control_batch` of the loaded package then calls it.
    Raises SceneError for anything wrong with the scene, and for an entry point that it does not have; warns with an
    sg.Remark of what is odd and yet no error.
    """
    check_scene(scene, "sg.build")
    for what, given in (("limits", scene.sides is not None), ("priorities or active='input'", scene.cascaded)):
        if core is not None and given:
            raise SceneError(
                f"scene {scene.name!r}: a core (core={core!r}) with {what} is not built; leave out core for this scene"
            )
    target = target_for(scene.name, scalar, prefix, math, core)
    module = compile_scene(scene, target, entry_points=entry_points)
    if casadi_abi and not module.law.has("control"):
        raise SceneError(
            "casadi_abi: the shim calls control, which entry_points leave out; add it, or leave out the shim"
        )
    if batch and not module.law.has("control"):
        raise SceneError(
            "batch: it is control that is done for many states; add it to entry_points, or leave out batch"
        )
    remarks = review(scene) + derived_scene(scene)[0].remarks
    files, shared = render_with_core(module, casadi_abi, batch)
    package = write(files, out, module, scene, remarks, shared if core else None)
    say(remarks)
    return package


def compile_scene(
    scene: Scene, target: Target, without: frozenset[str] = frozenset(), entry_points: Sequence[str] | None = None
) -> Module:
    """Scene -> Module: every stage but printing and writing. without: passes of the optimiser to leave out."""
    formulation, program = optimised_scene(scene, without)
    noise = noise_of(scene, target.scalar, without)
    return plan(formulation, program, target, noise, _checked(entry_points, formulation))


def optimised_scene(scene: Scene, without: frozenset[str] = frozenset()) -> tuple[Formulation, SceneProgram]:
    """The stages that do not look at the target, once for a scene: its scalars and its checks share them."""
    return _optimised_once(scene, without)  # a cache takes a default left out and the same one given for two calls


@lru_cache(maxsize=128)  # all built-in scenes, and a test run's own beside them
def _optimised_once(scene: Scene, without: frozenset[str]) -> tuple[Formulation, SceneProgram]:
    formulation, lowered = derived_scene(scene)
    return formulation, optimise_formulation(formulation, lowered, lower_model(scene), draw_samples(scene), without)


@lru_cache(maxsize=128)
def derived_scene(scene: Scene) -> tuple[Formulation, Program]:
    """The equations of a scene and their program, with remarks on what is odd; SceneError for what cannot be built."""
    samples, model = draw_samples(scene), lower_model(scene)
    found = survey_mass(samples, model)
    survey_weight(samples, model)
    survey_degree(samples, found)
    formulation = derive(samples, found)
    survey_values(samples, formulation)
    lowered = lower(formulation)
    remarks = found.remarks + formulation.remarks + survey_reach(samples, formulation, lowered, found)
    told = tuple(f"scene {scene.name!r}: {text}" for text in remarks)
    return replace(formulation, remarks=told), lowered


def motion_of(scene: Scene, constraint: Constraint) -> Drift:
    """The motion to differentiate a constraint along: at tau = 0, or as the rows that it stands behind prescribe."""
    samples = draw_samples(scene)
    found = survey_mass(samples, lower_model(scene))
    apart = behind(samples, found) if isinstance(constraint, Output) else None
    return apart.drift if apart is not None and constraint.name in apart.names else Drift(samples, found)


def noise_of(scene: Scene, scalar: Scalar, without: frozenset[str] = frozenset()) -> tuple[float, ...] | None:
    """Per row of the scene's system, the noise of its code; None where the user says what counts as zero."""
    if scene.solver.atol is not None:
        return None
    formulation, optimised = optimised_scene(scene, without)
    return survey_noise(draw_samples(scene), optimised.program, formulation.factorised, scalar)


def build_solver(
    m: int,
    l: int,
    out: str | Path | None = None,
    scalar: Scalar = "float64",
    solver: Solver | None = None,
    prefix: str | None = None,
    *,
    math: Math = "own",
    limits: bool = False,
    batch: bool = False,
) -> Package:
    """Generate the pseudo-inverse of m x l matrices alone, tau = y + S+ (z - S y); m, l from 1 to 12.

    limits: solve takes lower and upper, (l,) each, and answers with least squares within them; not with damping.
    batch: also <prefix>_batch.h and .c, solve of many systems at once, by vectors: the same bits; not with limits.
    SceneError for other shapes, and for a solver that is no sg.Solver.
    """
    solver = Solver() if solver is None else solver
    if not isinstance(solver, Solver):
        raise SceneError(f"sg.build_solver: solver is {type(solver).__name__}; give an sg.Solver(...)")
    if not all(isinstance(n, int | np.integer) and not isinstance(n, bool) for n in (m, l)):
        raise SceneError(f"sg.build_solver({m!r}, {l!r}): give the rows and the columns of S as whole numbers, 1 to 12")
    if batch and limits:
        raise SceneError("sg.build_solver: many systems at once with limits are not built; leave out batch or limits")
    m, l = int(m), int(l)
    module = plan_solver_only(m, l, target_for(f"pinv_{m}x{l}", scalar, prefix, math), solver, bool(limits))
    return write(render(module, batch=batch), out, module, None)


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
    quantities, mass = derive_plant(scene, survey_mass(draw_samples(scene), lower_model(scene)))
    module = compile_functions(scene, quantities, mass, target_for(f"{scene.name}_plant", scalar, prefix, math))
    return write(render(module), out, module, scene)


def reference(scene: Scene, scalar: Scalar = "float64") -> ReferenceTwin:
    """The scene as a twin computed in Python, straight from the textbook formulas: numpy, and its SVD.

    It shares no code with the generated C, and writes its own thresholds of rank and consistency; only the noise below
    which a row counts as zero (the default of the solver's atol) is that of the code. For float32, inputs, parameters
    and results are rounded to it; the computation itself stays in float64.
    Raises SceneError where `scene` is no Scene, or where prepare refuses the parameters' defaults.
    """
    check_scene(scene, "sg.reference")
    return reference_twin(scene, scalar, noise_of)


def compile_functions(scene: Scene, quantities: Sequence[Quantity], mass: MassTreatment, target: Target) -> Module:
    """Quantities of a scene -> Module: one entry point, named by them, that computes all; no controller, no solver."""
    lowered = lower_quantities(scene, quantities, mass)
    program = optimise_quantities(quantities, mass, lowered, lower_model(scene), draw_samples(scene))
    return plan_functions(scene, quantities, program, target, mass.joining)


def target_for(name: str, scalar: Scalar, prefix: str | None, math: Math = "own", core: str | None = None) -> Target:
    """The scalar, the prefix, the source of sin, cos and sqrt and the name of a core, checked."""
    if math not in ("own", "libm"):
        raise SceneError(f"math {math!r}: choose 'own' or 'libm'")
    if scalar not in EPSILON:
        raise SceneError(f"scalar {scalar!r}: choose 'float64' or 'float32'")
    default = name if scalar == "float64" else f"{name}_f32"
    return Target(
        scalar,
        check_file_name(default if prefix is None else prefix, "prefix"),
        math,
        "" if core is None else check_file_name(core, "core"),
    )


def _checked(entry_points: Sequence[str] | None, formulation: Formulation) -> Sequence[str] | None:
    """Names of functions that the scene has; SceneError for others."""
    if entry_points is None:
        return None
    names = [entry_points] if isinstance(entry_points, str) else list(entry_points)
    there = offered(formulation.law)
    for name in names:
        if name not in there:
            raise SceneError(f"entry_points: {name!r} is no function of this scene; there are {', '.join(there)}")
    if not names:
        raise SceneError(f"entry_points: none given; choose from {', '.join(there)}, or leave it out for all")
    return names
