"""Control charts of many parts on the page of their project."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metrocli.plots.control_chart import series_of
from metrocli.table import Table

JOB = """\
metrocli: 1
job: report-uncertainty
for: {part: ../parts.csv}
quantities: {a: {readings: "../data/{part}.csv", column: l_mm}}
measurands: {length: {model: a, unit: mm}}
output: "../results/{part}.h5"
"""
# worked by hand: moving ranges 1 1 1 1 1 1 1 40 40, mean 9.667, limits 13.9 -/+ 2.660*9.667
VALUES = [10.0, 11.0, 10.0, 11.0, 10.0, 11.0, 10.0, 11.0, 51.0, 11.0]


def table(values: list[float]) -> Table:
    stds = np.full(len(values), 0.1)
    return Table(
        {"job": np.array(["p"] * len(values)), "x": np.array(values), "x.std": stds}, {"x": "mm", "x.std": "mm"}
    )


def test_limits_are_those_of_moving_ranges() -> None:
    (found,) = series_of(table(VALUES))
    low, high = found.limits
    assert found.mean == pytest.approx(14.6)
    assert (low, high) == (
        pytest.approx(14.6 - 2.6596 * 87 / 9, abs=1e-3),
        pytest.approx(14.6 + 2.6596 * 87 / 9, abs=1e-3),
    )
    assert found.outside.tolist() == [8]


def test_equal_values_are_inside() -> None:
    (found,) = series_of(table([10.1] * 11))
    assert found.outside.tolist() == []


def test_a_part_without_an_estimate_is_left_out_and_few_parts_have_no_chart() -> None:
    (found,) = series_of(table([*VALUES, float("nan")]))
    assert len(found.values) == len(VALUES)
    (few,) = series_of(table(VALUES[:7]))
    assert not few.limited and not len(few.outside)
    assert series_of(table(VALUES[:1])) == ()


@pytest.mark.slow
def test_the_page_of_a_project_has_the_chart(
    tmp_path: Path, metrocli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("jobs", "data"):
        Path(name).mkdir()
    Path("jobs/part.yaml").write_text(JOB)
    Path("parts.csv").write_text("part\n" + "".join(f"p{n}\n" for n in range(len(VALUES))))
    for n, value in enumerate(VALUES):
        Path(f"data/p{n}.csv").write_text(f"l_mm\n{value}\n{value + 0.002}\n{value - 0.002}\n{value}\n")
    Path("metrocli.yaml").write_text("jobs: [jobs/part.yaml]\n")
    assert metrocli("run").code == 0
    assert metrocli("report", ".").code == 0
    page = Path("report/index.html").read_text()
    assert "Control charts" in page and "jobs/part.yaml" in page
    assert "outside are p8 with length (diamonds)" in page
    assert "<svg" in page[page.index("Control charts") :]
