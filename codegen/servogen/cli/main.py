"""`servogen`: the command."""

import subprocess
import sys
from typing import NoReturn

import click

from servogen.cli.bench import bench_command
from servogen.cli.certify import certify_command
from servogen.cli.check import check_command
from servogen.cli.console import FAILED, GOOD, WRONG_INPUT, complain, emit_json, show_warnings
from servogen.cli.generate import generate, list_scenes, solver
from servogen.cli.report import report_command
from servogen.cli.simulate import simulate_command
from servogen.cli.stress import stress_command
from servogen.errors import SceneError
from servogen.simulate.board import BoardRunError
from servogen.tools import ToolMissing
from servogen.twins.compiled import CompilerRefused
from servogen.verify.harness import HarnessBuildError, VectorsTooLarge
from servogen.version import VERSION


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(VERSION, prog_name="servogen")
def cli() -> None:
    """From servo-constraints on a mechanical model, written in CasADi, to dependency-free C.

    SCENE is a built-in name (servogen list) or path/to/file.py[:variable].
    Exit codes: 0 good, 1 a check failed, 2 wrong input.
    """


for command in (
    list_scenes,
    generate,
    solver,
    check_command,
    simulate_command,
    bench_command,
    stress_command,
    certify_command,
    report_command,
):
    cli.add_command(command)


def main() -> None:
    """Run the command; wrong input ends in one line (with --json in one object) and exit code 2."""
    show_warnings()
    try:
        # without its standalone mode click hands back the code of click.exceptions.Exit
        code = cli(standalone_mode=False)
    except click.Abort:
        sys.exit(130)
    except click.ClickException as error:
        if not _as_json():
            error.show()
        _end(error.format_message(), WRONG_INPUT, said=not _as_json())
    except (SceneError, ToolMissing, VectorsTooLarge, OSError) as error:
        _end(str(error), WRONG_INPUT)
    except (HarnessBuildError, CompilerRefused, BoardRunError) as error:
        _end(str(error), FAILED)
    except subprocess.CalledProcessError as error:
        said = error.stderr.decode(errors="replace") if isinstance(error.stderr, bytes) else error.stderr or ""
        _end(f"{error.cmd[0]} failed with exit code {error.returncode}\n{said.strip()}".strip(), FAILED)
    sys.exit(code if isinstance(code, int) else GOOD)


def _as_json() -> bool:
    """Whether the user asked for JSON: known before, and even where, the arguments cannot be read."""
    return "--json" in sys.argv[1:]


def _end(message: str, code: int, said: bool = False) -> NoReturn:
    if _as_json():
        emit_json({"error": message})
    elif not said:
        complain("error", message)
    sys.exit(code)


if __name__ == "__main__":
    main()
