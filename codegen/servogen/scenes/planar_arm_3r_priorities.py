"""The planar arm with priorities: its end follows a point, then the hand keeps a direction, then joints stand still.

Two rows, one and three for three torques: damping gets what is left where the arm is stretched out, and nothing
elsewhere, but never costs the end anything.
"""

from dataclasses import replace

import casadi as ca

import servogen as sg
from servogen.scenes.planar_arm_3r import arm, arm_run

_arm = arm("planar_arm_3r_priorities")
_q, _u = _arm.mechanism.q, _arm.mechanism.u

scene = replace(
    _arm,
    constraints=[
        *_arm.constraints,
        sg.Holonomic("posture", ca.sum1(_q) - 2.0, Theta1=-4.0, Theta2=-4.0, priority=1),
        sg.Nonholonomic("damping", _u, Theta=-2.0, priority=2),
    ],
)
simulation = arm_run(scene)
