"""What is published about Andrews' squeezing mechanism, examples/andrews_squeezer.py.

The test set for initial value problem solvers; q: beta, theta, gamma, phi, delta, omega, epsilon.
"""

from pathlib import Path

import servogen as sg
from servogen.loading import load_scene

START = [
    -0.0617138900142764496358948458001, 0.0, 0.455279819163070380255912382449, 0.222668390165885884674473185609,
    0.487364979543842550225598953530, -0.222668390165885884674473185609, 1.23054744454982119249735015568,
]  # fmt: skip
END = [
    15.8107711941, -15.7563710598, 0.0408222400731, -0.534730116323, 0.524409965881, 0.534730116323, 1.04808074104,
]  # fmt: skip
"""q at 0.03 s under a torque of 0.033."""

TORQUE = 0.033
ACCELERATIONS = 14222.4439199541138705911625887, -10666.8329399655854029433719415
"""beta'' and theta'' at the start under that torque."""
MULTIPLIERS = [98.5668703962410896057654982170, -6.12268834425566265503114393122, 0, 0, 0, 0]
"""At the start under that torque, where M q'' = f - J^T lambda."""


def scene() -> sg.Scene:
    """The mechanism, beta' of which is to follow a reference, by the torque on beta."""
    return load_scene(str(Path(__file__).parents[2] / "examples" / "andrews_squeezer.py"))
