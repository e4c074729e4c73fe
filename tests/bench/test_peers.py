"""Whole rivals answer the same question, those that are missing are named, and code is weighed as compiled."""

import json
import sys

from servogen.bench import chain
from servogen.bench.contenders import casadi_c, servogen_c
from servogen.bench.peers.peers import OUTPUTS, Peers
from servogen.bench.results import Output
from servogen.bench.run import bench
from servogen.loading import load_scene, scene_module
from servogen.optimise.search import SEARCH

SCENE = load_scene("planar_arm_3r")


def test_the_system_at_once_is_matrix_and_right_side():
    def choose(scene, inputs, capacity):
        return (
            servogen_c(scene, inputs, capacity, "float64", OUTPUTS),
            servogen_c(scene, inputs, capacity, "float64", (Output.SYSTEM,), frozenset(["factoring"])),
            casadi_c(scene, inputs, capacity, "LDL^T", cse=True, outputs=OUTPUTS, ldlt=True),
            casadi_c(scene, inputs, capacity, "solve", cse=True, outputs=OUTPUTS),
        )

    result = bench(SCENE, rounds=1, states=32, contenders=choose, baseline="solve", count_instructions=False)
    assert [m.label for m in result.measurements].count("S, z") == 4
    assert all(m.errors.largest_ulps < 50 for m in result.measurements if m.output is Output.SYSTEM)
    ours, without, ldlt, solve = result.builds
    assert ours.operations < ldlt.operations < solve.operations
    assert ours.operations <= without.operations
    assert all(b.text > 500 and b.seconds > 0 for b in result.builds)


def test_peers_of_a_scene_that_are_missing_are_named(monkeypatch):
    for package in ("sympy", "adam", "adam.casadi", "pinocchio"):
        monkeypatch.setitem(sys.modules, package, None)
    peers = Peers(scene_module("spacecraft"), ("-O2",))
    result = bench(load_scene("spacecraft"), rounds=1, states=16, contenders=peers, count_instructions=False)
    assert {f"servogen f64 less {name}" for name in SEARCH} < {b.contender for b in result.builds}
    assert peers.remarks == ["SymPy is not installed; pip install 'servogen[peers]'"]


def test_sympys_code_is_right(need_module):
    need_module("sympy", "sympy")
    peers = Peers(scene_module("double_pendulum_energy"), ("-O2",), ablation=False)
    scene = load_scene("double_pendulum_energy")
    result = bench(scene, rounds=1, states=16, contenders=peers, count_instructions=False)
    assert result.of("SymPy cse", Output.SYSTEM).errors.largest_ulps < 50


def test_chains_are_measured_and_drawn(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["chain", "--links", "2,3", "--flags=-O1", "--out", str(tmp_path)])
    chain.main()
    sizes = json.loads((tmp_path / "chain.json").read_text())
    assert [(s["generator"], s["links"]) for s in sizes] == [
        (g, n) for n in (2, 3) for g in ("servogen", "CasADi cse, LDL^T")
    ]
    assert all(s["operations"] > 20 and s["generated"] > 0 and s["text"] > 500 for s in sizes)
    assert "<svg" in (tmp_path / "chain.svg").read_text()


def test_a_compiler_that_takes_too_long_is_stopped():
    files = {
        "x.c": "int f(int x)\n{\n"
        + "".join(f"    x = x * 3 + {k} % (x | 1);\n" for k in range(60000))
        + "return x;\n}\n"
    }
    assert chain.compile_alone(files, ["-O2"], limit=1.0) == (None, None)
