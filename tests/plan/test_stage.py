"""Binding times and kernels: what parameters alone decide is in prepare, and nothing changes its value."""

from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from hypothesis import given
from hypothesis import strategies as st
from servogen.compiler import compile_scene, target_for
from servogen.derive.controls import AFFINE_CAP, BENT_CAP
from servogen.derive.lower import MASS_PIVOT, MASS_SCALE
from servogen.ir.evaluate import evaluate
from servogen.ir.program import Program, check_legal
from servogen.law.steps import Project
from servogen.loading import load_scene
from servogen.optimise.passes import optimise
from servogen.plan.module import Module
from servogen.plan.stage import Staged, cut, stage
from support.models import awkward_scenes, random_scene
from support.programs import TAME, examples, programs, random_states


def compiled(scene: sg.Scene) -> Module:
    return compile_scene(scene, target_for(scene.name, "float64", None))


def run_staged(staged: Staged, tick: Program, states: dict[str, Any]) -> dict[str, Any]:
    """prepare, then tick with the model it made."""
    known = {i.name for i in staged.prepare.inputs}
    model = evaluate(staged.prepare, {n: v for n, v in states.items() if n in known})
    fields = {i.name: model[i.name].reshape(len(model[i.name]), -1) for i in tick.inputs if i.kind == "model"}
    return evaluate(tick, states | fields)


@examples(60)
@given(programs(ops=TAME, most=18), st.integers(0, 2**32 - 1))
def test_stages_compute_the_same_bits(program: Program, seed: int) -> None:
    program = optimise(program)
    staged = stage(program)
    check_legal(staged.prepare)
    check_legal(staged.tick)
    states = random_states(seed)
    whole, apart = evaluate(program, states), run_staged(staged, staged.tick, states)
    for name, value in whole.items():
        np.testing.assert_array_equal(np.broadcast_to(apart[name], value.shape), value)


def kinds_of(program: Program) -> list[set[str]]:
    """Per instruction: the kinds of inputs it depends on."""
    kind = {i.name: i.kind for i in program.inputs}
    found: list[set[str]] = []
    for i in program.instrs:
        found.append({kind[i.const[0]]} if isinstance(i.const, tuple) else set().union(*(found[a] for a in i.args)))
    return found


@examples(60)
@given(programs(ops=TAME, most=18))
def test_nothing_of_parameters_alone_is_left_to_the_tick(program: Program) -> None:
    staged = stage(optimise(program))
    for instr, kinds in zip(staged.tick.instrs, kinds_of(staged.tick), strict=True):
        assert kinds != {"model"} or isinstance(instr.const, tuple)
        assert "parameter" not in kinds
    for kinds in kinds_of(staged.prepare):
        assert kinds <= {"parameter"}
    fields = [i.name for i in staged.tick.inputs if i.kind == "model"]
    assert len(set(fields)) == len(fields)
    used = {i.const[0] for i in staged.tick.instrs if isinstance(i.const, tuple)}
    assert set(fields) <= used  # no field that nobody reads


@examples(60)
@given(programs(ops=TAME, most=18), st.integers(0, 2**32 - 1))
def test_kernels_are_cut_not_changed(program: Program, seed: int) -> None:
    staged = stage(optimise(program))
    states = random_states(seed)
    whole = run_staged(staged, staged.tick, states)
    for o in staged.tick.outputs:
        kernel = check_legal(cut(staged.tick, "kernel", (o.name,)))
        assert [out.name for out in kernel.outputs] == [o.name]
        assert kernel.operations()["total"] <= staged.tick.operations()["total"]
        part = run_staged(staged, kernel, states)[o.name]
        np.testing.assert_array_equal(np.broadcast_to(part, whole[o.name].shape), whole[o.name])


@pytest.mark.parametrize("name", sorted(awkward_scenes()))
def test_every_scene_plans(name: str) -> None:
    module = compiled(awkward_scenes()[name])
    for program in (module.prepare.program, *(k.program for k in module.kernels)):
        check_legal(program)
        assert all(
            kinds != {"model"} or isinstance(i.const, tuple)
            for i, kinds in zip(program.instrs, kinds_of(program), strict=True)
        )
    fields = {f.name for f in module.model}
    assert {o.name for o in module.prepare.program.outputs} - {MASS_PIVOT, MASS_SCALE} == fields


def test_parameters_alone_make_prepare_work() -> None:
    module = compiled(awkward_scenes()["constant_of_parameters"])
    assert module.prepare.program.operations()["total"] > 0
    kernel = next(k for k in module.kernels if k.name == "S")
    assert kernel.program.operations()["total"] == 0
    assert module.prepare.guards == 2
    assert kernel.guards == 0
    assert any("done once, in prepare" in reason for reason in module.skipped["S"])


def test_guards_are_split_by_the_time_they_are_known() -> None:
    par = sg.Parameters(a=1.0)
    q, u, tau = ca.SX.sym("q", 3), ca.SX.sym("u", 3), ca.SX.sym("tau", 3)
    Q = ca.diag(ca.vertcat(par.a, 2 + ca.sin(q[0]), 5.0))
    mech = sg.Mechanism(q=q, u=u, tau=tau, Q=Q, P=ca.DM.zeros(3), G=ca.DM.eye(3))
    module = compiled(sg.Scene("split", mech, [sg.Nonholonomic("all", u, -1.0)], par))
    assert module.prepare.guards == 1
    assert {k.name: k.guards for k in module.kernels} == {"psi": 0, "S": 1, "z": 0, "S_z": 1}  # without P, z needs no Q


def test_field_names_stand_clear_of_inputs_and_parameters() -> None:
    module = compiled(awkward_scenes()["names_c"])
    names = [f.name for f in module.model]
    assert len(set(names)) == len(names)
    assert not {"c0", "c1", "c2"} & {n for n in names if n not in ("c1", "c3")}


def test_inputs_are_those_the_scene_uses() -> None:
    scenes = awkward_scenes()
    assert [f.name for f in compiled(scenes["plain"]).inputs] == ["q", "u"]
    assert [f.name for f in compiled(scenes["y_given"]).inputs] == ["q", "u", "y"]
    assert [f.name for f in compiled(scenes["unused"]).inputs] == ["q", "u"]
    assert [f.name for f in compiled(scenes["one_control"]).inputs] == ["q", "u", "tau"]
    assert [f.name for f in compiled(scenes["columns"]).inputs] == ["u", "t", "c0_r", "c1", "c1_dot"]
    assert [f.name for f in compiled(scenes["everything"]).inputs][:5] == ["q", "u", "t", "y", "hold"]


def test_entry_points() -> None:
    scenes = awkward_scenes()
    assert [e.name for e in compiled(scenes["plain"]).entry_points] == ["psi", "S", "z", "S_z"]
    module = compiled(scenes["one_cubic"])
    assert [e.name for e in module.entry_points] == ["phi", "A", "B", "A_B"]
    (bent,) = module.law.routine("project").steps
    assert isinstance(bent, Project)
    assert bent.places == ((0, 0, 0),)  # d^2 phi / d tau^2
    assert bent.cap == BENT_CAP
    (affine,) = compiled(scenes["one_control"]).law.routine("project").steps
    assert isinstance(affine, Project)
    assert affine.places == ()
    assert affine.cap == AFFINE_CAP


def test_every_skip_is_said() -> None:
    skipped = compiled(awkward_scenes()["plain"]).skipped["control"]
    for words in (
        "Q is the identity",
        "C: q' = u",
        "D: absent",
        "t: the model",
        "factorisation of S: no state changes it",
        "projector: y is absent",
    ):
        assert any(words in reason for reason in skipped), (words, skipped)
    pendulum = compiled(load_scene("double_pendulum_energy")).skipped["control"]
    assert any("SVD: S is a row" in reason for reason in pendulum)
    assert any(line.endswith("operations: fewer give the same values") for line in pendulum)
    arm = compiled(load_scene("planar_arm_3r")).skipped["control"]
    assert any("SVD, at each tick: not where a certificate" in reason for reason in arm)
    everything = compiled(awkward_scenes()["everything"]).skipped["control"]
    assert not any(w in r for r in everything for w in ("C: ", "D: ", "t: the", "SVD: ", "projector"))


def test_hash_knows_what_decides_the_package() -> None:
    def digest(**more: Any) -> str:
        q, u, tau = ca.SX.sym("q"), ca.SX.sym("u"), ca.SX.sym("tau")
        par = sg.Parameters(a=more.pop("a", 1.0))
        mech = sg.Mechanism(q=q, u=u, tau=tau, Q=1.0, P=0.0, G=1.0)
        name, Theta = more.pop("name", "s"), more.pop("Theta", -1.0)
        return compiled(sg.Scene(name, mech, [sg.Nonholonomic("c", par.a * u, Theta)], par, **more)).scene_hash

    base = digest()
    assert digest() == base
    others = [
        digest(a=2.0), digest(a=sg.Parameter(1.0, "m")), digest(a=sg.Parameter(1.0, text="mass")), digest(name="t"),
        digest(Theta=-2.0), digest(y="input"), digest(solver=sg.Solver(method="svd")),
        digest(solver=sg.Solver(atol=1e-9)),
    ]  # fmt: skip
    assert len({base, *others}) == len(others) + 1


def test_constants_stay_exact_until_they_are_printed() -> None:
    module = compiled(random_scene(0, "nonholonomic"))
    constants = [i.const for k in module.kernels for i in k.program.instrs if i.op == "const"]
    assert all(isinstance(c, Fraction) for c in constants)
    assert Fraction(3, 10) in constants or Fraction(1, 5) in constants
