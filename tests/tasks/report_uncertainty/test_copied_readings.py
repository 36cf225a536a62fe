"""Readings that stand twice in a type A evaluation; short rounded series repeat by chance and are left alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tasks.report_uncertainty.jobs import carry_out

from metrocli.errors import Fault
from metrocli.table import Table
from metrocli.tasks.report_uncertainty.correlations import repeated

SERIES = [50.0012, 50.0019, 50.0007, 50.0015, 50.0011, 50.0021, 50.0009, 50.0014]


def written(folder: Path, name: str, values: list[float]) -> str:
    (folder / name).write_text("\n".join(["l_mm", *map(repr, values)]) + "\n")
    return name


def of_two(first: str, second: str) -> dict[str, object]:
    return {
        "quantities": {"a": {"readings": first}, "b": {"readings": second}},
        "measurands": {"d": {"model": "a - b", "unit": "um"}},
        "monte_carlo": {"trials": 0},
    }


def alone(file: str) -> dict[str, object]:
    return {
        "quantities": {"a": {"readings": file}},
        "measurands": {"l": {"model": "a", "unit": "mm"}},
        "monte_carlo": {"trials": 0},
    }


def test_a_series_pasted_twice_is_refused_with_its_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ran = carry_out(tmp_path, alone(written(tmp_path, "a.csv", SERIES + SERIES)))
    error = capsys.readouterr().err
    assert ran.code == 3 and ran.result is None
    assert "a.csv:10" in error and "8 readings of 'a' repeat line 2" in error


def test_a_short_one_is_a_warning(tmp_path: Path) -> None:
    ran = carry_out(tmp_path, alone(written(tmp_path, "a.csv", SERIES[:4] + SERIES[:4])))
    assert ran.code == 0 and ran.result is not None
    assert any("4 readings of 'a' repeat line 2" in line for line in ran.result.warnings)


def test_a_copy_in_another_file_is_no_second_measurement(tmp_path: Path) -> None:
    """The difference of a value and its copy is 0 without doubt."""
    files = [written(tmp_path, name, SERIES) for name in ("a.csv", "b.csv")]
    ran = carry_out(tmp_path, of_two(*files))
    assert ran.result is not None and ran.result.estimates[0].std == pytest.approx(0, abs=1e-9)
    assert any("have the same readings, value for value (a.csv, b.csv)" in line for line in ran.result.warnings)
    apart = {**of_two(*files), "correlations": [{"between": ["a", "b"], "value": 0}]}
    ran = carry_out(tmp_path, apart)
    assert ran.result is not None
    assert ran.result.estimates[0].std == pytest.approx(1000 * np.std(SERIES, ddof=1) / 2, rel=1e-9)


@pytest.mark.alike
@pytest.mark.parametrize(("resolution", "count"), [(1.0, 10), (0.5, 30), (0.2, 100), (0.01, 1000)])
def test_rounded_series_repeat_by_chance(resolution: float, count: int) -> None:
    """Of 400 series without a copy at most two are suspected (bound of 1e-3 each, so 0.4 on average)."""
    rng = np.random.default_rng(round(count / resolution))
    suspected = 0
    for _ in range(400):
        values = np.round(rng.normal(0, 1, count) / resolution) * resolution
        found = repeated("a", Table({"l": values}, {}), "l")
        suspected += found is not None
        assert not isinstance(found, Fault)
    assert suspected <= 2


def test_an_instrument_at_rest_repeats_its_reading() -> None:
    assert repeated("a", Table({"l": np.full(50, 3.0)}, {}), "l") is None
    assert repeated("a", Table({"l": np.repeat([3.0, 3.1, 3.0, 3.2], 20)}, {}), "l") is None
