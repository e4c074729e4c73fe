"""What analysers find in generated C is listed with its reason; and what is not listed is found."""

from pathlib import Path

import pytest
import servogen as sg
from servogen.loading import load_scene
from servogen.verify.evidence import Finding, coverage, listed, misra, tidy, unlisted

pytestmark = pytest.mark.xdist_group("evidence")  # one process makes the fixture


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    package = sg.build(load_scene("double_pendulum_energy"), tmp_path_factory.mktemp("evidence"), "float32")
    return package.path / f"{package.prefix}.c"


def test_no_required_rule_is_broken_without_a_reason(source, need_tool):
    need_tool("cppcheck", "cppcheck")
    findings = misra([source])
    assert findings, "no finding at all: the addon did not run"
    assert unlisted(findings) == []


def test_clang_tidy(source, need_tool):
    need_tool("clang-tidy", "clang-tidy")
    assert unlisted(tidy([source])) == []


def test_what_is_not_listed_is_found(tmp_path, need_tool):
    need_tool("cppcheck", "cppcheck")
    file = Path(tmp_path) / "bad.c"
    file.write_text('#include <stdio.h>\nint main(void)\n{\n    int x = 010;\n    if (x) return printf("%d", x);\n}\n')
    rules = {f.rule for f in unlisted(misra([file]))}
    assert {"7.1", "21.6"} <= rules
    assert unlisted([Finding("x.c", 1, "bugprone-unheard-of")])


def test_every_reason_is_one():
    for kind in ("misra", "tidy"):
        for rule in listed()[kind].values():
            assert "reason" not in rule or len(rule["reason"]) >= 20


def test_every_branch_of_the_solver_is_taken_or_has_its_reason():
    total, taken, missed = coverage()
    assert taken > 0.9 * total
    assert total - taken == len(missed)
    assert [b for b in missed if not b.reason] == []
