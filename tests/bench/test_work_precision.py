"""The work-precision run: everyone takes part, errors are those of rationals, missing rivals are said."""

import dataclasses
import json
import math

import numpy as np
import pytest
from click.testing import CliRunner
from servogen import exact
from servogen.bench.solver import contenders, work_precision
from servogen.bench.solver.plot import STYLES, draw
from servogen.cli.main import cli
from servogen.report.solver_page import render_solver_page

pytestmark = pytest.mark.xdist_group("precision")  # one process makes the fixture


@pytest.fixture(scope="module")
def found(need_tool):
    need_tool("g++", "g++")
    return work_precision.measure([(2, 3)], ["float64"], systems=4, rounds=2, peers=False)


def test_every_contender_is_at_every_condition(found):
    names = {v.name for v in contenders.variants("float64")} | set(contenders.PYTHON) | {"casadi.pinv, generated C"}
    for kappa in work_precision.decades("float64"):
        assert {p.contender for p in found.facet("2x3", "float64", kappa)} == names
    assert names <= set(STYLES)


def test_times_and_errors_are_what_they_should_be(found):
    for p in found.points:
        assert 0 < p.median <= p.worst
        if p.contender == "servogen auto":
            assert p.error <= 4
    by = {(p.contender, p.kappa): p for p in found.points}
    assert by["casadi.pinv, generated C", 1e8].error > 1e3  # half the digits
    assert by["servogen NORMAL, unproven", 1e7].error > 10  # what the certificate is for
    assert by["servogen auto", 1.0].median < by["servogen SVD", 1.0].median


def test_refinement_is_cut_and_nothing_else(tmp_path):
    plain, bare = (v for v in contenders.variants("float64") if v.prefix in ("qr", "qr_bare"))
    text = contenders.generate(3, 4, "float64", plain, tmp_path).read_text()
    bare = dataclasses.replace(bare, prefix=plain.prefix)  # a longer name would break lines elsewhere
    cut = contenders.generate(3, 4, "float64", bare, tmp_path / "bare").read_text()
    assert "/* refined once" in text
    assert "/* refined once" not in cut
    left = iter(text.splitlines())
    assert all(line in left for line in cut.splitlines())  # lines are gone, and nothing else
    assert len(cut.splitlines()) > len(text.splitlines()) - 30


def test_errors_are_relative_and_exact():
    right = [exact.rational(np.array([3.0, 4.0]))] * 2
    tau = np.array([[3.0, 4.0 + 5e-12], [np.nan, 0.0]])
    errors = work_precision.relative_errors(tau, right)
    assert errors[0] == pytest.approx(1e-12, rel=1e-3)
    assert math.isinf(errors[1])


def test_systems_have_their_condition():
    S, z = work_precision.draw(2, 3, "float64", (1.0, 1e6), 8, np.random.default_rng(1))
    np.testing.assert_allclose(np.linalg.cond(S), np.repeat([1.0, 1e6], 8), rtol=1e-6)
    assert z.shape == (16, 2)


def test_a_library_that_is_not_here_is_said(monkeypatch, need_tool):
    need_tool("g++", "g++")
    gone = dataclasses.replace(contenders.LIBRARIES[0], probe="#include <no/such/header>")
    assert not gone.here("g++")
    monkeypatch.setattr(work_precision, "LIBRARIES", (gone,))
    monkeypatch.setattr(work_precision, "_measure_shape", lambda *given: [])
    assert "apt-get install libeigen3-dev" in work_precision.measure([(2, 3)], ["float64"]).missing[0]


@pytest.fixture(scope="module")
def few(found):
    return dataclasses.replace(found, points=tuple(p for p in found.points if p.kappa in (1.0, 10.0, 1e8)))


def test_plots_and_page(few, tmp_path):
    figures = draw(few, tmp_path)
    first = figures["2x3", "float64"].read_bytes()
    assert draw(few, tmp_path)["2x3", "float64"].read_bytes() == first
    page = render_solver_page(few, figures)
    assert "servogen QR (NORMAL in vain)" in page
    assert "http" not in page.replace("http://www.w3.org", "")


def test_the_command(tmp_path, monkeypatch, few):
    monkeypatch.setattr("servogen.cli.bench.measure", lambda shapes, **options: few)
    done = CliRunner().invoke(cli, ["bench", "--solver", "--shape", "2x3", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "servogen auto" in done.output
    assert json.loads((tmp_path / "solver" / "solver.json").read_text())["seed"] == 1
    assert (tmp_path / "solver" / "solver.html").exists()
    wrong = CliRunner().invoke(cli, ["bench", "--solver", "--shape", "1x99"])
    assert wrong.exit_code == 2
    assert "2 to 12 rows and no fewer columns" in wrong.output
