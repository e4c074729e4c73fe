"""What Python and a notebook show of the objects a user holds: short, and what one looks for."""

import casadi as ca
import numpy as np
import servogen as sg

q, u, tau = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("F", 2)
par = sg.Parameters(m=sg.Parameter(1.5, "kg", "mass | payload"), k=[1.0, 2.0])
ref = sg.References(r=sg.Ref(0.5, order=1, unit="m"))
mech = sg.Mechanism(q=q, u=u, tau=tau, Q=par.m, P=-u * ca.sum1(par.k), G=[[1.0, 2.0]])
scene = sg.Scene("cart", mech, [sg.Nonholonomic("speed", u - ref.r, -1.0)], par, ref)


def test_what_python_prints(tmp_path) -> None:
    assert repr(par) == "Parameters(m=1.5 kg, k=[1, 2])"
    assert repr(ref) == "References(r=0.5 m, r_dot=0 m/s)"
    assert repr(mech) == "<Mechanism: q = q; u = v; tau = F_0, F_1>"
    assert repr(scene) == "<Scene 'cart' (servo): 1 rows of constraints ('speed'), 2 controls>"
    package = sg.build(scene, tmp_path)
    assert repr(package) == f"<Package cart (float64) in {tmp_path}: psi, S, z, S_z, pinv, control>"
    inputs = "inputs q (1), u (1), r (1), r_dot (1); parameters m, k>"
    assert repr(package.load()) == f"<CompiledTwin of 'cart', float64: {inputs}"
    assert repr(sg.reference(scene)) == f"<ReferenceServo of 'cart', float64: {inputs}"


def test_info_has_names_for_its_numbers() -> None:
    solver = sg.build_solver(2, 3, scalar="float32").load()
    assert repr(solver) == "<CompiledSolver of 2x3 matrices, float32>"
    S = np.eye(2, 3)
    one = solver.solve(S, [1.0, 2.0])[1]
    assert repr(one) == "Info(OK, NORMAL, rank=2, sweeps=0, sigma_min=0.8165, residual=0)"
    many = solver.solve(np.array([S, S, 0 * S]), [[1.0, 2.0], [3.0, 4.0], [0.0, 0.0]])[1]
    assert repr(many) == (
        "Info(OK*2 RANK_DEFICIENT_CONSISTENT*1, NORMAL*2 SVD*1, "
        "rank=0..2, sweeps=0..1, sigma_min=0..0.8165, residual=0..0)"
    )


def test_what_a_notebook_renders(tmp_path) -> None:
    table = ["| parameter | default | unit | meaning |", "|---|---|---|---|"]
    rows = ["| `m` | 1.5 | kg | mass &#124; payload |", "| `k` | [1, 2] |  |  |"]
    assert par._repr_markdown_().splitlines() == table + rows
    assert "| `r_dot` | 0 | m/s | r' |" in ref._repr_markdown_()
    shown = sg.build(scene, tmp_path)._repr_markdown_()
    assert shown.startswith(f"**cart** (float64) in `{tmp_path}`\n\n| C function | operations |\n|---|--:|\n")
    assert "| `cart_pinv` |  |" in shown
    assert "*" not in shown.splitlines()[-1]
    jumping = sg.Mechanism(q=q, u=u, tau=tau, Q=1.0, P=-ca.sign(u), G=[[1.0, 2.0]])
    remarked = sg.build(sg.Scene("cart", jumping, [sg.Nonholonomic("speed", u, -1.0)]), tmp_path)._repr_markdown_()
    assert remarked.splitlines()[-1].startswith("*scene 'cart': P holds sign")
