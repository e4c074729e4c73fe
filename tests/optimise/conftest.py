"""The built-in scenes' programs."""

import pytest
from servogen.compiler import derived_scene
from servogen.ir.program import Program
from servogen.loading import builtin_names, load_scene
from servogen.optimise.passes import optimise


@pytest.fixture(scope="session")
def scene_programs() -> list[Program]:
    """Each built-in scene, derived, lowered and optimised."""
    return [optimise(derived_scene(load_scene(name))[1]) for name in builtin_names()]
