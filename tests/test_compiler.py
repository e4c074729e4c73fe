"""The pipeline goes through its stages once for a scene."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import servogen as sg
from servogen import compiler
from servogen.derive import lower
from servogen.scene.samples import EXAMINED, JUDGED, SEARCHED
from support.models import awkward_scenes


def test_both_scalars_and_the_reference_share_one_derivation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One derivation, one search, each expression lowered once, and the domain's states drawn once."""
    called: list[str] = []

    def counted(name: str, function: Any) -> Any:
        return lambda *given: called.append(name) or function(*given)

    for module, name in ((compiler, "derive"), (compiler, "optimise_formulation"), (lower, "lower_expressions")):
        monkeypatch.setattr(module, name, counted(name, getattr(module, name)))

    def domain(generator: np.random.Generator) -> dict[str, Any]:
        called.append("state")
        return {"q": generator.uniform(-1, 1, 1), "u": generator.uniform(-1, 1, 1)}

    scene = replace(awkward_scenes()["one"], domain=domain)
    for scalar in ("float64", "float32"):
        sg.build(scene, tmp_path / scalar, scalar)
        sg.reference(scene, scalar).control(q=[0.1], u=[0.2], y=[0.0])
    counts = {name: called.count(name) for name in dict.fromkeys(called)}
    states = EXAMINED + JUDGED + SEARCHED
    # the model as it is written, which is surveyed before Q is solved with, and then the system
    assert counts == {"state": states, "lower_expressions": 2, "derive": 1, "optimise_formulation": 1}
