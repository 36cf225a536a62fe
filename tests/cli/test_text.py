"""What reports print: the status first, one unit for each column, digits that suit the uncertainty, no inf."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from metrocli.cli import columns, terminal
from metrocli.cli.look.inches import in_inches
from metrocli.formats import hdf5
from metrocli.record import CriterionVerdict, Record
from metrocli.result import SCALE, Estimate, Result, ShownTable
from metrocli.table import Table

Metrocli = Callable[..., Any]
INF = float("inf")
RATE = Estimate("tracer-drift.LT2.rate", 2.5e-10, 4e-11, "1/s", "rate")
"""0.90 ± 0.144 ppm/h"""
POINTS = Table(
    {
        "point": np.array(["A", "B"]),
        "x": np.array([1311.28425, -20.5]),
        "y": np.array([0.125, np.nan]),
        "sx": np.array([0.00025249, 0.00125]),
        "sy": np.array([0.0314, np.inf]),
    },
    dict.fromkeys(("x", "y", "sx", "sy"), "mm"),
)


def record(*verdicts: CriterionVerdict, doubts: tuple[str, ...] = (), text: str = "") -> Record:
    return Record(text, (), "0", "2026-01-01", verdicts, doubts)


def result(*estimates: Estimate, **more: Any) -> Result:
    statistics = {"observations": 9, "dof": 0, "sigma0": float("nan")}
    return Result("multilaterate", "", estimates, np.eye(len(estimates)), statistics, **more)


def rows(text: str) -> list[list[str]]:
    return [line.split() for line in text.splitlines()]


def values(estimates: Sequence[Estimate], job_text: str = "") -> str:
    """The lines of estimates without their heading, which states what ± is."""
    heading, _, lines = terminal.estimates_text(estimates, job_text).partition("\n")
    assert heading == "value ± standard uncertainty:"
    return lines


def test_status_and_criteria_precede_the_values() -> None:
    found = result(
        Estimate("LT1.x", 1.0, 0.1, "mm"),
        tables={"points": POINTS},
        shown=(ShownTable("points"),),
        notes=("a note",),
        warnings=("one", "two"),
    )
    unmet = CriterionVerdict("x.std", "< 50 um", 0.1, "mm", False)
    lines = terminal.result_text(found, record(unmet, doubts=("too noisy",)), Path("r.h5")).splitlines()
    assert lines[:5] == [
        "multilaterate",
        "status: doubtful, 2 warnings",
        "DOUBTFUL: too noisy",
        "observations 9, dof 0, sigma0 not determined",
        "required x.std < 50 um: NOT met (100 um)",
    ]
    places = [
        lines.index(line) for line in ("value ± standard uncertainty:", "LT1.x  1.00  ± 0.10  mm", "a note", "points")
    ]
    assert places == sorted(places)
    assert places[0] == 6


def test_each_column_has_one_unit_and_the_digits_of_its_uncertainty() -> None:
    assert rows(columns.table_text(POINTS)) == [
        ["point", "x", "[mm]", "y", "[mm]", "sx", "[um]", "sy", "[um]"],
        ["A", "1311.28425", "0.125", "0.25", "31.40"],
        ["B", "-20.50000", "-", "1.25", "-"],
    ]


def test_rows_of_several_units_are_shown_unit_by_unit() -> None:
    errors = Table(
        {
            "error": np.array(["EXX", "EAX", "EYX"]),
            "largest": np.array([0.25, 5e-5, 0.003]),
            "largest_std": np.array([0.0021, 4.2e-7, 0.0034]),
            "unit": np.array(["mm", "rad", "mm"]),
        }
    )
    assert rows(columns.table_text(errors)) == [
        ["error", "largest", "[mm]", "largest_std", "[um]"],
        ["EXX", "0.2500", "2.1"],
        ["EYX", "0.0030", "3.4"],
        ["error", "largest", "[urad]", "largest_std", "[urad]"],
        ["EAX", "50.00", "0.42"],
    ]


def test_plain_numbers_have_no_unit_of_their_row() -> None:
    groups = Table.of({"unit": ["mm"], "rms": [0.5], "redundancy [1]": [25.4]})
    assert rows(columns.table_text(groups))[0] == ["rms", "[mm]", "redundancy"]
    inches = in_inches(Result("adjust-network", "", (), np.eye(0), {}, {"groups": groups})).tables["groups"]
    assert (inches.numbers("redundancy").tolist(), inches.numbers("rms").tolist()) == ([25.4], [0.5 / 25.4])


def test_a_given_point_sets_no_digits_and_a_long_table_is_cut() -> None:
    std = np.full(50, 0.02)
    std[3] = 1e-15
    text = columns.table_text(Table({"x": np.full(50, 3.14159), "sx": std}, {"x": "mm", "sx": "mm"}))
    assert rows(text)[1] == ["3.142", "20"]
    assert text.splitlines()[-1] == "... 10 more rows (show --table prints all)"
    assert len(text.splitlines()) == 42


def test_rates_are_in_the_unit_of_the_job_or_in_one_that_suits_them() -> None:
    text = "require: {tracer-drift.LT2.rate.std: '< 0.1 ppm/min'}  # not 1 ppm/h\n"
    assert values([RATE], text) == "tracer-drift.LT2.rate  0.0150  ± 0.0024  ppm/min"
    assert values([RATE], "drift: 3 ppm/h") == "tracer-drift.LT2.rate  0.90  ± 0.14  ppm/h"
    assert values([RATE]) == "tracer-drift.LT2.rate  0.90  ± 0.14  ppm/h"
    jumps = [Estimate(f"dead-path-jump.{one}.step", 0.0016, 0.00011, "mm", "length") for one in ("A", "B")]
    assert rows(values(jumps, "tolerance: 1 mm"))[1] == [
        "dead-path-jump.B.step",
        "1.60",
        "±",
        "0.11",
        "um",
    ]


def test_a_unit_of_ones_own_is_shown_as_it_was_written() -> None:
    """1 arcsec/m is 4.848137e-9 1/mm; without the words of the user the number has nine zeros."""
    turn = Estimate("turn-of-beam.LT2.a", 4.848137e-8, 2.424068e-9, "mm-1")
    text = "define:\n  - {name: turn-of-beam, parameters: {a: {unit: arcsec/m, plausible: 5 arcsec/m}}}"
    assert values([turn], text) == "turn-of-beam.LT2.a  10.00  ± 0.50  arcsec/m"
    assert values([turn]).endswith("mm-1")
    density = Estimate("rho", 7850.0, 1.0, "kg/m^3")
    assert values([density], "rho: {value: 7.85 g/cm^3}").endswith("kg/m^3")


def test_a_humidity_in_percent_is_no_unit_of_a_ratio() -> None:
    scale = Estimate("tracer-scale.LT2.scale", 4e-7, 1e-8, "1", "ratio")
    shown = {
        "humidity: 50 percent\nnoise: {proportional: 0.1 um/m}": "0.400 ± 0.010 um/m",
        "noise: {proportional: 0.1 um/m}\nscale: {uncertainty: 1 ppm}": "0.400 ± 0.010 ppm",
        "humidity: 50 percent": "400 ± 10 nm/m",
    }
    for text, expected in shown.items():
        assert " ".join(values([scale], text).split()[1:]) == expected


def test_a_scale_is_also_shown_from_1() -> None:
    text = values([Estimate("LT1.scale", 0.99999987, 9.5e-8, "1", SCALE)], "scale: {uncertainty: 1 ppm}")
    assert text == "LT1.scale  0.999999870  ± 0.000000095    (-0.130 ± 0.095 ppm from 1)"


def test_what_is_not_determined_is_stated_so() -> None:
    assert values([Estimate("4.x", 0.1004478289, INF, "mm")]) == "4.x  not determined"
    assert values([replace(RATE, std=INF)]) == "tracer-drift.LT2.rate  not determined"
    assert str(CriterionVerdict("ratio", "< 4", INF, "1", False)) == "required ratio < 4: NOT met (not determined)"


def test_the_file_keeps_the_dimensions(job: Path, metrocli: Metrocli, tmp_path: Path) -> None:
    metrocli("straight-line", job)
    found, stored = hdf5.read(Path("results/line.h5"))
    estimates = (RATE, *found.estimates[1:])
    covariance = np.diag([estimate.std**2 for estimate in estimates])
    hdf5.write(tmp_path / "r.h5", replace(found, estimates=estimates, covariance=covariance), stored)
    assert hdf5.read(tmp_path / "r.h5")[0].estimates == estimates
