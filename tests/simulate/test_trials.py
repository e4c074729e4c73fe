"""One table of verdicts: a scene on machines with one flaw each."""

import json
import sys

import pytest
from servogen.cli import main
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.simulation import Simulation
from servogen.simulate.trials import trials


def test_each_flaw_is_on_its_own_machine(rail_loop):
    loop = ClosedLoop(rail_loop.scene, Simulation(start={"q": 0.0, "u": 0.0}, duration=2.0, step=2e-3, tolerance=1e-3))
    found = {t.machine: t.run for t in trials(loop)}
    first, sampled, heavy, noisy, late, weak = found.values()
    assert first.hold is None
    assert {run.hold for run in list(found.values())[1:]} == {1e-3}
    assert heavy.plant["m"] == pytest.approx(1.2 * 2.0)
    assert weak.tau.max() == pytest.approx(0.8 * first.tau.max())
    assert (first.verdict.word, sampled.verdict.word, late.verdict.word) == ("held", "held", "held")
    assert (heavy.verdict.word, weak.verdict.word) == ("not held", "limited")
    assert noisy.shares.max() != sampled.shares.max()


def test_the_command_prints_a_table(monkeypatch, tmp_path, capsys):
    file = tmp_path / "cart.py"
    file.write_text(
        "import casadi as ca\nimport servogen as sg\nx, v, f = (ca.SX.sym(n) for n in 'xvf')\n"
        "mech = sg.Mechanism(q=x, u=v, tau=f, Q=2, P=-0.5 * v, G=1)\n"
        "scene = sg.Scene('cart', mech, [sg.Holonomic('x', x, Theta1=-2.0, Theta2=-1.0)])\n"
        "simulation = sg.Simulation(start={'q': 1, 'u': 0}, duration=1.0, tolerance=1e-3)\n"
    )
    for options, code in ((("--json",), 0), ((), 0)):
        monkeypatch.setattr(sys, "argv", ["servogen", "verdicts", str(file), *options])
        with pytest.raises(SystemExit) as end:
            main.main()
        printed = capsys.readouterr().out
        assert int(end.value.code or 0) == code
        if options:
            told = json.loads(printed)["cart"]
            assert told["0.8 of the torque"]["word"] == "limited"
            assert "masses 20 % larger" not in told  # none has a mass for a parameter
        else:
            assert "noisy sensors" in printed
