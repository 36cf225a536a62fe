"""The entry point: help and version without loading the commands; everything else through them."""

from __future__ import annotations

import os
import sys

from metrocli.cli.help import help_text, version_text
from metrocli.cli.shell.idle import nothing_to_do
from metrocli.cli.shell.streams import guarded

COMPLETE = "_METROCLI_COMPLETE"
"""Set by the completion of the shell, which then calls without arguments"""


def main() -> None:
    """Run the installed command `metrocli`."""
    sys.exit(guarded(_main))


def _main() -> int:
    arguments = sys.argv[1:]
    if arguments in ([], ["-h"], ["--help"]) and COMPLETE not in os.environ:
        sys.stdout.write(help_text())
    elif arguments == ["--version"]:
        sys.stdout.write(version_text() + "\n")
    else:
        import gc
        import signal

        # while Python loads modules, and while it ends, Ctrl-C ends it without a traceback
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        if nothing_to_do(arguments):
            return 0
        # Threads within one matrix product wait for each other where other programs run. numpy reads this on import.
        os.environ.setdefault("OMP_NUM_THREADS", "1")
        os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")  # its warnings name its own source lines
        # here, not at the top: `--help` and completion need none of it (docs/decisions/154-loaded-where-used.md)
        from metrocli.cli.commands import run

        code = run(arguments)
        gc.freeze()  # Python searches its memory for cycles as it ends, a tenth of a small job: nothing needs that
        return code
    return 0
