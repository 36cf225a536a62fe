"""A sensor that sticks while a machine moves is named, in results and in failures."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Metrocli = Callable[..., Any]
CASES = {
    "six-dof": ("machine-methods", "lines.csv", "six-dof", "eb_rad", slice(3, 13), "eb_rad of x", 6),
    "standstill": ("machine-methods", "points.csv", "standstill", "my_mm", slice(39, 54), "my_mm of the tracker", 3),
    "on-the-fly": ("otf-tracker", "track-10000.csv", "feed-10000", "y_mm", slice(400, 460), "y_mm of the tracker", 0),
    "probing": ("five-axis", "probing.csv", "whole-run", "y_mm", slice(20, 40), "y_mm of the probe", 6),
    "lengths": ("machine-lengths", "lengths.csv", "lengths", "length_mm", slice(20, 40), "length_mm of S1", 5),
}


def changed(file: Path, column: str, rows: slice, value: str | None = None) -> None:
    """Let rows of a column have the value of the first of them, or another."""
    head, *rest = (line.split(",") for line in file.read_text().splitlines())
    for row in rest[rows]:
        row[head.index(column)] = value or rest[rows][0][head.index(column)]
    file.write_text("\n".join(map(",".join, [head, *rest])) + "\n")


@pytest.mark.parametrize("case", CASES)
def test_a_sensor_that_sticks_is_named(case: str, tmp_path: Path, metrocli: Metrocli) -> None:
    sample, name, job, column, rows, words, code = CASES[case]
    assert metrocli("init", tmp_path / "p", "--sample", sample).code == 0
    changed(tmp_path / "p" / "data" / name, column, rows)
    ran = metrocli("calibrate-machine", tmp_path / f"p/jobs/{job}.yaml")
    assert ran.code == code, ran.err
    assert f"{words} stays the same in {rows.stop - rows.start} rows in a row from line {rows.start + 2} on" in ran.err


def test_an_angle_of_a_tracker_that_sticks_is_named(tmp_path: Path, metrocli: Metrocli) -> None:
    assert metrocli("init", tmp_path / "p", "--sample", "machine-methods").code == 0
    file = tmp_path / "p/data/points.csv"
    head, *rest = (line.split(",") for line in file.read_text().splitlines())
    at = [head.index(name) for name in ("mx_mm", "my_mm", "mz_mm")]
    for row in rest:
        x, y, z = (float(row[column]) for column in at)
        polar = math.atan2(y, x), math.atan2(z, math.hypot(x, y)), math.hypot(x, y, z)
        for column, value in zip(at, polar, strict=True):
            row[column] = f"{value:.9f}"
    for column, name in zip(at, ("azimuth_rad", "elevation_rad", "distance_mm"), strict=True):
        head[column] = name
    file.write_text("\n".join(map(",".join, [head, *rest])) + "\n")
    assert "stays the same" not in metrocli("calibrate-machine", tmp_path / "p/jobs/standstill.yaml").err
    changed(file, "elevation_rad", slice(39, 54))
    ran = metrocli("calibrate-machine", tmp_path / "p/jobs/standstill.yaml", "--force")
    assert "elevation_rad of the tracker stays the same in 15 rows in a row from line 41 on" in ran.err, ran.err


def test_readings_that_were_computed_may_repeat(tmp_path: Path, metrocli: Metrocli) -> None:
    """A machine without errors, by a laser without noise."""
    assert metrocli("init", tmp_path / "p", "--sample", "machine-methods").code == 0
    for column in ("ex_mm", "ey_mm", "ez_mm", "ea_rad", "eb_rad", "ec_rad"):
        changed(tmp_path / "p/data/lines.csv", column, slice(None), "0.00001")
    ran = metrocli("calibrate-machine", tmp_path / "p/jobs/six-dof.yaml")
    assert ran.code == 0 and "stays the same" not in ran.err, ran.err
