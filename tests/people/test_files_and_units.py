"""Units, tables and numbers as people write them: read rightly, or refused with what is wrong."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Case = Callable[[str], Path]
Metrocli = Callable[..., Any]


def test_a_density_in_grams_per_cubic_centimetre(case: Case, metrocli: Metrocli) -> None:
    case("13-centimetres")
    more = ("--set", "monte_carlo.trials=10000", "--output", "d.h5", "--json")
    for unit, value in (("g/cm^3", 14.967), ("kg/dm^3", 14.967), ("kg/m^3", 14967.0)):
        ran = metrocli("report-uncertainty", "density.yaml", "--set", f"measurands.rho.unit={unit}", "--force", *more)
        assert json.loads(ran.out)["estimates"]["rho"]["value"] == pytest.approx(value, rel=1e-4)


def test_a_mesh_in_centimetres(case: Case, metrocli: Metrocli) -> None:
    case("13-centimetres")
    ran = metrocli("fit-part", "part.yaml")
    assert ran.code == 3 and "write `nominal_unit: cm`" in ran.err
    assert metrocli("fit-part", "part.yaml", "--set", "nominal_unit=cm").code in (0, 6)


def test_a_pitch_and_targets_in_centimetres(case: Case, metrocli: Metrocli) -> None:
    case("13-centimetres")
    assert "unit" not in metrocli("check", "board.yaml").err


def test_the_line_that_tells_excel_the_separator(case: Case, metrocli: Metrocli) -> None:
    case("16-excel-sep-line")
    assert metrocli("multilaterate", "job.yaml").code == 0


def test_lines_of_an_instrument_before_the_header(case: Case, metrocli: Metrocli) -> None:
    case("16-excel-sep-line")
    ran = metrocli("multilaterate", "job.yaml", "--set", "inputs.lengths=preamble.csv")
    assert ran.code == 3 and ran.err.count("error:") == 1
    assert "preamble.csv:1:1: error: this is not the header, which is line 4" in ran.err
    assert "delete the lines before it" in ran.err and "decimal comma" not in ran.err


def test_a_last_column_and_rows_that_are_empty(case: Case, metrocli: Metrocli) -> None:
    case("16-excel-sep-line")
    assert metrocli("multilaterate", "job.yaml", "--set", "inputs.lengths=trail.csv").code == 0


def test_two_byte_order_marks(case: Case, metrocli: Metrocli) -> None:
    folder = case("17-double-bom")
    assert metrocli("multilaterate", "job.yaml").code == 0
    (folder / "map.yaml").write_text((folder / "map.yaml").read_text().replace("semicolon", "comma"))
    (folder / "map.yaml").write_text((folder / "map.yaml").read_text().replace("decimal: comma", "decimal: point"))
    assert metrocli("import", "lengths.csv", "--from", "columns", "--map", "map.yaml", "--out", "x").code == 0


def test_a_job_file_with_two_byte_order_marks(case: Case, metrocli: Metrocli) -> None:
    folder = case("17-double-bom")
    (folder / "job.yaml").write_text("\ufeff\ufeff" + (folder / "job.yaml").read_text(), encoding="utf-8")
    assert metrocli("multilaterate", "job.yaml").code == 0


def test_what_cancels_has_no_uncertainty(case: Case, metrocli: Metrocli) -> None:
    """A/(A+B) + B/(A+B) is 1: rounding errors of derivatives and trials are not an uncertainty."""
    case("15-rounding-as-uncertainty")
    ran = metrocli("report-uncertainty", "job.yaml", "--set", "monte_carlo.trials=20000", "--json")
    one = json.loads(ran.out)["estimates"]["one"]
    assert (one["value"], one["std"], one["U"], one["mc"]["std"]) == (1.0, 0.0, 0.0, 0.0)
    assert "few degrees of freedom" not in ran.err + ran.out.partition('"twice"')[0]
    assert "depends on no input" in ran.out + ran.err
