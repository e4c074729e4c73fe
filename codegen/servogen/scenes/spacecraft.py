"""Spacecraft whose kinetic energy K decays as K' + a K = 0: Bajodah et al. (2004), Section 6, Eqs. (42)-(54), y = 0.

The controls tau are torques divided by the moments of inertia, rad/s^2. With y = 0 they chatter (Figures 7-12);
spacecraft_smooth is the same with y = -tau.
"""

import casadi as ca

import servogen as sg


def stabilisation(name: str, smooth: bool, Theta: float = 0.0) -> sg.Scene:
    """phi = K' + a K on Euler's equations; y = -tau if smooth, else y = 0."""
    par = sg.Parameters(
        I_1=sg.Parameter(10.0, "kg m^2", "moment of inertia about the first principal axis"),
        I_2=sg.Parameter(6.3, "kg m^2", "moment of inertia about the second principal axis"),
        I_3=sg.Parameter(8.5, "kg m^2", "moment of inertia about the third principal axis"),
        a=sg.Parameter(1.0, "1/s", "rate at which the kinetic energy decays"),
    )
    angle, omega, tau = ca.SX.sym("angle", 3), ca.SX.sym("omega", 3), ca.SX.sym("tau", 3)
    I_1, I_2, I_3 = par.I_1, par.I_2, par.I_3
    P = ca.vertcat(
        (I_2 - I_3) / I_1 * omega[1] * omega[2],
        (I_3 - I_1) / I_2 * omega[2] * omega[0],
        (I_1 - I_2) / I_3 * omega[0] * omega[1],
    )
    inertia = ca.vertcat(I_1, I_2, I_3)
    K = ca.dot(inertia, omega**2) / 2
    K_dot = ca.jtimes(K, omega, P + tau)
    return sg.Scene(
        name,
        sg.Mechanism(q=angle, u=omega, tau=tau, Q=ca.DM.eye(3), P=P, G=ca.DM.eye(3)),
        [sg.ControlsInvolved("energy_decay", K_dot + par.a * K, Theta=Theta)],
        parameters=par,
        y=-tau if smooth else None,
        domain={"q": (-1.0, 1.0), "u": (-0.5, 0.5), "tau": (-1.0, 1.0)},
    )


def stabilisation_run(scene: sg.Scene, duration: float, step: float) -> sg.Simulation:
    """The paper's start (Section 6); its tau_3(0) = -0.3376 is rounded, and projected onto phi = 0 first."""
    par = scene.parameters
    assert par is not None
    inertia = ca.vertcat(par.I_1, par.I_2, par.I_3)
    return sg.Simulation(
        start={"q": [0.0, 0.0, 0.0], "u": [0.1, 0.1, 0.1], "tau": [0.1, 0.1, -0.3376]},
        duration=duration,
        step=step,
        outputs={"K": ca.dot(inertia, scene.mechanism.u**2) / 2},
        decay={"K": (-par.a, 0.0)},
        units={"q": "rad", "u": "rad/s", "tau": "rad/s^2", "phi": "W", "K": "J"},
    )


scene = stabilisation("spacecraft", smooth=False)
simulation = stabilisation_run(scene, duration=6.0, step=1e-4)  # beyond, a period of the chatter is too short to follow
