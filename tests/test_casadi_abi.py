"""casadi.external loads the generated C: the same answers, finite differences through it, and an integrator on it."""

import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import servogen as sg
from servogen.scenes import double_pendulum_energy, spacecraft
from support.c import STRICT, compiler


def external(scene: sg.Scene, folder: Path, scalar: str = "float64") -> ca.Function:
    package = sg.build(scene, folder, scalar, casadi_abi=True)
    name = f"{package.prefix}_casadi"
    library = folder / f"{name}.so"
    sources = [folder / f"{package.prefix}.c", folder / f"{name}.c"]
    options = [*STRICT, "-O2", "-ffp-contract=off", "-fPIC", "-shared", f"-I{folder}"]
    subprocess.run([compiler("gcc"), *options, *sources, "-o", library, "-lm"], check=True)
    return ca.external(name, str(library), {"enable_fd": True})


@pytest.mark.parametrize("scalar", ["float64", "float32"])
def test_the_same_bits_as_the_twin(tmp_path: Path, scalar: str) -> None:
    f = external(double_pendulum_energy.scene, tmp_path, scalar)
    assert f.name_in() == ["m_B", "R", "L", "I_D", "I_B", "g", "q", "u", "E_0"]
    assert f.name_out() == ["tau", "status"]
    twin = sg.build(double_pendulum_energy.scene, scalar=scalar).load()
    rng = np.random.default_rng(0)
    defaults = [p.default for p in double_pendulum_energy.par]
    for _ in range(20):
        q, u = rng.uniform(-1, 1, (2, 2))
        tau, status = f(*defaults, q, u, 0.0)
        assert np.array_equal(np.array(tau).ravel(), twin.control(q=q, u=u).value.astype(float))
        assert float(status) == 0


def test_refused_inputs_are_nan(tmp_path: Path) -> None:
    f = external(spacecraft.scene, tmp_path)
    arguments = dict.fromkeys(f.name_in(), 1.0) | {"u": [np.nan, 0, 0], "tau": [0, 0, 0]}
    result = f(**arguments)
    assert np.all(np.isnan(np.array(result["tau_dot"])))
    assert float(result["status"]) == sg.Status.NONFINITE


def test_finite_differences_and_an_integrator(tmp_path: Path) -> None:
    """d tau / d u by CasADi's finite differences, and E(1 s) = E(0) / e with the C inside CasADi's integrator."""
    m = double_pendulum_energy
    f = external(m.scene, tmp_path)
    defaults = [p.default for p in m.par]
    q, u = ca.MX.sym("q", 2), ca.MX.sym("u", 2)
    tau = f(*defaults, q, u, 0.0)[0]
    slope = ca.Function("slope", [q, u], [ca.jacobian(tau, u)])
    at = [0.5, -0.4], [1.0, 0.3]
    twin, h = sg.reference(m.scene), 1e-6

    def torque(velocity: np.ndarray) -> np.ndarray:
        return twin.control(q=at[0], u=velocity).value

    now = np.array(at[1])
    expected = [(torque(now + h * e) - torque(now - h * e)) / (2 * h) for e in np.eye(2)]
    assert np.allclose(np.array(slope(*at)), np.transpose(expected), rtol=1e-4, atol=1e-4)
    symbols = [p.symbol for p in m.par]
    plant = ca.Function("plant", [m.q, m.u, m.tau, *symbols], [ca.solve(m.Q, m.P + m.G @ m.tau)])
    energy = ca.Function("energy", [m.q, m.u, *symbols], [m.E])
    ode = ca.vertcat(u, plant(q, u, tau, *defaults))
    run = ca.integrator("run", "rk", {"x": ca.vertcat(q, u), "ode": ode}, 0.0, 0.3, {"number_of_finite_elements": 300})
    start = np.array([1.6, -1.8, -1.6, 0.8])
    end = np.array(run(x0=start)["xf"]).ravel()
    before, after = (float(energy(x[:2], x[2:], *defaults)) for x in (start, end))
    assert after == pytest.approx(before * np.exp(-0.3), rel=1e-8)
