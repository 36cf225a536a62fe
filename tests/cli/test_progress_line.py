"""The line that shows what a command is doing, and how long that still takes."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from metrocli.cli import console as consoles
from metrocli.cli.console import Console, echo
from metrocli.cli.shell import progress_line
from metrocli.cli.shell.progress_line import ProgressLine
from metrocli.progress import counted


@dataclass
class Watched:
    """A line on a terminal, with the clocks that it reads."""

    columns: int = 80
    now: float = 0.0
    cpu: float = 0.0
    written: list[str] = field(default_factory=list)

    def line(self) -> ProgressLine:
        return ProgressLine(self.written.append, lambda: self.columns, lambda: self.now, lambda: self.cpu)


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Watched, ProgressLine]]:
    """The line of a command that is being carried out."""
    held = Watched()
    line = held.line()
    monkeypatch.setattr(consoles, "LINES", [line])
    yield held, line


def test_without_parts_and_limit_the_time_is_shown(watched: tuple[Watched, ProgressLine]) -> None:
    held, line = watched
    held.now = 3.2
    assert line.text() == "3 s"
    Console().doing("a.yaml: multilaterate")
    held.now = 75.0
    assert line.text() == "1 min 15 s  a.yaml: multilaterate"


def test_counted_parts_show_how_long_the_others_take(watched: tuple[Watched, ProgressLine]) -> None:
    """At the rate of those that are done since they are counted; what came before is not of their kind."""
    held, line = watched
    console = Console()
    console.doing("predicting", 200.0)
    held.now = 10.0
    folds = iter(counted(map, console)(lambda n: n, range(4)))
    assert next(folds) == 0
    held.now = 13.0
    assert line.text() == "13 s  predicting, 1 of 4 parts, about 9 s left"
    assert next(folds) == 1
    console.count(0, 4)
    assert line.text() == "13 s  predicting, 0 of 4 parts, at most 3 min 20 s of search left"
    assert [*folds] == [2, 3]
    console.doing("drawing")
    console.count(7, None)
    assert line.text() == "13 s  drawing, 7 parts"


def test_a_search_ends_after_its_cpu_time(watched: tuple[Watched, ProgressLine]) -> None:
    held, line = watched
    Console().doing("searching", 90.0)
    held.now, held.cpu = 40.0, 30.0
    assert line.text() == "40 s  searching, at most 1 min 00 s of search left"
    held.cpu = 95.0
    assert line.text() == "40 s  searching"


def test_a_narrow_terminal_keeps_the_times(watched: tuple[Watched, ProgressLine]) -> None:
    held, line = watched
    Console().doing("a-job-with-a-long-name.yaml: searching", 90.0)
    held.columns = 48
    assert line.text() == "0 s  a-job-w, at most 1 min 30 s of search left"
    held.columns = 5
    assert line.text() == "0 s"


def test_what_is_printed_stands_above_the_line(
    watched: tuple[Watched, ProgressLine], capsys: pytest.CaptureFixture[str]
) -> None:
    held, line = watched
    line.draw()
    echo("a result")
    assert held.written == ["\r0 s", "\r   \r"] and capsys.readouterr().out == "a result\n"


class Terminal(io.StringIO):
    """A stream that is a terminal."""

    def isatty(self) -> bool:
        return True

    def fileno(self) -> int:
        return 2


@pytest.mark.parametrize("words", [[], ["--quiet"]])
def test_a_command_draws_it_on_a_terminal_unless_quiet(
    words: list[str], job: Path, metrocli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing of it stays on the terminal."""
    drawn: list[str] = []

    class Slow(ProgressLine):
        def doing(self, line: str, most: float = float("inf")) -> None:
            super().doing(line, most)
            self.draw()
            drawn.append(self.text())

    monkeypatch.setattr(progress_line, "ProgressLine", Slow)
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    assert metrocli("straight-line", job, *words).code == 0
    assert bool(drawn) == (not words)
    if drawn:
        assert drawn[1:] == ["0 s  line.yaml: reading its inputs", "0 s  line.yaml: straight-line"]
        assert terminal.getvalue().endswith("\r") and consoles.LINES == []
