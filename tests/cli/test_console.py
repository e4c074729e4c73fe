"""Tables at the width of a terminal."""

import io

import pytest
from rich.console import Console
from servogen.cli import bench, check, console
from servogen.verify.check import CheckReport, OutputCheck, SolveCheck

SCENES = ("crane", "double_pendulum_energy_and_path")
PROBLEM = "tau: 3 values beyond their bound, the first of them at state 17"
REPORT = CheckReport(
    states=500,
    boundary=("rest",),
    outputs=tuple(
        OutputCheck(scene, scalar, target, entry, output, 1041, 0.68521, 0.0685, 0.03123, "", (), problem)
        for scene in SCENES
        for scalar in ("float64", "float32")
        for target in ("gcc", "clang")
        for entry, output, problem in (("S", "S", ""), ("control", "tau", PROBLEM))
    ),
    solves=tuple(SolveCheck(scene, "float64", "gcc", 512, 0.0421) for scene in SCENES),
    differences=(),
    campaigns=(),
    problems=(),
    skipped=(),
)


@pytest.fixture
def printed(monkeypatch):
    """printed(width, show): what show() prints to a terminal of that width."""

    def call(width, show):
        page = io.StringIO()
        monkeypatch.setattr(console, "out", Console(file=page, width=width, highlight=False))
        monkeypatch.setattr(check, "out", console.out)
        show()
        return page.getvalue()

    return call


@pytest.mark.parametrize("width", [80, 100, 140])
def test_no_word_or_number_of_a_check_is_split(printed, width):
    page = printed(width, lambda: check.show(REPORT))
    assert max(map(len, page.splitlines())) <= width
    words = page.replace(",", " ").split()
    figures = ("1041", "0.685", "0.0685", "0.0312", "0.0421")
    for word in (*SCENES, "float64", "float32", "control", "tau", "clang", *figures):
        assert word in words, word
    assert words.count("0.0685") == 2 * 2 * 2  # gcc and clang agree: a row each of two outputs, scalars and scenes


def test_a_narrow_table_says_what_its_parts_are(printed):
    rows = [(scene, scalar, "control", "1" * 25, "2" * 25) for scene in "ab" for scalar in ("float64", "float32")]
    header = ("scene", "scalar", "function", "worst", "proven")
    page = printed(80, lambda: console.table("Costs", header, rows, right=(3, 4)))
    lines = [line.strip() for line in page.splitlines()]
    assert lines[0] == "Costs"
    assert [line for line in lines if line in ("a", "b")] == ["a", "b"]
    assert page.count("1" * 25) == page.count("2" * 25) == 4


def test_a_wide_table_parts_into_subjects(printed):
    header = ("", "contender", *(f"figure {k}" for k in range(9)))
    rows = [("S", "servogen f64", *(f"{k}.{'1' * 7}" for k in range(9)))]

    def show():
        console.table("Bench", header, rows, right=range(2, 11), apart=(5, 8))

    narrow, wide = printed(80, show), printed(200, show)
    assert max(map(len, narrow.splitlines())) <= 80
    assert narrow.count("Bench") == wide.count("Bench") == 1
    assert narrow.count("servogen f64") == 3
    assert wide.count("servogen f64") == 1
    for k in range(9):
        assert narrow.count(f"figure {k}") == narrow.count(f"{k}.1111111") == 1


def test_the_notes_of_a_bench_fit_into_a_terminal():
    assert max(map(len, bench.NOTES)) <= 78


def test_long_work_leaves_a_line_a_step_in_a_log(monkeypatch):
    def said(*options, **more):
        page = io.StringIO()
        monkeypatch.setattr(console, "err", Console(file=page, highlight=False))
        with console.progress(*options, **more) as advance:
            for done, text in enumerate(("crane: generate", "crane: closed loop")):
                advance(done, 2, text)
        return page.getvalue()

    assert said(False, logged=True) == "1 of 2: crane: generate\n2 of 2: crane: closed loop\n"
    assert said(True, logged=True) == said(False) == ""
