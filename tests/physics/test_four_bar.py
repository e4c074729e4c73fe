"""The four-bar linkage against its motion in one coordinate, the crank's angle, derived apart and to 50 digits."""

from typing import Any

import mpmath as mp
import numpy as np
import pytest
import servogen as sg
from servogen.loading import load_scene
from servogen.simulate.closed_loop import ClosedLoop
from servogen.simulate.wanted import load_simulation

DIGITS = 50


def angles(theta: Any, L: Any) -> tuple[Any, Any, Any]:
    """Crank, coupler and rocker by the law of cosines, with the rocker above: no iteration."""
    x, y = L[1] * mp.cos(theta) - L[0], L[1] * mp.sin(theta)
    diagonal = mp.sqrt(x * x + y * y)
    inner = mp.acos((diagonal**2 + L[3] ** 2 - L[2] ** 2) / (2 * diagonal * L[3]))
    rocker = mp.atan2(y, x) - inner if mp.atan2(y, x) > 0 else mp.atan2(y, x) + 2 * mp.pi - inner
    coupler = mp.atan2(L[3] * mp.sin(rocker) - y, L[0] + L[3] * mp.cos(rocker) - L[1] * mp.cos(theta))
    return theta, coupler, rocker


def torque(theta: Any, speed: Any, acceleration: Any, m: Any, L: Any, g: Any) -> Any:
    """d/dt of the kinetic energy and of the height's, over the speed: M theta'' + M' theta'^2 / 2 + V'."""

    def centres(t: Any) -> list[Any]:
        a, b, c = angles(t, L)
        joint = L[1] * mp.cos(a), L[1] * mp.sin(a)
        return [
            joint[0] / 2, joint[1] / 2, joint[0] + L[2] * mp.cos(b) / 2, joint[1] + L[2] * mp.sin(b) / 2,
            L[0] + L[3] * mp.cos(c) / 2, L[3] * mp.sin(c) / 2, a, b, c,
        ]  # fmt: skip

    def inertia(t: Any) -> Any:
        slopes = [mp.diff(lambda s, k=k: centres(s)[k], t) for k in range(9)]
        weights = [m[0], m[0], m[1], m[1], m[2], m[2], *(m[k] * L[k + 1] ** 2 / 12 for k in range(3))]
        return sum(w * s * s for w, s in zip(weights, slopes, strict=True))

    def height(t: Any) -> Any:
        return g * sum(m[k] * centres(t)[2 * k + 1] for k in range(3))

    return inertia(theta) * acceleration + mp.diff(inertia, theta) * speed**2 / 2 + mp.diff(height, theta)


def numbers() -> tuple[Any, Any, Any]:
    given = {f.name: mp.mpf(repr(f.default[0])) for f in load_scene("four_bar").parameters}
    return [given[f"m_{k}"] for k in (1, 2, 3)], [given[f"L_{k}"] for k in range(4)], given["g"]


def test_torque_and_kinematics_in_the_minimal_coordinate() -> None:
    scene = load_scene("four_bar")
    twins = sg.build(scene).load(), sg.reference(scene)
    with mp.workdps(DIGITS):
        m, L, g = numbers()
        for theta, speed, wanted in ((0.5, 2.0, -1.0), (-2.0, 3.5, 4.0), (3.0, -1.5, 0.5), (1.4, 0.0, 7.0)):
            rates = [mp.diff(lambda t, k=k: angles(t, L)[k], theta) for k in range(3)]
            q = [float(a) for a in angles(mp.mpf(theta), L)]
            u = [float(r * mp.mpf(speed)) for r in rates]
            expected = float(torque(mp.mpf(theta), mp.mpf(speed), mp.mpf(wanted), m, L, g))
            for twin in twins:
                assert np.max(np.abs(twin.closure(q=q, u=u))) < 1e-15 * 10
                answer = twin.control(q=q, u=u, speed=speed, speed_dot=wanted)
                assert answer.info.status == sg.Status.OK
                assert abs(answer.value[0] - expected) < 1e-10 * max(1.0, abs(expected))


def test_the_loop_stays_closed_over_turns_of_the_crank() -> None:
    scene, simulation = load_simulation("four_bar")
    loop = ClosedLoop(scene, simulation)
    with pytest.raises(
        sg.SceneError, match=r"passive constraints \('loop'\) are off by 4\.\d+, and Newton's method finds no"
    ):
        loop.run(plant={"L_0": 5.0})
    run = loop.run()
    assert run.verdict.held
    assert run.q[-1, 0] > run.q[0, 0] + 2 * np.pi
    assert np.max(run.drift) < 1e-8
    with mp.workdps(20):
        _, L, _ = numbers()
        for row in (0, len(run.t) // 3, -1):
            theta = float(run.q[row, 0])
            turned = [float(a) for a in angles(mp.mpf(theta), L)]
            np.testing.assert_allclose(np.exp(1j * run.q[row]), np.exp(1j * np.array(turned)), rtol=0, atol=1e-8)
