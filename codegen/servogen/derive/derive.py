"""The first stage of the pipeline."""

from servogen.derive.controls import derive_controls
from servogen.derive.formulation import Formulation
from servogen.derive.reach import check_reach
from servogen.derive.servo import derive_servo
from servogen.scene.scene import Scene


def derive(scene: Scene) -> Formulation:
    """The scene's system and what belongs to it. SceneError for a singular Q or a constraint without effect."""
    formulation = derive_servo(scene) if scene.kind == "servo" else derive_controls(scene)
    check_reach(formulation)
    return formulation
