"""The stress run: passes on the generated solver, is reproducible, and fails on solvers that are wrong."""

import json

import numpy as np
import pytest
from servogen.plan import textbook_solver
from servogen.plan.solver import plan_solver
from servogen.results import Info
from servogen.verify import stress

SMALL = ((1, 2), (2, 2), (2, 3), (3, 2))


class Textbook:
    """The textbook solver on stacks, with a place to spoil it. Rounded to the target type."""

    def __init__(self, m, l, scalar, solver, spoil=lambda x: x):
        self.plan, self.spoil = plan_solver(m, l, scalar, solver), spoil

    def solve(self, S, z, y=None, last=None):
        many = [
            textbook_solver.solve(S[i], z[i], None if y is None else y[i], self.plan, None if last is None else last[i])
            for i in range(len(S))
        ]
        return self.spoil(np.array([x for x, _ in many], self.plan.scalar)), [info for _, info in many]

    def pinv(self, S, last=None):
        many = [textbook_solver.pinv(S[i], self.plan, None if last is None else last[i]) for i in range(len(S))]
        return self.spoil(np.array([x for x, _ in many], self.plan.scalar)), [info for _, info in many]


def failures(report):
    return {(row.family, row.quantity) for row in report.rows if not row.passed}


def test_the_generated_solver_passes():
    report = stress.stress(systems=60, shapes=(*SMALL, (1, 3), (3, 3), (3, 7), (3, 8), (3, 4)))
    assert failures(report) == set()
    assert {row.family for row in report.rows} == set(stress.FAMILIES)


def test_the_same_seed_gives_the_same_report():
    run = lambda seed: stress.stress(seed=seed, systems=20, shapes=((2, 3),), families=("spectra",))  # noqa: E731
    assert run(3) == run(3)
    assert run(3) != run(4)


def test_report_is_json():
    report = stress.stress(systems=5, shapes=((1, 2),), families=("NaN and infinity",))
    shown = json.loads(json.dumps(report.to_json()))
    assert shown["passed"] is True
    assert shown["rows"][0].keys() >= {"family", "scalar", "quantity", "bar", "largest", "shape", "systems", "passed"}


def test_progress_counts_every_task():
    seen = []
    stress.stress(systems=3, shapes=((1, 2), (1, 3)), families=("spectra",), progress=lambda *what: seen.append(what))
    assert [(done, total) for done, total, _ in seen] == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert seen[0][2] == "spectra 1x2 float64"


def test_a_relative_error_of_a_few_ulps_fails():
    def make(m, l, scalar, solver):
        u = 2.0**-52 if scalar == "float64" else 2.0**-23
        return Textbook(m, l, scalar, solver, spoil=lambda x: (x * (1 + 16 * u)).astype(scalar))

    found = failures(stress.stress(make, systems=30, shapes=((1, 2), (2, 3)), families=("spectra",)))
    assert ("spectra", stress.TAU) in found
    assert ("spectra", stress.RESIDUAL) in found


def test_a_wrong_rank_fails():
    class Wrong(Textbook):
        def solve(self, S, z, y=None, last=None):
            tau, infos = super().solve(S, z, y, last)
            return tau, [Info(i.status, i.path, i.rank + 1, i.sweeps, i.sigma_min, i.residual) for i in infos]

    found = failures(stress.stress(Wrong, systems=5, shapes=((2, 2),), families=("2x2 of 0 and +-1",)))
    assert ("2x2 of 0 and +-1", stress.RANK) in found


def test_touched_outputs_fail():
    def make(m, l, scalar, solver):
        return Textbook(m, l, scalar, solver, spoil=lambda x: x + 1)

    found = failures(stress.stress(make, systems=9, shapes=((2, 3),), families=("NaN and infinity",)))
    assert ("NaN and infinity", stress.TOUCHED) in found


def test_silent_nan_is_the_worst_figure():
    def make(m, l, scalar, solver):
        return Textbook(
            m,
            l,
            scalar,
            solver,
            spoil=lambda x: np.where(np.arange(len(x)).reshape(-1, *[1] * (x.ndim - 1)) == 0, np.nan, x).astype(scalar),
        )

    with pytest.raises(ValueError, match="not rational"):
        stress.stress(make, systems=4, shapes=((1, 2),), families=("spectra",), scalars=("float64",))


def test_unknown_families_are_named():
    with pytest.raises(ValueError, match="no family 'nonsense'; choose from spectra"):
        stress.stress(families=("nonsense",))
