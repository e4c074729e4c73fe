"""Long kernels in pieces: the same values, bit for bit, and slots that are used again."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import servogen as sg
from hypothesis import assume, given
from hypothesis import strategies as st
from servogen.ir.program import Program
from servogen.plan import chunks, planner
from support.c import STRICT, compiler, run
from support.models import random_scene
from support.programs import TAME, examples, programs


@given(programs(ops=TAME, most=30), st.integers(1, 7))
@examples(100)
def test_every_value_is_loaded_where_it_is_needed(program: Program, piece: int) -> None:
    split = chunks.split(program, longest=0, piece=piece)
    assume(split is not None)
    held: dict[int, int] = {}
    for part in split.pieces:
        here = set()
        for k, slot in part.loads:
            assert held[slot] == k
            here.add(k)
        for k in range(part.start, part.stop):
            for a in program.instrs[k].args:
                while program.instrs[a].op == "neg":
                    a = program.instrs[a].args[0]
                if program.instrs[k].op != "neg" and program.instrs[a].op not in ("input", "const"):
                    assert a in here
            here.add(k)
        for k, slot in part.stores:
            assert k in here
            held[slot] = k
    for k, slot in split.results:
        assert held[slot] == k
    assert max(held, default=-1) < max(split.slots, 1)


@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_pieces_compute_the_same_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scalar: Any) -> None:
    scene = random_scene(2, "mixed")
    values = []
    for longest in (10**6, 20):
        monkeypatch.setattr(planner, "split", lambda p, n=longest: chunks.split(p, n, 15))
        package = sg.build(scene, tmp_path / str(longest), scalar)
        source = package.path / f"{package.prefix}.c"
        run([compiler("gcc"), *STRICT, "-c", source, "-o", tmp_path / "o.o"])
        twin = package.load()
        states = {"q": np.linspace(0.1, 1, 3), "u": np.linspace(-1, 1, 3), "t": 0.4, "r": [0.1, 0.2]}
        values.append(np.concatenate([np.ravel(twin.S(**states)), np.ravel(twin.z(**states))]))
    assert "_piece_" in source.read_text()
    assert np.array_equal(*values)
