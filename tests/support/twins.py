"""Twins for tests that look at derivation alone."""

from typing import Any

import servogen as sg
from servogen.compiler import compile_scene
from servogen.optimise.search import SEARCH
from servogen.package import write
from servogen.plan.module import Target
from servogen.render.render import render


def as_derived(scene: sg.Scene) -> Any:
    """The compiled twin without the optimiser's passes and without the compiler's: a third of the time."""
    module = compile_scene(scene, Target("float64", scene.name), frozenset(SEARCH))
    return write(render(module), None, module, scene).load(flags=("-O0",))
