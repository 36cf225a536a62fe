"""Text that fits the width of a terminal, and the colours of its deciding words."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from metrocli.cli.shell.fitted import coloured, fitted
from metrocli.record import DOUBTFUL, UNMET

Metrocli = Callable[..., Any]
TABLE = """points
point  where     x [mm]  sx [um]  remark
A      here    1.034567     0.21  absorbed by the places of the tracers, and by their dead paths
A      there  -20.50000     0.31
B               0.00001     0.31  seen"""


def rows(text: str) -> list[list[str]]:
    return [line.split() for line in text.splitlines()]


@pytest.mark.parametrize("text", [TABLE, "short", "", "\n\n"])
def test_what_fits_stays_as_it_is(text: str) -> None:
    assert fitted(text, 120) == text


@pytest.mark.parametrize("width", [30, 45, 60, 80])
def test_a_wide_table_is_shown_in_aligned_parts(width: int) -> None:
    lines = fitted(TABLE, width).split("\n")
    assert max(map(len, lines)) <= width and lines[0] == "points"
    words = " ".join(lines).split()
    for word in TABLE.split():
        assert word in words
    parts = "\n".join(lines[1:]).split("\n\n")
    assert all(part.startswith("point") for part in parts)
    for part in parts:
        # numbers end below their heading
        head, *below = part.split("\n")
        for name in ("x [mm]", "sx [um]"):
            if name in head:
                end = head.index(name) + len(name)
                assert all(line[end - 1 : end].isdigit() and line[end : end + 1] in ("", " ") for line in below)


def test_parts_begin_with_what_tells_the_rows_apart() -> None:
    """Two rows are of A, so the place is repeated beside it; rows without a cell in a part are left out."""
    parts = fitted(TABLE, 45).split("\n\n")
    assert [part.split("\n")[-2].split()[:2] for part in parts[:1]] == [["A", "there"]]
    assert parts[-1].split("\n")[0].split() == ["point", "where", "remark"]
    assert "there" not in parts[-1] and "seen" in parts[-1]


def test_prose_is_broken_between_words_and_keeps_its_indent() -> None:
    assert fitted("  common error of the index: 1.6 um by 1 K", 20) == (
        "  common error of\n    the index: 1.6\n    um by 1 K"
    )
    long = "/a/path/that/has/no/place/to/break/it.h5"
    assert fitted(long, 20) == long


def test_lines_of_files_are_shown_as_they_are() -> None:
    """The mark below a line of a file has to stay below its place."""
    text = (
        "    11 | noise: 0,1 px and much more than there is room for\n       |        ^ write '0.1 px' and so on and on"
    )
    assert fitted(text, 30) == text


def test_deciding_words_have_colours() -> None:
    red, green, yellow, plain = "\x1b[1;31m", "\x1b[32m", "\x1b[33m", "\x1b[0m"
    assert coloured("status: done, 2 warnings") == f"status: {green}done{plain}, 2 warnings"
    for status in (DOUBTFUL, UNMET):
        assert coloured(f"status: {status}, 1 warning") == f"status: {red}{status}{plain}, 1 warning"
    assert coloured("verdict: clean\nverdict: explained") == (
        f"verdict: {green}clean{plain}\nverdict: {yellow}explained{plain}"
    )
    assert coloured("a.yaml:3:1: error: no unit") == f"a.yaml:3:1: {red}error{plain}: no unit"
    assert coloured("required rms.px < 1: NOT met (2)") == f"required rms.px < 1: {red}NOT met{plain} (2)"
    assert coloured("the error is done") == "the error is done"


@pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")
@pytest.mark.parametrize("colours", [True, False])
def test_on_a_terminal_and_in_a_pipe(job: Path, metrocli: Metrocli, colours: bool, monkeypatch: Any) -> None:
    """The same command: in a pipe wide and plain, on a terminal of 40 columns fitted and coloured."""
    import fcntl
    import pty
    import struct
    import termios

    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("NO_COLOR", "" if colours else "1")
    metrocli("straight-line", job)
    plain = metrocli("show", "results/line.h5").out
    assert "\x1b" not in plain and max(map(len, plain.splitlines())) > 40
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 40, 0, 0))
    with os.fdopen(theirs, "w", encoding="utf-8") as terminal:
        monkeypatch.setattr(sys, "stdout", terminal)
        from metrocli.cli.console import echo

        echo(plain)
        terminal.flush()
    shown = b""
    with os.fdopen(ours, "rb", buffering=0) as reader:
        try:
            while part := reader.read(4096):
                shown += part
        except OSError:  # the end, once the other side is closed
            pass
    text = shown.decode().replace("\r\n", "\n")
    assert ("\x1b[32mdone\x1b[0m" in text) is colours
    bare = text.replace("\x1b[32m", "").replace("\x1b[0m", "")
    assert max(map(len, bare.splitlines())) <= 40
    assert set(plain.split()) <= set(bare.split())
