"""The first stage of the pipeline."""

from dataclasses import replace

from servogen.derive.controls import derive_controls
from servogen.derive.formulation import Formulation
from servogen.derive.ideal import derive_ideal
from servogen.derive.reach import check_finite, check_reach
from servogen.derive.servo import derive_servo
from servogen.scene.scene import Scene

_DERIVATIONS = {"servo": derive_servo, "ideal": derive_ideal, "controls": derive_controls}


def derive(scene: Scene) -> Formulation:
    """The scene's system and what belongs to it. SceneError for a singular Q or a constraint without effect."""
    formulation = _DERIVATIONS[scene.kind](scene)
    check_finite(formulation)
    remarks = formulation.mass.remarks + check_reach(formulation)
    return replace(formulation, remarks=tuple(f"scene {scene.name!r}: {text}" for text in remarks))
