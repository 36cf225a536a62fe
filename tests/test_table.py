"""Tables: named columns."""

from __future__ import annotations

import numpy as np
import pytest

from metrocli.table import Table

TABLE = Table({"name": np.array(["a", "b"]), "x": np.array([1.0, 2.0]), "n": np.array([3, 4])}, {"x": "mm"})


def test_columns_by_name() -> None:
    assert len(TABLE) == 2
    assert list(TABLE) == ["name", "x", "n"]
    assert "x" in TABLE
    assert TABLE.texts("name") == ["a", "b"]
    assert TABLE.numbers("n").dtype == float
    assert TABLE.stacked(["n", "x"]).tolist() == [[3, 1], [4, 2]]


def test_an_absent_column_has_its_default_or_is_an_error() -> None:
    assert TABLE.numbers("sigma", 0.5).tolist() == [0.5, 0.5]
    with pytest.raises(KeyError):
        TABLE.numbers("sigma")


def test_an_empty_table() -> None:
    assert len(Table({})) == 0


def test_selected_rows_keep_their_lines_in_the_file() -> None:
    read = Table(TABLE.columns, TABLE.units, "list.csv", (2, 5), warnings=("an unused column",))
    for rows in (np.array([False, True]), np.array([1])):
        chosen = read.selected(rows)
        assert (chosen.texts("name"), chosen.lines, chosen.units, chosen.file) == (["b"], [5], {"x": "mm"}, "list.csv")
        assert not chosen.warnings


def test_changed_columns_are_in_place_of_the_old_ones() -> None:
    changed = TABLE.changed({"x": np.array([7.0, 8.0])})
    assert list(changed) == list(TABLE)
    assert changed.stacked(["x", "n"]).tolist() == [[7, 3], [8, 4]]
    assert TABLE.numbers("x").tolist() == [1.0, 2.0]


def test_further_rows_are_empty_where_they_say_nothing() -> None:
    longer = Table(TABLE.columns, TABLE.units, "list.csv", (2, 5)).extended({"x": np.array([7.0])})
    assert longer.texts("name") == ["a", "b", ""]
    assert longer.numbers("x").tolist() == [1.0, 2.0, 7.0]
    assert np.isnan(longer.numbers("n")[2])
    # a new row stands in no line of the file
    assert (longer.units, longer.file, longer.lines) == ({"x": "mm"}, "list.csv", ())


def test_absent_texts_have_their_default_and_columns_can_be_left_out() -> None:
    assert TABLE.texts("group", "") == ["", ""]
    assert list(TABLE.without("x", "n", "group")) == ["name"]
    with pytest.raises(KeyError):
        TABLE.texts("group")
