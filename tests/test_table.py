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
