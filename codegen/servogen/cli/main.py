"""`servogen`: the command."""

import sys

import click

from servogen.cli.bench import bench_command
from servogen.cli.certify import certify_command
from servogen.cli.check import check_command
from servogen.cli.console import FAILED, GOOD, WRONG_INPUT, complain, show_warnings
from servogen.cli.generate import generate, list_scenes, solver
from servogen.cli.report import report_command
from servogen.cli.simulate import simulate_command
from servogen.cli.stress import stress_command
from servogen.errors import SceneError
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
    """Run the command; wrong input ends in one line and exit code 2."""
    show_warnings()
    try:
        # without its standalone mode click hands back the code of click.exceptions.Exit
        code = cli(standalone_mode=False)
    except click.Abort:
        sys.exit(130)
    except click.ClickException as error:
        error.show()
        sys.exit(WRONG_INPUT)
    except (SceneError, ToolMissing) as error:
        complain("error", str(error))
        sys.exit(WRONG_INPUT)
    except (VectorsTooLarge, OSError) as error:
        complain("error", str(error))
        sys.exit(WRONG_INPUT)
    except (HarnessBuildError, CompilerRefused) as error:
        complain("error", str(error))
        sys.exit(FAILED)
    sys.exit(code if isinstance(code, int) else GOOD)


if __name__ == "__main__":
    main()
