"""servogen certify and its budgets: what is held to none is said."""

import json

import pytest
from click.testing import CliRunner
from servogen.cli.main import cli
from servogen.errors import SceneError
from servogen.verify.board_certificate import BoardCertificate, EntryCost

ENTRY = EntryCost("control", 1300, 1200, 1400, 0, 100, 200, 180, (), {"total": 20}, 0.5, ())


def certificate(scene, board, scalar):
    return BoardCertificate(
        scene=scene, scalar=scalar, target=board, prefix=scene, math="own", compiler="gcc", flags=(), flash=3000,
        library=0, ram=0, state={}, functions={}, needs=(), entries=(ENTRY,), problems=(),
    )  # fmt: skip


@pytest.fixture
def certify(monkeypatch, tmp_path):
    """certify(*arguments): the command on a scene whose folder is empty, without an emulator."""
    monkeypatch.setattr("servogen.cli.certify.require_target", lambda board: None)
    monkeypatch.setattr("servogen.cli.certify.load_scene", lambda name: name)
    monkeypatch.setattr("servogen.cli.certify.scene_folder", lambda name: tmp_path)
    monkeypatch.setattr(
        "servogen.cli.certify.certify",
        lambda scene, boards: [certificate(scene, b, s) for b in boards for s in ("float64", "float32")],
    )
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: CliRunner().invoke(cli, ["certify", "arm", *arguments])


def test_without_a_budget_a_line_says_so(certify):
    done = certify()
    assert done.exit_code == 0
    lines = [line for line in done.output.splitlines() if line.startswith("no budget held: ")]
    assert [line.split()[3] for line in lines] == ["arm.cortex-m4.float64", "arm.cortex-m4.float32"]
    assert all("budget.toml" in line and "--accept writes it" in line for line in lines)


def test_what_is_accepted_is_held(certify, tmp_path):
    assert "no budget held" not in certify("--accept").output
    assert (tmp_path / "budget.toml").is_file()
    assert json.loads(certify("--json").stdout)["no_budget"] == []
    said = json.loads(certify("--json", "--target", "cortex-m7").stdout)
    assert [text.split()[0] for text in said["no_budget"]] == ["arm.cortex-m7.float64", "arm.cortex-m7.float32"]
    assert said["passed"]


def test_a_budget_that_does_not_exist_is_wrong_input(certify, tmp_path):
    done = certify("--budget", "budgte.toml")
    assert isinstance(done.exception, SceneError)
    assert "no budget budgte.toml" in str(done.exception)
    assert certify("--budget", "new.toml", "--accept").exit_code == 0
    assert certify("--budget", "new.toml").exit_code == 0
    assert not (tmp_path / "budget.toml").exists()
