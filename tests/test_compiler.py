"""The pipeline goes through its stages once for a scene."""

from pathlib import Path

import pytest
import servogen as sg
from servogen import compiler
from support.models import awkward_scenes


def test_both_scalars_and_the_reference_share_one_derivation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    derived = []
    derive = compiler.derive
    monkeypatch.setattr(compiler, "derive", lambda *given: derived.append(given) or derive(*given))
    scene = awkward_scenes()["one"]
    for scalar in ("float64", "float32"):
        sg.build(scene, tmp_path / scalar, scalar)
        sg.reference(scene, scalar)
    assert len(derived) == 1
