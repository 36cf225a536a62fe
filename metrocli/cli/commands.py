"""All commands, each imported when it is used, and the one place where failures are told."""

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
from metrocli.cli.help import COMMANDS, help_text, version_text
from metrocli.errors import InputError, MetrocliError
from metrocli.tasks import KINDS

INTERRUPTED, UNHEARD, TERMINATED = 130, 141, 143
"""As shells have it for what SIGINT, SIGPIPE and SIGTERM end"""


class Terminated(BaseException):
    """SIGTERM, as an exception: what was begun is taken back on the way out."""


class Commands(click.Group):
    """All commands; help and completion know them without importing one."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*KINDS, *COMMANDS]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in KINDS:
            from metrocli.cli.job_command import make

            return make(cmd_name)
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = import_module(f"metrocli.cli.{cmd_name}").command
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
"""A full or read-only disk, also behind stdout"""


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, message=version_text())
def commands() -> None:
    """All commands."""


@contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM raise, where this is the thread that signals reach."""
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
    """Carry out one command line and return its exit code; every failure is told on stderr."""
    try:
        with _terminable():
            code = commands.main(arguments, prog_name="metrocli", standalone_mode=False)
        return code if isinstance(code, int) else 0
    except Terminated:
        click.echo("terminated", err=True)
        return TERMINATED
    except SystemExit:
        # click's answer to a reader of stdout that has gone, as `head` does
        return UNHEARD
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
        import traceback

        traceback.print_exc()
        click.echo("\nthis is a defect of metrocli; please report it with the lines above", err=True)
        return 1
