"""Mechanisms whose outputs are of a relative degree above two, with what is known of them in closed form."""

from typing import Any

import casadi as ca
import numpy as np
import servogen as sg


def thetas(degree: int, rate: float) -> list[float]:
    """Theta with all eigenvalues at -rate."""
    return [-float(c) for c in np.poly([-rate] * degree)[:0:-1]]


def cars(count: int, passive: tuple[Any, ...] = ()) -> sg.Mechanism:
    """Cars in a row, coupled by springs: masses 1, 2, 3, ... kg, 5 N/m, the force on the last one."""
    q, u = ca.SX.sym("q", count), ca.SX.sym("u", count)
    stretch = 5.0 * (q[1:] - q[:-1])
    P = ca.vertcat(stretch, 0) - ca.vertcat(0, stretch)
    Q = ca.diag(ca.DM(range(1, count + 1)))
    G = ca.DM.eye(count)[:, -1]
    return sg.Mechanism(q, u, ca.SX.sym("F"), Q=Q, P=P, G=G, passive=[make(q) for make in passive])


def cars_scene(count: int, degree: int, passive: tuple[Any, ...] = ()) -> sg.Scene:
    """The position of the first one prescribed."""
    mech, ref = cars(count, passive), sg.References(r=sg.Ref(0.0, order=degree))
    first = sg.Output("first", mech.q[0] - ref.r, thetas(degree, 2.0))
    return sg.Scene(f"cars_{count}", mech, [first], references=ref)


def flexible_joint_arm() -> sg.Scene:
    """Two rods in a vertical plane, each driven through a spring by a rotor; its end follows a path: degree 4.

    q: the angles of rods and rotors to the horizontal, so that the second rotor turns with the first rod.
    """
    par = sg.Parameters(m=[2.0, 1.0], l=[0.5, 0.4], B=[0.3, 0.2], k=[200.0, 150.0], g=9.81)
    ref = sg.References(r=sg.Ref([0.5, 0.3], order=4))
    rods, rotors = ca.SX.sym("rod", 2), ca.SX.sym("rotor", 2)
    u, rotor_speeds = ca.SX.sym("rod_speed", 2), ca.SX.sym("rotor_speed", 2)
    tau = ca.SX.sym("tau", 2)
    M, h, end = rod_dynamics(rods, u, par)
    pull = par.k * (rotors - rods)
    mech = sg.Mechanism(
        q=ca.vertcat(rods, rotors), u=ca.vertcat(u, rotor_speeds), tau=tau,
        Q=ca.diagcat(M, ca.diag(par.B)), P=ca.vertcat(pull - h, -pull), G=ca.vertcat(ca.SX(2, 2), ca.SX.eye(2)),
    )  # fmt: skip
    output = sg.Output("end", end - ref.r, thetas(4, 6.0))
    domain = {"q": ([-0.5, 0.8, -0.5, 0.8], [0.5, 1.8, 0.5, 1.8]), "u": (-3.0, 3.0)}
    return sg.Scene("flexible_joint_arm", mech, [output], parameters=par, references=ref, domain=domain)


def rod_dynamics(angle: Any, speed: Any, par: sg.Parameters) -> tuple[Any, Any, Any]:
    """M, h and end of  M speed' + h = torques on the rods: thin ones, hinged to a wall and to one another."""
    m, l, g = par.m, par.l, par.g
    own = m[0] * l[0] ** 2 / 3 + m[1] * l[0] ** 2
    coupling = m[1] * l[0] * l[1] / 2
    apart = angle[0] - angle[1]
    M = ca.blockcat([[own, coupling * ca.cos(apart)], [coupling * ca.cos(apart), m[1] * l[1] ** 2 / 3]])
    h = ca.vertcat(
        coupling * ca.sin(apart) * speed[1] ** 2 + (m[0] / 2 + m[1]) * g * l[0] * ca.cos(angle[0]),
        -coupling * ca.sin(apart) * speed[0] ** 2 + m[1] / 2 * g * l[1] * ca.cos(angle[1]),
    )
    end = ca.vertcat(*(l[0] * f(angle[0]) + l[1] * f(angle[1]) for f in (ca.cos, ca.sin)))
    return M, h, end


def crane() -> sg.Scene:
    """Both coordinates of an overhead crane's load by one holonomic constraint: their rows are dependent."""
    mech, load = crane_mechanism()
    ref = sg.References(p=sg.Ref([0.0, 4.0], order=4))
    domain = {"q": ([-2.0, 30.0, -0.5], [2.0, 60.0, 0.5]), "u": (-1.0, 1.0), "p": ([-1.0, 3.0], [1.0, 5.0])}
    held = sg.Holonomic("load", load - ref.p, -4.0, -4.0)
    return sg.Scene("crane", mech, [held], references=ref, domain=domain)


def crane_of_degrees(height: int, place: int) -> sg.Scene:
    """The same with an output for each, of these degrees; all errors decay at 2 per second."""
    mech, load = crane_mechanism()
    ref = sg.References(x=sg.Ref(0.0, order=4), z=sg.Ref(4.0, order=4))
    outputs = [
        sg.Output("height", load[1] - ref.z, thetas(height, 2.0)),
        sg.Output("place", load[0] - ref.x, thetas(place, 2.0)),
    ]
    domain = {"q": ([-2.0, 30.0, -0.3], [2.0, 60.0, 0.3]), "u": (-1.0, 1.0), "x": (-1.0, 1.0), "z": (3.0, 5.0)}
    return sg.Scene("crane", mech, outputs, references=ref, domain=domain)


def crane_mechanism() -> tuple[sg.Mechanism, Any]:
    """Force F on the trolley, torque M on the winch; and the load's place (x, z), z downwards.

    Load 100 kg, trolley 10 kg, winch of radius 0.1 m and 0.1 kg m^2. q: trolley, winch angle, angle of the rope.
    """
    q = ca.vertcat(ca.SX.sym("s"), ca.SX.sym("beta"), ca.SX.sym("theta"))
    u, rope = ca.SX.sym("u", 3), 0.1 * q[1]
    load = ca.vertcat(q[0] + rope * ca.sin(q[2]), rope * ca.cos(q[2]))
    T = 10 * u[0] ** 2 / 2 + 0.1 * u[1] ** 2 / 2 + 100 * ca.sumsqr(ca.jtimes(load, q, u)) / 2
    momentum = ca.gradient(T, u)
    P = ca.gradient(T, q) + 100 * 9.81 * ca.gradient(load[1], q) - ca.jtimes(momentum, q, u)
    tau = ca.vertcat(ca.SX.sym("F"), ca.SX.sym("M"))
    return sg.Mechanism(q, u, tau, Q=ca.hessian(T, u)[0], P=P, G=ca.DM.eye(3)[:, :2]), load


def crane_path(t: Any) -> Any:
    """From 0 to 1 in 6 s, Altmann and Heiland (2017): what the load's x is, and z - 4."""
    s = t / 6
    return sum(c * s ** (7 + k) for k, c in enumerate((1716, -9009, 20020, -24024, 16380, -6006, 924)))
