"""The first Ctrl-C of a search ends the search, the second the command; in a process of its own, since signals are."""

from __future__ import annotations

import subprocess
import sys

TWICE = """
import os, signal, time
from metrocli.cli.shell.signals import ending, first_interrupt

heard = []
with ending(), first_interrupt(lambda: heard.append("ends the search")):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.9)
    print(*heard, flush=True)
    {second}
print("reported", flush=True)
"""


def ran(second: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", TWICE.format(second=second)], capture_output=True, text=True, check=False, timeout=60
    )


def test_the_first_one_ends_the_search_and_the_command_goes_on() -> None:
    found = ran("pass")
    assert (found.returncode, found.stdout) == (0, "ends the search\nreported\n")


def test_the_second_one_ends_the_command() -> None:
    found = ran("os.kill(os.getpid(), signal.SIGINT); time.sleep(5)")
    assert found.stdout == "ends the search\n"
    assert found.returncode != 0
