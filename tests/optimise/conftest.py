"""The built-in scenes' programs."""

import pytest
from servogen.derive.derive import derive
from servogen.derive.lower import lower
from servogen.ir.program import Program
from servogen.loading import builtin_names, load_scene
from servogen.optimise.passes import optimise


@pytest.fixture(scope="session")
def scene_programs() -> list[Program]:
    """Each built-in scene, derived, lowered and optimised."""
    return [optimise(lower(derive(load_scene(name)))) for name in builtin_names()]
