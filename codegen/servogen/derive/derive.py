"""From a scene to its equations."""

from dataclasses import replace

from servogen.derive.controls import derive_controls
from servogen.derive.formulation import Formulation, MassFindings
from servogen.derive.ideal import derive_ideal
from servogen.derive.passive import left_out
from servogen.derive.servo import derive_servo
from servogen.scene.samples import Samples

_DERIVATIONS = {"servo": derive_servo, "ideal": derive_ideal, "controls": derive_controls}


def derive(samples: Samples, found: MassFindings) -> Formulation:
    """The system of the samples' scene and what belongs to it. found: of its Q. SceneError for a Q that is singular."""
    formulation = _DERIVATIONS[samples.scene.kind](samples, found)
    return replace(formulation, remarks=left_out(samples))
