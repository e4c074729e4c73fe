"""`servogen`: the command."""

import errno
import os
import subprocess
import sys
import traceback
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import NoReturn

import click

from servogen.cli.console import (
    FAILED,
    GOOD,
    INTERNAL,
    INTERRUPTED,
    UNREAD,
    WRONG_INPUT,
    complain,
    emit_json,
    show_warnings,
)
from servogen.errors import SceneError
from servogen.simulate.board import BoardRunError
from servogen.tools import CompilerRefused, CompilerUnusable, ToolMissing
from servogen.verify.harness import HarnessBuildError, VectorsTooLarge
from servogen.version import VERSION

COMMANDS = {
    "list": ("generate", "list_scenes"),
    "generate": ("generate", "generate"),
    "solver": ("generate", "solver"),
    "analyse": ("analyse", "analyse_command"),
    "check": ("check", "check_command"),
    "simulate": ("simulate", "simulate_command"),
    "verdicts": ("verdicts", "verdicts_command"),
    "bench": ("bench", "bench_command"),
    "stress": ("stress", "stress_command"),
    "certify": ("certify", "certify_command"),
    "report": ("report", "report_command"),
}
"""Name -> its file in cli/ and the function there."""


class Commands(click.Group):
    """The subcommands, each imported when it is asked for: who generates need not wait for plots."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            close = get_close_matches(name, COMMANDS, 1)
            hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(COMMANDS)}"
            raise click.UsageError(f"no command {name!r}; {hint}", ctx)
        file, function = COMMANDS[name]
        found = getattr(import_module(f"servogen.cli.{file}"), function)
        assert isinstance(found, click.Command)
        return found


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(VERSION, prog_name="servogen")
def cli() -> None:
    """From servo-constraints on a mechanical model, written in CasADi, to dependency-free C.

    SCENE is a built-in name (servogen list) or path/to/file.py[:variable].
    Exit codes: 0 good, 1 a check failed, 2 wrong input, 3 an error of servogen itself, 130 interrupted.
    """


def main() -> None:
    """Run the command; whatever goes wrong ends in one line (with --json in one object) and its exit code."""
    show_warnings()
    try:
        # without its standalone mode click hands back the code of click.exceptions.Exit
        code = cli(standalone_mode=False)
    except SystemExit:  # click's way where nobody reads standard output any more
        sys.exit(UNREAD)
    except click.Abort:
        _end("interrupted", INTERRUPTED, kind="servogen")
    except click.ClickException as error:
        if not _as_json():
            error.show()
        _end(error.format_message(), WRONG_INPUT, said=not _as_json())
    except (SceneError, ToolMissing, CompilerUnusable, VectorsTooLarge) as error:
        _end(str(error), WRONG_INPUT)
    except OSError as error:
        _end(_refused(error), WRONG_INPUT)
    except (HarnessBuildError, CompilerRefused, BoardRunError) as error:
        _end(str(error), FAILED)
    except subprocess.CalledProcessError as error:
        said = error.stderr.decode(errors="replace") if isinstance(error.stderr, bytes) else error.stderr or ""
        _end(f"{error.cmd[0]} failed with exit code {error.returncode}\n{said.strip()}".strip(), FAILED)
    except Exception as error:
        if os.environ.get("SERVOGEN_TRACEBACK") == "1":
            traceback.print_exc()
        what = " ".join(f"{type(error).__name__}: {error}".split())
        _end(f"{what}; please report it with what SERVOGEN_TRACEBACK=1 prints", INTERNAL, kind="internal error")
    sys.exit(code if isinstance(code, int) else GOOD)


def _as_json() -> bool:
    """Whether the user asked for JSON: known before, and even where, the arguments cannot be read."""
    return "--json" in sys.argv[1:]


def _refused(error: OSError) -> str:
    """What the system said, and the remedy where it did not let us write."""
    if error.filename is None and _while_printing(error):
        return f"standard output: {error.strerror}; make room where it goes"
    path = error.filename or _written(error)
    if path and error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return f"{path}: {error.strerror}; name a folder that you may write to with --out"
    if path and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"{path}: {error.strerror}; make room there, or name another folder (--out; temporary files: TMPDIR)"
    return f"{path}: {error.strerror}" if path and error.strerror else str(error)


def _while_printing(error: OSError) -> bool:
    """Whether it was words for standard output that could not be written: rich's, or our JSON."""
    *_, (frame, _line) = traceback.walk_tb(error.__traceback__)
    code = frame.f_code
    return code is emit_json.__code__ or "rich" in Path(code.co_filename).parts


def _written(error: OSError) -> Path | None:
    """The file that could not be written, which the system does not tell: the innermost path of the failed calls."""
    paths: list[Path] = []
    for frame, _ in traceback.walk_tb(error.__traceback__):
        paths += [value for value in frame.f_locals.values() if isinstance(value, Path)]
    return paths[-1] if paths else None


def _end(message: str, code: int, said: bool = False, kind: str = "error") -> NoReturn:
    if _as_json():
        emit_json({"error": message if kind == "error" else f"{kind}: {message}"})
    elif not said:
        complain(kind, message)
    sys.exit(code)


if __name__ == "__main__":
    main()
