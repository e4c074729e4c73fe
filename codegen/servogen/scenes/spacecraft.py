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
    K_dot = ca.dot(inertia * omega, P + tau)
    return sg.Scene(
        name,
        sg.Mechanism(q=angle, u=omega, tau=tau, Q=ca.DM.eye(3), P=P, G=ca.DM.eye(3)),
        [sg.ControlsInvolved("energy_decay", K_dot + par.a * K, Theta=Theta)],
        parameters=par,
        y=-tau if smooth else None,
        domain={"q": (-1.0, 1.0), "u": (-0.5, 0.5), "tau": (-1.0, 1.0)},
    )


scene = stabilisation("spacecraft", smooth=False)
