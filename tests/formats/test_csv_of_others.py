"""Tables that other programs write: marks of a separator, empty ends, headers after other lines; hints that are right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from metrocli.errors import InputError
from metrocli.formats import csv
from metrocli.table import Columns, Table, columns

POINTS = Columns((*columns("point [text]", "x y [length]"),), ("point",), "points")


def read(folder: Path, text: str) -> list[float]:
    (folder / "points.csv").write_text(text, encoding="utf-8")
    table = csv.read(folder / "points.csv", POINTS)
    return [*table.numbers("x"), *table.numbers("y")]


@pytest.mark.parametrize(
    "text",
    [
        "sep=;\npoint;x_mm;y_mm\na;1;2\nb;3;4\n",
        '"sep=,"\npoint,x_mm,y_mm\na,1,2\nb,3,4\n',
        "SEP=\t\npoint\tx_mm\ty_mm\na\t1\t2\nb\t3\t4\n",
        "point,x_mm,y_mm,,\na,1,2,,\nb,3,4,,\n,,,,\n,,,,\n",
        "\ufeff\ufeffpoint,x_mm,y_mm\na,1,2\nb,3,4\n",
    ],
)
def test_it_is_read(text: str, tmp_path: Path) -> None:
    assert read(tmp_path, text) == [1, 3, 2, 4]


@pytest.mark.parametrize(
    ("text", "words", "never"),
    [
        ("Made by X\n\npoint;x_mm;y_mm\na;1;2\nb;3;4\n", "not the header, which is line 3", "decimal comma"),
        ("point,x_mm,y_mm\na,1,5,2,5\nb,3,5,4,5\n", "is there a decimal comma?", "delete"),
        ("point,x_mm,y_mm\na,1.5,2.5,left\nb,3,4,\n", "columns: point, x_mm, y_mm", "decimal comma"),
        ("point,x_mm,y_mm,\na,1,2,\nb,3,4,5\n", "a column has no name", "decimal comma"),
    ],
)
def test_hints_are_given_where_they_are_right(text: str, words: str, never: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as raised:
        read(tmp_path, text)
    assert words in str(raised.value) and never not in str(raised.value)


def test_texts_that_spreadsheets_would_run_are_written_behind_a_space(tmp_path: Path) -> None:
    """Excel takes what begins with =, + or @ for a formula; readers of CSV drop the space."""
    names = np.array(["=1+1", "@SUM(A1)", "+x", "-y", "plain"])
    table = Table({"point": names, "x": np.arange(5.0), "y": -np.arange(5.0)}, {"x": "mm", "y": "mm"})
    csv.write(tmp_path / "points.csv", table)
    text = (tmp_path / "points.csv").read_text()
    assert "\n =1+1," in text and "\n @SUM(A1)," in text and "\n +x," in text and "\n-y," in text
    assert csv.read(tmp_path / "points.csv", POINTS).texts("point") == names.tolist()


def test_names_are_equal_whatever_their_accents_are_made_of(tmp_path: Path) -> None:
    """An accent may be part of a letter, or a letter of its own (macOS)."""
    for text in ("point,x_mm,y_mm\nS\u00fcd,1,2\n", "point,x_mm,y_mm\nSu\u0308d,1,2\n"):
        (tmp_path / "points.csv").write_text(text, encoding="utf-8")
        assert csv.read(tmp_path / "points.csv", POINTS).texts("point") == ["S\u00fcd"]
