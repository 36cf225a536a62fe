"""Plain files are taken apart as a whole, and read as any other file is."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from metrocli.errors import InputError
from metrocli.formats import csv
from metrocli.formats.csv_plain import plain_cells
from metrocli.table import TEXT, Column, Columns

COLUMNS = Columns((Column("point", TEXT), Column("tracer", TEXT), Column("length", "length")), ("point", "tracer"))
ROWS = [(f"P_{i // 4}", f"T{i % 4}", f"{100 + i / 7:.6f}") for i in range(400)]


def written(path: Path, separator: str = ",", more: str = "", end: str = "\n") -> Path:
    rows = [("point", "tracer", "length_mm"), *ROWS]
    path.write_text("\n".join(separator.join(row) for row in rows) + end + more, encoding="utf-8")
    return path


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("more", ["", "# a comment\n", '"P_1000","T0",5\n', " P_1000 , T0 , 5\n".replace(" ", "  ")])
def test_a_plain_file_is_read_as_any_other(tmp_path: Path, separator: str, more: str) -> None:
    """The comment, the quotation marks and the spaces lead to the reader that looks at each line."""
    table = csv.read(written(tmp_path / "a.csv", separator, more.replace(",", separator)), COLUMNS)
    n = len(ROWS)
    assert table.texts("point")[:n] == [row[0] for row in ROWS]
    assert table.texts("tracer")[:n] == [row[1] for row in ROWS]
    assert table.numbers("length")[:n].tolist() == [float(row[2]) for row in ROWS]
    assert list(table.lines[:n]) == list(range(2, n + 2))
    assert len(table) == n + bool(more and not more.startswith("#"))
    if len(table) > n:
        assert (table.texts("point")[n], table.texts("tracer")[n], table.numbers("length")[n]) == ("P_1000", "T0", 5.0)


@pytest.mark.parametrize("end", ["", "\n"])
def test_the_last_line_may_end_or_not(tmp_path: Path, end: str) -> None:
    assert len(csv.read(written(tmp_path / "a.csv", end=end), COLUMNS)) == len(ROWS)


@pytest.mark.parametrize(
    "line",
    ["", "# comment", "a, b", '"a",b', "\u0661,b", "a\u00a0,b", "a,b,c", "a", "a\x1f,b", "a\t,b"],
    ids=[
        "empty",
        "comment",
        "space",
        "quoted",
        "digit of another script",
        "hard space",
        "more",
        "fewer",
        "mark",
        "tab",
    ],
)
def test_the_unusual_is_left_to_the_other_reader(line: str) -> None:
    assert plain_cells("\n".join(["1,2", line, "3,4", ""]), ",", 2) is None
    plain = plain_cells("1,2\n3,4\n", ",", 2)
    assert plain is not None
    assert list(plain) == [["1", "3"], ["2", "4"]]


def test_a_cell_too_many_and_one_too_few_do_not_make_up_for_each_other() -> None:
    assert plain_cells("1,2,3\n4\n", ",", 2) is None
    assert plain_cells("1,2,3\n4,\n5", ",", 2) is None


def test_an_absurd_cell_takes_no_memory_for_the_other_rows(tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", more=f"{'P' * 1_000_000},T9,1.0\nP_7,T9,{'1' * 1_000_000}\n")
    tracemalloc.start()
    with pytest.raises(InputError) as error:
        csv.read(path, COLUMNS)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    n = len(ROWS)
    assert [(fault.line, fault.column) for fault in error.value.faults] == [(n + 2, 1), (n + 3, 8)]
    assert peak < 50e6


def test_faults_of_plain_files_have_their_place(tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", more="P_7,TA,1e999\nP_7,T9,\nP_7,T8,1_0\n")
    with pytest.raises(InputError) as error:
        csv.read(path, COLUMNS)
    n = len(ROWS)
    assert [(fault.line, fault.column) for fault in error.value.faults] == [(n + 2, 8), (n + 3, 8), (n + 4, 8)]


def test_rows_without_a_key_and_repeated_ones_are_reported_together(tmp_path: Path) -> None:
    """A row with a wrong number has a key; two rows without one are not the same."""
    path = written(tmp_path / "a.csv", more="P_7,,3.0\nP_7,,3.0\nP_7,T1,x\n")
    with pytest.raises(InputError) as error:
        csv.read(path, COLUMNS)
    n = len(ROWS)
    assert [(fault.line, fault.column) for fault in error.value.faults] == [
        (n + 2, 5),
        (n + 3, 5),
        (n + 4, 1),
        (n + 4, 8),
    ]


def test_a_row_that_is_there_twice_is_found(tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", more="P_7,T1,3.0\n")
    with pytest.raises(InputError) as error:
        csv.read(path, COLUMNS)
    (fault,) = error.value.faults
    assert fault.line == len(ROWS) + 2
    assert "first in line 31" in str(fault.hint)


def test_keys_of_numbers_may_be_missing(tmp_path: Path) -> None:
    """Two rows without a number are not the same row."""
    path = tmp_path / "b.csv"
    path.write_text("a,b\n1,2\n,3\n,4\n")
    columns = Columns((Column("a", may_be_empty=True), Column("b")), ("a",))
    assert np.isnan(csv.read(path, columns).numbers("a")[1:]).all()
