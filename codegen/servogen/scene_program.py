"""A scene's program, optimised: judged at states of its domain, and without tests of Q that have lost their purpose.

A solve of Q may cancel: with psi the energy, Q^-1 psi_u^T is u. Then nothing divides by the pivots of Q any more, and
their test for singularity may go where Q is positive definite over the domain. What parameters alone decide is still
tested in prepare.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from servogen.derive.formulation import Formulation, MassTreatment, Quantity
from servogen.derive.lower import MASS_PIVOT, MASS_SCALE
from servogen.ir.binding import depends_on_parameters_alone, is_constant
from servogen.ir.field import Residue, unsigned
from servogen.ir.program import Output, Program, live, only
from servogen.optimise.angles import snap_quarter_turns
from servogen.optimise.decimals import clean_constants
from servogen.optimise.fingerprint import Fingerprints
from servogen.optimise.passes import optimise
from servogen.optimise.search import Optimised, search
from servogen.optimise.value_numbering import number_values
from servogen.scene.samples import Samples


@dataclass(frozen=True)
class SceneProgram:
    """The program of a scene. exact: the same before optimisation, the truth of every check.

    free_of_mass: quantities that need Q on paper but divide by nothing of it, and need no test that it is regular.
    remarks: angles read as quarter turns, rewrites refused.
    """

    program: Program
    exact: Program
    optimised: Optimised
    free_of_mass: frozenset[str] = frozenset()
    remarks: tuple[str, ...] = ()


def optimise_formulation(
    formulation: Formulation,
    lowered: Program,
    model: Program,
    samples: Samples,
    without: frozenset[str] = frozenset(),
) -> SceneProgram:
    """All quantities of a scene as one program; the constraint's value counts less than the system it leads to.

    lowered: the formulation's quantities. model: the scene's Q, P and G as they are written. samples: where accuracy is
    judged. without: passes to leave out, by name.
    """
    minor = frozenset([formulation.scene.system.constraint])
    return optimise_quantities(formulation.quantities, formulation.mass, lowered, model, samples, minor, without)


def optimise_quantities(
    quantities: Sequence[Quantity],
    mass: MassTreatment,
    lowered: Program,
    model: Program,
    samples: Samples,
    minor: frozenset[str] = frozenset(),
    without: frozenset[str] = frozenset(),
) -> SceneProgram:
    """Named quantities of a scene as one program; lowered, model, samples as above, minor: outputs that count less."""
    exact, remarks = as_meant(lowered)
    needing = [q.name for q in quantities if q.needs_mass]
    own = _divisors(as_meant(only(model, "Q", "P", "G"))[0]) if mass.positive_definite and mass.pivots else None
    if own is not None and needing == _free(number_values(exact), needing, own):
        exact = _without_late_pivots(exact)
    minor = (minor | {MASS_PIVOT, MASS_SCALE}) & {o.name for o in exact.outputs}
    optimised = search(exact, samples.judged, minor, without)
    free = frozenset() if own is None else frozenset(_free(optimised.program, needing, own))
    return SceneProgram(optimised.program, exact, optimised, free, remarks + optimised.refused)


def as_meant(lowered: Program) -> tuple[Program, tuple[str, ...]]:
    """A program simplified, its constants and angles as they were meant, and remarks on what was read otherwise."""
    cleaned, constants = clean_constants(lowered)
    snapped, angles = snap_quarter_turns(optimise(cleaned))
    return optimise(snapped), constants + angles


def _free(program: Program, names: Sequence[str], own: frozenset[Residue]) -> list[str]:
    """Those of the named outputs for which no division at tick is left but by divisors in `own`."""
    early = depends_on_parameters_alone(program)
    values = Fingerprints(program).values
    foreign = {
        k
        for k, i in enumerate(program.instrs)
        if i.op == "div"
        and not early[i.args[1]]
        and not is_constant(program, i.args[1])
        and unsigned(values[i.args[1]])[0] not in own
    }
    return [name for name in names if not foreign & live(program, program.output(name).nodes)]


def _divisors(program: Program) -> frozenset[Residue]:
    values = Fingerprints(program).values
    return frozenset(unsigned(values[i.args[1]])[0] for i in program.instrs if i.op == "div")


def _without_late_pivots(program: Program) -> Program:
    """The program without the pivots that would be judged at each tick."""
    early = depends_on_parameters_alone(program)
    pivots, scales = program.output(MASS_PIVOT).nodes, program.output(MASS_SCALE).nodes
    kept = [
        (p, s)
        for p, s in zip(pivots, scales, strict=True)
        if (early[p] or is_constant(program, p)) and (early[s] or is_constant(program, s))
    ]
    outputs = [o for o in program.outputs if o.name not in (MASS_PIVOT, MASS_SCALE)]
    if kept:
        outputs += [
            Output(MASS_PIVOT, len(kept), 1, tuple(p for p, _ in kept)),
            Output(MASS_SCALE, len(kept), 1, tuple(s for _, s in kept)),
        ]
    return optimise(replace(program, outputs=tuple(outputs)))
