"""The table of a run on a terminal, seen on a small screen that obeys what a VT100 obeys."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import sys
import termios
from pathlib import Path

import pytest

from metrocli.cli.console import printable
from metrocli.cli.shell.live_table import LiveTable, time_text

_PIECE = re.compile(r"\x1b\[\??(\d*)([A-Za-z])|(\r)|(\n)|(.)", re.DOTALL)


class Screen:
    """A terminal of some columns and lines, with all that has scrolled out of it."""

    def __init__(self, columns: int, lines: int) -> None:
        self.columns, self.lines = columns, lines
        self.rows: list[list[str]] = [[]]
        self.row = self.column = 0

    def write(self, text: str) -> None:
        for number, letter, back, down, plain in _PIECE.findall(text):
            if letter == "A":
                self.row = max(self.row - int(number or 1), len(self.rows) - self.lines, 0)
            elif letter in "KJ" and letter:
                del self.rows[self.row][self.column :]
                if letter == "J":
                    del self.rows[self.row + 1 :]
            elif back:
                self.column = 0
            elif down:
                self.column = 0
                self.down()
            elif plain:
                if self.column == self.columns:
                    self.column = 0
                    self.down()
                row = self.rows[self.row]
                row.extend(" " * (self.column + 1 - len(row)))
                row[self.column] = plain
                self.column += 1

    def down(self) -> None:
        self.row += 1
        if self.row == len(self.rows):
            self.rows.append([])

    def shown(self) -> list[str]:
        return [line for row in self.rows if (line := "".join(row).rstrip())]


def table_on(screen: Screen, total: int) -> LiveTable:
    return LiveTable(total, screen.write, lambda: (screen.columns, screen.lines))


def printed(screen: Screen, table: LiveTable, name: str, action: str = "ran") -> None:
    with table.end(name, action):
        screen.write(f"{name}: {action}\r\n")


@pytest.mark.parametrize(
    ("others", "words"),
    [("ran", "about 20 s left"), ("failed", "about 20 s left"), ("up to date", "at most 1 min 00 s left")],
)
def test_the_time_that_is_left_is_that_of_jobs_that_ran(others: str, words: str) -> None:
    """After a minute three of four jobs are done; jobs that are up to date took nothing of it."""
    screen = Screen(80, 24)
    table = table_on(screen, 4)
    table._begun -= 60.0
    for name, action in (("a", others), ("b", "ran"), ("c", others)):
        printed(screen, table, name, action)
    table.draw()
    assert (
        screen.shown()[-1]
        == f"3 of 4 done{', 2 failed' * (others == 'failed')}, 0 running, 1 waiting, 1 min 00 s, {words}"
    )


def test_it_counts_what_is_done_and_lists_what_is_in_work() -> None:
    screen = Screen(80, 24)
    table = table_on(screen, 5)
    for name in ("a", "b", "c"):
        table.begin(name)
    table.draw()
    printed(screen, table, "b")
    printed(screen, table, "d", "failed")
    assert screen.shown() == [
        "b: ran", "d: failed", "2 of 5 done, 1 failed, 2 running, 1 waiting, 0 s", "      0 s  a", "      0 s  c",
    ]  # fmt: skip
    table.clear()
    assert screen.shown() == ["b: ran", "d: failed"]


def test_what_does_not_change_is_not_drawn_again() -> None:
    written: list[str] = []
    table = LiveTable(2, written.append, lambda: (80, 24))
    table.begin("a")
    table.draw()
    table.draw()
    assert len(written) == 1


@pytest.mark.parametrize("columns", [1, 9, 20, 40])
@pytest.mark.parametrize("lines", [1, 3, 6])
def test_a_small_terminal_keeps_what_was_printed_and_no_rest_of_the_table(columns: int, lines: int) -> None:
    screen = Screen(columns, lines)
    table = table_on(screen, 12)
    names = [f"Messung-{'größe' * 4}-{n}" for n in range(12)]
    for name in names:
        table.begin(name)
    for name in names:
        table.draw()
        printed(screen, table, name)
    table.clear()
    assert "".join(screen.shown()).replace(" ", "") == "".join(f"{name}:ran" for name in names)


@pytest.mark.parametrize("columns", [12, 13, 14, 15, 16])
def test_letters_of_two_columns_do_not_make_a_line_wrap(columns: int) -> None:
    written: list[str] = []
    table = LiveTable(1, written.append, lambda: (columns, 24))
    table.begin("測定データ")
    table.draw()
    name = re.search(" 0 s  ([測定データ]*)", written[0])
    assert name is not None
    assert len(name[1]) == (columns - 1 - 11) // 2


def test_names_cannot_take_over_the_terminal() -> None:
    written: list[str] = []
    table = LiveTable(1, written.append, lambda: (80, 24))
    table.begin("evil\x1b[2Jname")
    table.draw()
    assert "\x1b[2J" not in written[0]


def test_no_more_lines_than_the_terminal_has() -> None:
    screen = Screen(60, 8)
    table = table_on(screen, 40)
    for n in range(40):
        table.begin(f"j{n}")
    table.draw()
    assert screen.shown()[1:] == [f"      0 s  j{n}" for n in range(4)] + [f"{'':>9}  and 36 more"]


def test_a_terminal_that_becomes_narrow_loses_nothing_that_was_printed() -> None:
    screen = Screen(60, 24)
    table = table_on(screen, 3)
    table.begin("a" * 40)
    table.draw()
    printed(screen, table, "b")
    screen.columns = 12
    table.draw()
    table.clear()
    assert screen.shown() == ["b: ran"]


@pytest.mark.parametrize(("seconds", "text"), [(7.9, "7 s"), (187, "3 min 07 s"), (7530, "2 h 05 min")])
def test_times(seconds: float, text: str) -> None:
    assert time_text(seconds) == text


JOB = """\
metrocli: 1
job: report-uncertainty
quantities: {{a: {{value: 10 mm, std: 1 um}}}}
measurands: {{l: {{model: 2*a, unit: mm}}}}
monte_carlo: {{trials: {trials}}}
output: {name}.h5
"""


def on_a_terminal(columns: int, lines: int, *words: str) -> tuple[int, str]:
    """Return the exit code of a command and what it writes to a terminal of this size."""
    child, terminal = pty.fork()
    if child == 0:
        environment = os.environ | {"TERM": "xterm", "OMP_NUM_THREADS": "1"}
        fcntl.ioctl(0, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
        os.execve(sys.executable, [sys.executable, "-m", "metrocli", *words], environment)
    text = b""
    while True:
        try:
            more = os.read(terminal, 65536)
        except OSError:  # Linux reports so that the other side is closed
            more = b""
        if not more:
            break
        text += more
    os.close(terminal)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), text.decode()


def test_a_run_on_a_terminal_shows_the_table_and_leaves_a_line_a_job_and_the_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # the first job takes longer than the time before a table appears, on a fast processor as well
    for name, trials in (("a", 30_000_000), ("b", 100_000)):
        Path(f"{name}.yaml").write_text(JOB.format(name=name, trials=trials))
    Path("metrocli.yaml").write_text("jobs: [a.yaml, b.yaml]\n")
    code, text = on_a_terminal(30, 10, "run")
    assert code == 0
    assert "0 of 2 done, 1 running, 1 wai\x1b[K" in text
    assert re.search(r" \d s  a\.yaml\x1b\[K", text)
    screen = Screen(30, 10)
    screen.write(text)
    after = "".join(screen.shown())
    lines = [f"{name}.yaml: ran (there is no result yet) -> {name}.h5" for name in "ab"]
    expected = "".join([*lines, "2 jobs: 2 ran, in S s"])
    assert re.sub(r"in \d+ s$", "in S s", after).replace(" ", "") == expected.replace(" ", "")
    assert on_a_terminal(30, 10, "run", "--only", "b.yaml", "--force", "--quiet") == (0, "")


def test_no_name_turns_the_direction_of_writing() -> None:
    assert printable("rfp\u202e5h.\u2066 tab\tend\n\x1b") == "rfp\ufffd5h.\ufffd tab\tend\n\ufffd"
