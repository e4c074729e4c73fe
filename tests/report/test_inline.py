"""Figures inside the page: what thinning keeps."""

import numpy as np
from servogen.report.inline import POINTS, thinned


def test_a_thinned_curve_keeps_its_ends_and_every_peak() -> None:
    t = np.linspace(0.0, 10.0, 20 * POINTS)
    y = np.sin(40 * t)
    y[777], y[12345] = 5.0, -7.0
    x, kept = thinned(t, y)
    assert len(x) <= POINTS + 2
    assert (x[0], x[-1], kept.max(), kept.min()) == (t[0], t[-1], 5.0, -7.0)
    assert np.all(np.diff(x) > 0)
    assert set(zip(x.tolist(), kept.tolist(), strict=True)) <= set(zip(t.tolist(), y.tolist(), strict=True))
    short = t[:POINTS], y[:POINTS]
    assert thinned(*short) is not None
    assert np.array_equal(thinned(*short)[1], short[1])
