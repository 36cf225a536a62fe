"""All commands, each imported when it is used, and the one place that reports failures."""

from __future__ import annotations

import errno
import sys
from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from importlib import import_module

import click

from metrocli import __version__
from metrocli.cli.console import echo
from metrocli.cli.help import COMMANDS, MODULES, PACKAGES, example_of, help_text, version_text
from metrocli.cli.shell.progress_line import with_progress
from metrocli.cli.shell.signals import INTERRUPTED, TERMINATED, Terminated, ending
from metrocli.errors import NO_MEMORY, Fault, InputError, MetrocliError
from metrocli.tasks import KINDS

BROKEN_PIPE = 141
"""Exit code that shells give to programs ended by SIGPIPE"""


class Commands(click.Group):
    """All commands; help and completion list them without importing any."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*KINDS, *COMMANDS]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in KINDS:
            from metrocli.cli.job_command import make

            return _complete(make(cmd_name))
        if cmd_name not in COMMANDS:
            return None
        return _complete(import_module(module_of(cmd_name)).command)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in self.list_commands(ctx) and not args[0].startswith("-"):
            from metrocli.words import suggestion

            raise click.UsageError(f"no command '{args[0]}'; {suggestion(args[0], self.list_commands(ctx))}", ctx)
        return super().resolve_command(ctx, args)

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        formatter.write(help_text())


def _complete(command: click.Command) -> click.Command:
    """Return a command with its example in the help and, unless it has a table of its own, the progress line."""
    whole = copy(command)
    whole.epilog = example_of(str(command.name))
    if command.name != "run" and command.callback is not None:
        whole.callback = with_progress(command.callback)
    return whole


def module_of(command: str) -> str:
    """Return the module of a command that is not a kind of job."""
    return f"metrocli.cli.{PACKAGES.get(command, '')}{MODULES.get(command, command)}"


_CANNOT_WRITE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO)
"""Errors of a full, read-only or failing disk, also where stdout is redirected to it"""


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, message=version_text())
def commands() -> None:
    """All commands."""


def run(arguments: Sequence[str] | None = None) -> int:
    """Carry out one command line and return its exit code; every failure is printed to stderr.

    With --json a failure is also printed to stdout, as the summary that programs expect there.
    """
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    code, error = _carry_out(arguments)
    if error is not None and "--json" in arguments:
        _print_as_json(code, error)
    return code


def _print_as_json(code: int, error: Exception) -> None:
    import json

    faults = error.faults if isinstance(error, InputError) else ()
    message = error.format_message() if isinstance(error, click.ClickException) else str(error)
    errors = [fault.as_data() for fault in faults] or [{"message": message}]
    echo(json.dumps({"status": "error", "exit_code": code, "errors": errors}, indent=2, ensure_ascii=False))


def _carry_out(arguments: list[str]) -> tuple[int, Exception | None]:
    """Return the exit code of a command line, and the error that ended it."""
    try:
        with ending():
            code = commands.main(arguments, prog_name="metrocli", standalone_mode=False)
        return (code if isinstance(code, int) else 0), None
    except Terminated:
        echo("terminated", err=True)
        return TERMINATED, None
    except SystemExit as ended:
        # click raises this after it has completed a word, and when the reader of stdout has gone (head)
        return (0 if ended.code == 0 else BROKEN_PIPE), None
    except click.exceptions.Abort:
        echo("interrupted", err=True)
        return INTERRUPTED, None
    except click.ClickException as error:
        with suppress(OSError):
            error.show()
        return 2, error
    except InputError as error:
        echo(str(error), err=True)
        return error.exit_code, error
    except MetrocliError as error:
        echo(f"error: {error}", err=True)
        return error.exit_code, error
    except MemoryError:
        refused = InputError(NO_MEMORY)
        echo(str(refused), err=True)
        return refused.exit_code, refused
    except Exception as error:
        if isinstance(error, OSError) and error.errno in _CANNOT_WRITE:
            echo(f"error: the output cannot be written: {error.strerror}", err=True)
            return InputError.exit_code, error
        if isinstance(error, OSError) and error.filename is not None:
            # a file may vanish or be closed to us at any moment between the check and the end
            echo(f"{error.filename}: error: cannot be opened: {error.strerror}", err=True)
            return InputError.exit_code, error
        if isinstance(error, UnicodeEncodeError) and error.encoding == sys.getfilesystemencoding() != "utf-8":
            message = f"'{error.object}' cannot be a file name in {error.encoding}, the encoding of this shell"
            refused = InputError([Fault(message, hint="set LC_ALL=C.UTF-8 or PYTHONUTF8=1")])
            echo(str(refused), err=True)
            return refused.exit_code, refused
        import traceback

        traceback.print_exc()
        echo("\nthis is a defect of metrocli; please report it with the lines above", err=True)
        return 1, error
