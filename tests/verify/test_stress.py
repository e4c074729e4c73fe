"""The stress run: passes on the generated solver, is reproducible and resumable, and fails on wrong solvers."""

import dataclasses
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import servogen as sg
from click.testing import CliRunner
from servogen import exact
from servogen.cli.main import cli
from servogen.report.stress import CLAIMS, render_stress
from servogen.results import Info
from servogen.textbook import pseudo_inverse
from servogen.textbook.policy import policy_for
from servogen.tools import ToolMissing
from servogen.verify import stress
from servogen.verify.stress import bars, core, journal, matrices

SMALL = ((1, 2), (2, 2), (2, 3), (3, 2))


class Textbook:
    """The textbook solver on stacks, with a place to spoil it. Rounded to the target type."""

    def __init__(self, m, l, scalar, solver, spoil=lambda x: x):
        self.plan, self.spoil = policy_for(m, l, scalar, solver), spoil

    def solve(self, S, z, y=None, last=None):
        many = [
            pseudo_inverse.solve(S[i], z[i], None if y is None else y[i], self.plan, None if last is None else last[i])
            for i in range(len(S))
        ]
        return self.spoil(np.array([x for x, _ in many], self.plan.scalar)), [info for _, info in many]

    def pinv(self, S, last=None):
        many = [pseudo_inverse.pinv(S[i], self.plan, None if last is None else last[i]) for i in range(len(S))]
        return self.spoil(np.array([x for x, _ in many], self.plan.scalar)), [info for _, info in many]


def failures(report):
    return {(row.family, row.quantity) for row in report.rows if not row.passed}


def test_the_generated_solver_passes():
    report = stress.stress(systems=90, shapes=((2, 2), (2, 3), (3, 2)))
    assert failures(report) == set()
    assert report.passed
    assert {row.family for row in report.rows} == {name for name, f in stress.FAMILIES.items() if not f.long}


def test_a_long_row_sums_in_pairs():
    """One term after the other, twelve of them leave a residual of 2.1 eps |S| |tau|; the bar is 1.5."""
    report = stress.stress(systems=2500, shapes=((1, 12),), families=("dlatms spectra",), scalars=("float64",))
    assert failures(report) == set()


def test_products_of_integers_are_never_nearly_deficient():
    """Among the integers of 12 x 11 there are full ranks that float32's tolerance rightly takes for 10."""
    report = stress.stress(systems=1500, shapes=((12, 11),), families=("ddrvls pairs",), scalars=("float32",))
    assert failures(report) == set()


def test_integers_that_a_tolerance_would_take_for_deficient_are_told():
    assert matrices.nearly_deficient(np.array([[1000, 1001], [999, 1000]]), 1e5)  # determinant 1
    for A in ([[1, 2], [2, 4]], [[1, 2], [3, 4]], [[1, 0], [0, 0]], [[1, 2, 3], [4, 5, 6], [7, 8, 9]]):
        assert not matrices.nearly_deficient(np.array(A), 1e5)


def test_certificates_and_strict_compilers(need_tool, monkeypatch):
    """What only a campaign runs, on one shape."""
    need_tool("gcc", "gcc")
    need_tool("clang", "clang")
    from servogen.verify.stress import families

    for name in ("certificates", "every shape"):
        monkeypatch.setitem(families.FAMILIES, name, dataclasses.replace(families.FAMILIES[name], shapes=((2, 3),)))
    report = stress.stress(systems=50, families=("certificates", "every shape"), scalars=("float32",), long=True)
    assert report.passed
    figures = {row.quantity: row.systems for row in report.rows}
    assert figures[bars.FALSE_NORMAL] > 500
    assert figures[bars.FALSE_QR] > 500
    assert figures[bars.HIGH_BOUND] > 500
    assert figures[bars.LOW_BOUND] > 500
    assert figures[bars.IDLE] > 0
    assert figures[bars.COMPLAINTS] == 2


def test_limits_and_answers_that_are_not_the_best(monkeypatch):
    """A campaign's families of limits on one shape; a solver that only clips is found out."""
    from servogen.verify.stress import bench, families

    names = tuple(name for name in families.FAMILIES if name.startswith("limits: "))
    for name in names:
        monkeypatch.setitem(families.FAMILIES, name, dataclasses.replace(families.FAMILIES[name], shapes=((2, 3),)))
    assert stress.stress(systems=20, families=names, scalars=("float64",)).passed

    class Clipping:
        def solve(self, S, z, y, lower, upper, last, active):
            tau, info = sg.build_solver(2, 3).load().solve(S, z, y)
            mask = np.zeros(len(tau), int)
            return np.clip(tau, lower, upper), dataclasses.replace(info, active=mask)

    monkeypatch.setattr(bench, "built_with_limits", lambda m, l, scalar: Clipping())
    found = failures(stress.stress(systems=20, families=("limits: random",), scalars=("float64",)))
    assert {bars.OPTIMUM, bars.TAU_WITHIN, bars.FALSE_OPTIMUM} <= {quantity for _, quantity, *_ in found}


# ---- the same again, and going on --------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_report():
    run = lambda seed: stress.stress(Textbook, seed=seed, systems=20, shapes=((2, 3),), families=("dlatms spectra",))  # noqa: E731
    assert run(3) == run(3)
    assert run(3) != run(4)


def test_processes_and_dask_workers_give_the_same_report():
    program = Path(__file__).with_name("workers.py")
    done = subprocess.run([sys.executable, program], capture_output=True, text=True, timeout=300)
    assert done.stdout.endswith("equal\n"), done.stderr


def test_an_interrupted_run_goes_on_where_it_was(tmp_path):
    what = {"systems": 30, "shapes": SMALL, "families": ("graded rows", "dlatms spectra"), "scalars": ("float64",)}
    path = tmp_path / "journal.jsonl"
    made = []

    def failing(m, l, scalar, solver):
        if (m, l) == (2, 3):
            raise KeyboardInterrupt
        made.append((m, l))
        return Textbook(m, l, scalar, solver)

    def going_on(m, l, scalar, solver):
        made.append((m, l))
        return Textbook(m, l, scalar, solver)

    with pytest.raises(KeyboardInterrupt):
        stress.stress(failing, **what, journal=path)
    before = list(made)
    path.write_text(path.read_text() + '{"cut off as it was wri')
    assert stress.stress(going_on, **what, journal=path) == stress.stress(Textbook, **what)
    assert before
    assert sorted(made) == sorted(  # each task once
        (task.m, task.l) for task in stress.tasks(what["families"], SMALL, ("float64",), 30, 1)
    )


def test_an_interrupt_loses_nothing_finished(tmp_path):
    """SIGINT to the whole group, as Ctrl-C gives it, while two processes work."""
    argv = [sys.executable, "-m", "servogen.cli.main", "stress", "--systems", "2000000", "--jobs", "2", "--out", "."]
    argv += ["--family", "NaN and infinity"]
    path = tmp_path / "journal.jsonl"
    quiet = subprocess.DEVNULL
    run = subprocess.Popen(argv, cwd=tmp_path, start_new_session=True, stdout=quiet, stderr=quiet)
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and (not path.exists() or path.read_text().count("\n") < 4):
        time.sleep(0.05)
    os.killpg(run.pid, signal.SIGINT)
    assert run.wait(timeout=60) == 130
    lines = path.read_text().splitlines()
    assert len(lines) >= 4
    assert all(json.loads(line) for line in lines)


@pytest.mark.parametrize("damage", [b'{"a task": [1}\n', b"\xff\xfe\x00\n", b"[1, 2]\n", b'{"a task": 7}\n'])
def test_a_damaged_journal_is_put_aside(tmp_path, damage):
    path = tmp_path / "journal.jsonl"
    journal.Journal(path, 1).write("a task", [1])
    path.write_bytes(path.read_bytes() + damage)
    assert journal.Journal(path, 1).found == {}
    assert (tmp_path / "journal.jsonl.old").exists()


def test_a_journal_of_another_seed_is_put_aside(tmp_path):
    path = tmp_path / "journal.jsonl"
    journal.Journal(path, 1).write("a task", [1])
    assert journal.Journal(path, 1).found == {"a task": [1]}
    assert journal.Journal(path, 2).found == {}
    assert (tmp_path / "journal.jsonl.old").exists()


def test_tasks_are_shared_by_the_shapes_and_cut_into_parts():
    work = stress.tasks(("dlatms spectra", "2x2 of 0 and +-1"), SMALL, ("float64",), 3000, 1)
    assert sum(t.systems for t in work if t.family == "dlatms spectra") == 3000
    assert all(t.systems <= 250 for t in work)
    assert [t.part for t in work] == sorted(t.part for t in work)
    assert sum(t.family == "2x2 of 0 and +-1" for t in work) == 1
    assert len({str(t) for t in work}) == len(work)


def test_progress_counts_every_task():
    seen = []
    what = {"systems": 3, "shapes": ((1, 2), (1, 3)), "families": ("dlatms spectra",)}
    stress.stress(Textbook, **what, progress=lambda *told: seen.append(told))
    assert [(done, total) for done, total, _ in seen] == [(1, 4), (2, 4), (3, 4), (4, 4)]
    assert seen[0][2] == "dlatms spectra 1x2 float64"


# ---- what it says ------------------------------------------------------------------------------------------------


def test_report_is_json_and_a_page():
    report = stress.stress(Textbook, systems=5, shapes=((1, 2),), families=("NaN and infinity", "dlatms spectra"))
    shown = json.loads(json.dumps(report.to_json()))
    assert shown["passed"] is True
    assert shown["rows"][0].keys() >= {"family", "scalar", "quantity", "bar", "largest", "shape", "systems", "passed"}
    page = render_stress(report)
    assert "All figures within their bars" in page
    assert bars.RESIDUAL in page


def test_the_command(tmp_path):
    done = CliRunner().invoke(cli, ["stress", "--family", "subnormal 2x2", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "all within their bars" in done.output
    assert json.loads((tmp_path / "stress.json").read_text())["passed"] is True
    assert "subnormal 2x2" in (tmp_path / "stress.html").read_text()
    wrong = CliRunner().invoke(cli, ["stress", "--family", "nonsense"])
    assert wrong.exit_code == 2
    assert "choose from: dlatms spectra" in wrong.output


def test_every_claim_of_the_page_has_one_bar():
    for _, quantities in CLAIMS:
        assert len({bars.BARS[q] for q in quantities}) == 1


# ---- it can fail -------------------------------------------------------------------------------------------------


def test_a_relative_error_of_a_few_ulps_fails():
    def make(m, l, scalar, solver):
        eps = 2.0**-52 if scalar == "float64" else 2.0**-23
        return Textbook(m, l, scalar, solver, spoil=lambda x: (x * (1 + 16 * eps)).astype(scalar))

    found = failures(stress.stress(make, systems=60, shapes=((1, 2), (2, 3)), families=("dlatms spectra",)))
    assert ("dlatms spectra", bars.TAU) in found
    assert ("dlatms spectra", bars.RESIDUAL) in found


def test_a_wrong_rank_fails():
    class Wrong(Textbook):
        def solve(self, S, z, y=None, last=None):
            tau, infos = super().solve(S, z, y, last)
            return tau, [Info(i.status, i.path, i.rank + 1, i.sweeps, i.sigma_min, i.residual) for i in infos]

    found = failures(stress.stress(Wrong, systems=5, shapes=((2, 2),), families=("2x2 of 0 and +-1",)))
    assert ("2x2 of 0 and +-1", bars.RANK) in found


def test_touched_outputs_fail():
    def make(m, l, scalar, solver):
        return Textbook(m, l, scalar, solver, spoil=lambda x: x + 1)

    found = failures(stress.stress(make, systems=9, shapes=((2, 3),), families=("NaN and infinity",)))
    assert ("NaN and infinity", bars.TOUCHED) in found


def test_silent_nan_is_the_worst_figure():
    def make(m, l, scalar, solver):
        return Textbook(
            m,
            l,
            scalar,
            solver,
            spoil=lambda x: np.where(np.arange(len(x)).reshape(-1, *[1] * (x.ndim - 1)) == 0, np.nan, x).astype(scalar),
        )

    report = stress.stress(make, systems=4, shapes=((1, 2),), families=("dlatms spectra",), scalars=("float64",))
    assert {row.quantity: row.largest for row in report.rows}[bars.TAU] == float("inf")
    assert not report.passed


def test_unknown_families_are_named():
    with pytest.raises(ValueError, match="no family 'nonsense'; choose from dlatms spectra"):
        stress.stress(families=("nonsense",))


# ---- its parts ---------------------------------------------------------------------------------------------------


def test_spectra_have_the_singular_values_they_should():
    generator = np.random.default_rng(1)
    sigma = matrices.spectra(24, 3, 1e6, generator)
    S = matrices.with_spectra(3, 5, sigma, generator)
    found = np.linalg.svd(S, compute_uv=False)
    np.testing.assert_allclose(found, np.sort(sigma, axis=1)[:, ::-1], atol=1e-14)


def test_named_matrices_keep_their_condition_when_permuted():
    for index in range(len(matrices.CLASSICAL)):
        plain = matrices.classical(3, 4, index, np.random.default_rng(index))
        again = matrices.classical(3, 4, index + len(matrices.CLASSICAL), np.random.default_rng(index))
        assert np.linalg.cond(plain) == pytest.approx(np.linalg.cond(again), rel=1e-3)


@pytest.mark.parametrize("shape", [(2, 3), (3, 3), (3, 2)])
def test_the_svd_inside_is_numpys(shape, need_tool):
    need_tool("gcc", "gcc")
    S = np.random.default_rng(2).standard_normal((50, *shape))
    U, sigma, V, rank = core.decompose(S, "float64")
    np.testing.assert_allclose(sigma, np.linalg.svd(S, compute_uv=False), rtol=1e-13)
    np.testing.assert_allclose(U.transpose(0, 2, 1) @ (sigma[:, :, None] * V), S, atol=1e-14)
    assert (rank == min(shape)).all()


def test_truth_of_a_product_is_that_of_the_echelon_form():
    for B, C in itertools.islice(
        (matrices.integer_factors(3, 4, 2, 1e5, np.random.default_rng(k)) for k in itertools.count()), 5
    ):
        left = exact.pinv(exact.rational(B @ C))
        assert left == exact.pinv_product(exact.rational(B), exact.rational(C))


def test_an_error_in_a_process_reaches_the_caller():
    with pytest.raises(ZeroDivisionError):
        stress.stress(broken, systems=5, shapes=((2, 3),), families=("dlatms spectra",), jobs=2)


def broken(m, l, scalar, solver):
    raise ZeroDivisionError


def test_a_missing_compiler_is_said_before_the_hours(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(ToolMissing, match="apt-get install"):
        stress.stress(broken, systems=5, shapes=((2, 3),), families=("dlatms spectra", "certificates"))
    with pytest.raises(ToolMissing, match="apt-get install clang"):
        stress.stress(broken, systems=5, shapes=((2, 3),), families=("dlatms spectra",), fuzzing=10)
