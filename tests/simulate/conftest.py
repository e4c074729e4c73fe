"""A mass on rails whose closed loop is known in closed form, and one that escapes to infinity."""

from collections.abc import Callable

import casadi as ca
import pytest
import servogen as sg
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.simulation import Simulation


def rail() -> tuple[sg.Scene, Simulation]:
    """m x'' = tau, and x goes to r as x'' = -3 x' - 2 (x - r): from rest at 0, x = r (1 - 2 exp(-t) + exp(-2t))."""
    par = sg.Parameters(m=sg.Parameter(2.0, "kg", "mass"))
    ref = sg.References(r=1.0)
    x, v, force = ca.SX.sym("x"), ca.SX.sym("v"), ca.SX.sym("F")
    scene = sg.Scene(
        "rail",
        sg.Mechanism(q=x, u=v, tau=force, Q=par.m, P=0, G=1),
        [sg.Holonomic("place", x - ref.r, Theta1=-3.0, Theta2=-2.0)],
        parameters=par,
        references=ref,
    )
    return scene, Simulation(
        start={"q": 0.0, "u": 0.0},
        duration=2.0,
        step=1e-3,
        outputs={"power, mechanical": force * v, "x": x},
        stop={"beyond": 3 - x, "half way": 0.5 * ref.r - x},
        units={"q": "m", "u": "m/s", "tau": "N", "psi": "m", "x": "m"},
    )


def escape() -> tuple[sg.Scene, Simulation]:
    """u_0' = tau is controlled, u_1' = u_1^3 is not: from 1 it is infinite at t = 1/2."""
    q, u, tau = ca.SX.sym("q", 2), ca.SX.sym("u", 2), ca.SX.sym("tau", 1)
    scene = sg.Scene(
        "escape",
        sg.Mechanism(q=q, u=u, tau=tau, Q=ca.SX.eye(2), P=ca.vertcat(0, u[1] ** 3), G=ca.vertcat(1, 0)),
        [sg.Nonholonomic("first", u[0], Theta=-1.0)],
    )
    return scene, Simulation(start={"q": [0, 0], "u": [1, 1]}, duration=1.0, step=1e-3)


def tracker() -> tuple[sg.Scene, Simulation]:
    """q follows r = (sin 2t, t^2), on which it starts; no parameters, no units."""
    q, u, tau = (ca.SX.sym(n, 2) for n in ("q", "u", "tau"))
    ref = sg.References(r=sg.Ref([0.0, 0.0], order=2))
    scene = sg.Scene(
        "tracker",
        sg.Mechanism(q=q, u=u, tau=tau, Q=ca.SX.eye(2), P=ca.SX.zeros(2), G=ca.SX.eye(2)),
        [sg.Holonomic("track", q - ref.r, Theta1=-3.0, Theta2=-2.0)],
        references=ref,
    )
    return scene, Simulation(
        start={"q": [0, 0], "u": [2, 0]},
        duration=2.0,
        step=2e-3,
        references={"r": lambda t: ca.vertcat(ca.sin(2 * t), t**2)},
        outputs={"r": ref.r[0]},
    )


@pytest.fixture(scope="session")
def own_scenes() -> dict[str, Callable[[], tuple[sg.Scene, Simulation]]]:
    """The scenes of this file by name."""
    return {"rail": rail, "escape": escape, "tracker": tracker}


@pytest.fixture(scope="session")
def tracker_loop() -> ClosedLoop:
    return ClosedLoop(*tracker())


@pytest.fixture(scope="session")
def rail_loop() -> ClosedLoop:
    return ClosedLoop(*rail())


@pytest.fixture(scope="session")
def escape_loop() -> ClosedLoop:
    return ClosedLoop(*escape())
