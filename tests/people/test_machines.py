"""ISO 230-2 of one axis from displacement alone, as a laser or a scale gives it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from metrocli.formats import hdf5

Case = Callable[[str], Path]
Metrocli = Callable[..., Any]
ONE_AXIS = """metrocli: 1
job: calibrate-machine
method: six-dof
machine: {axes: {x: {range: [-4 mm, 4 mm], knots: 5}}}
inputs: {lines: lines.csv}
noise: {displacement: 30 um}
output: one.h5
"""
REPORTED = {"A": 243.37, "R": 237.15, "B": 51.24, "E": 63.54, "M": 22.26}
"""Figures of the public report [um]"""


@pytest.mark.parametrize("text", [None, ONE_AXIS])
def test_figures_of_a_public_report(text: str | None, case: Case, metrocli: Metrocli) -> None:
    """With and without other axes in the job; no channel, axis or tool is made up."""
    folder = case("12-iso230-displacement-only")
    if text is not None:
        (folder / "job.yaml").write_text(text)
    assert metrocli("calibrate-machine", "job.yaml", "--output", "one.h5").code == 0
    result, _ = hdf5.read(folder / "one.h5")
    figures = result.tables["positioning"]
    for name, value in REPORTED.items():
        assert 1e3 * figures.numbers(name)[0] == pytest.approx(value, abs=0.01), name
    assert (result.statistics["observations"], result.statistics["dof"]) == (50, 45)
    assert result.statistics["sigma0"] == pytest.approx(1.371, abs=1e-3)
    assert "volume" not in result.tables


def test_it_is_diagnosed(case: Case, metrocli: Metrocli) -> None:
    folder = case("12-iso230-displacement-only")
    (folder / "job.yaml").write_text(ONE_AXIS)
    ran = metrocli("diagnose", "job.yaml", "--limit", "20s")
    assert ran.code == 0 and "verdict:" in ran.out


def test_some_of_six_channels_are_refused(case: Case, metrocli: Metrocli) -> None:
    folder = case("12-iso230-displacement-only")
    lines = (folder / "lines.csv").read_text().splitlines()
    rows = [line if line.startswith("#") else f"{line},{'ey_um' if 'line' in line else '0.3'}" for line in lines]
    (folder / "lines.csv").write_text("\n".join([*rows, ""]))
    ran = metrocli("calibrate-machine", "job.yaml")
    assert ran.code == 3 and "either all six channels" in ran.err and "is it the column" not in ran.err
    ran = metrocli(
        "calibrate-machine", "job.yaml", "--set", "inputs.lines=lines_zeros.csv", "--set", "noise.angle=0 rad"
    )
    assert ran.code == 3
