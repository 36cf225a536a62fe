"""All commands, each imported when it is used, and the one place that reports failures."""

from __future__ import annotations

import errno
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from types import FrameType

import click

from metrocli import __version__
from metrocli.cli.help import COMMANDS, PLACES, example_of, help_text, version_text
from metrocli.errors import InputError, MetrocliError
from metrocli.tasks import KINDS

INTERRUPTED, BROKEN_PIPE, TERMINATED = 130, 141, 143
"""Exit codes that shells give to programs ended by SIGINT, SIGPIPE and SIGTERM"""


class Terminated(BaseException):
    """SIGTERM as an exception, so that unfinished files are removed on the way out."""


class Commands(click.Group):
    """All commands; help and completion list them without importing any."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*KINDS, *COMMANDS]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in KINDS:
            from metrocli.cli.job_command import make

            made = make(cmd_name)
            made.epilog = example_of(cmd_name)
            return made
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = import_module(f"metrocli.cli.{PLACES.get(cmd_name, cmd_name)}").command
        command.epilog = example_of(cmd_name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in self.list_commands(ctx) and not args[0].startswith("-"):
            from metrocli.words import suggestion

            raise click.UsageError(f"no command '{args[0]}'; {suggestion(args[0], self.list_commands(ctx))}", ctx)
        return super().resolve_command(ctx, args)

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        formatter.write(help_text())


_CANNOT_WRITE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO)
"""Errors of a full, read-only or failing disk, also where stdout is redirected to it"""


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, message=version_text())
def commands() -> None:
    """All commands."""


@contextmanager
def _terminable() -> Iterator[None]:
    """Make SIGTERM raise Terminated; does nothing outside the main thread, where no signal arrives."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        raise Terminated

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def run(arguments: Sequence[str] | None = None) -> int:
    """Carry out one command line and return its exit code; every failure is printed to stderr."""
    try:
        with _terminable():
            code = commands.main(arguments, prog_name="metrocli", standalone_mode=False)
        return code if isinstance(code, int) else 0
    except Terminated:
        click.echo("terminated", err=True)
        return TERMINATED
    except SystemExit as ended:
        # click raises this after it has completed a word, and when the reader of stdout has gone (head)
        return 0 if ended.code == 0 else BROKEN_PIPE
    except click.exceptions.Abort:
        click.echo("interrupted", err=True)
        return INTERRUPTED
    except click.ClickException as error:
        error.show()
        return 2
    except InputError as error:
        click.echo(str(error), err=True)
        return error.exit_code
    except MetrocliError as error:
        click.echo(f"error: {error}", err=True)
        return error.exit_code
    except Exception as error:
        if isinstance(error, OSError) and error.errno in _CANNOT_WRITE:
            click.echo(f"error: the output cannot be written: {error.strerror}", err=True)
            return InputError.exit_code
        if isinstance(error, OSError) and error.filename is not None:
            # a file may vanish or be closed to us at any moment between the check and the end
            click.echo(f"{error.filename}: error: cannot be opened: {error.strerror}", err=True)
            return InputError.exit_code
        import traceback

        traceback.print_exc()
        click.echo("\nthis is a defect of metrocli; please report it with the lines above", err=True)
        return 1
