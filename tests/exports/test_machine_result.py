"""From measured points to compensation: what the files make the control do cancels the true error of the machine."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from importlib import import_module

import numpy as np
import pytest
from simulated import machine as sim

from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.exports import FORMATS, error_tables, export, isg_csv, linuxcnc, siemens_cec, siemens_lec
from metrocli.exports import volumetric as etalon
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.calibrate_machine import task as calibrate_machine

COMPENSATION = {name for name, form in FORMATS.items() if hasattr(import_module(form.module), "CONTROL")} - {"csv"}
"""Formats of compensation alone; csv writes every table of any result, too"""
RIGHT = {
    "siemens": (siemens_lec.CONTROL, siemens_cec.CONTROL),
    "isg": (isg_csv.CONTROL,),
    "etalon": (etalon.CONTROL,),
}


@cache
def measured(tools: int, seed: int = 5) -> tuple[sim.Machine, Result]:
    """Return a machine and its calibration with one tool or three."""
    rng = np.random.default_rng(seed)
    machine = sim.random_machine(rng)
    vectors = sim.ONE if tools == 1 else sim.THREE
    points = sim.points(machine, rng, 400, vectors)
    return machine, calibrate_machine.run(calibrate_machine.TASK.job(sim.settings(tools=vectors), points=points))


def true_error(machine: sim.Machine, places: Array) -> Array:
    tool = np.array(sim.ONE["T1"])
    return np.array([machine.first_order(place, tool) for place in places])


@pytest.mark.alike
@pytest.mark.parametrize("control", RIGHT)
@pytest.mark.parametrize("tools", [1, 3])
def test_the_control_cancels_the_true_error(control: str, tools: int) -> None:
    machine, result = measured(tools)
    places = sim.commands(np.random.default_rng(99), 60)
    tables = error_tables.of(result)
    moves = np.zeros(places.shape)
    for part in RIGHT[control]:
        moves += part.moved(part.read(part.files(tables)), places)
    before, after = (
        sim.without_motion(d, places) for d in (true_error(machine, places), true_error(machine, places) + moves)
    )
    assert np.sqrt((before**2).sum(axis=1).mean()) > 0.05
    assert np.sqrt((after**2).sum(axis=1).mean()) < 0.002


def test_what_is_not_determined_is_in_no_file() -> None:
    _, result = measured(1)
    assert {"EAZ", "EBZ", "ECZ", "ECY"} == set(error_tables.of(result).left_out)
    for name in COMPENSATION:
        for text in export(name, result).values():
            assert isinstance(text, str)
            body = [line for line in text.splitlines() if not line.startswith((";", "//", "(", "#"))]
            if name in ("isg-csv", "etalon"):
                assert not any(error in line for line in body for error in ("EAZ", "EBZ", "ECZ", "ECY"))
        texts = [text for text in export(name, result).values() if isinstance(text, str)]
        assert any("EAZ EBZ ECZ ECY" in text or "ECY EAZ EBZ ECZ" in text for text in texts), name
        assert any(
            "120 mm of the measurement:" in text.replace("MM OF THE MEASUREMENT:", "mm of the measurement:")
            for text in texts
        ), name


def test_plain_csv_has_value_and_uncertainty_of_every_knot() -> None:
    machine, result = measured(3)
    files = export("csv", result)
    lengths, angles = (str(files[name]).splitlines() for name in ("errors.csv", "errors-angles.csv"))
    assert lengths[0] == angles[0] == "# sign: actual minus commanded"
    assert "error,position_mm,value_um,std_um" in lengths
    assert "error,position_mm,value_urad,std_urad" in angles
    rows = [line.split(",") for line in lengths if line.startswith("EYX,")]
    value, std = np.array([row[2:] for row in rows], dtype=float).T
    assert np.array([row[1] for row in rows], dtype=float).tolist() == machine.positions("X").tolist()
    assert std[1:-1].min() > 0
    assert np.abs(value - 1e3 * machine.tables["EYX"]).max() < 5 * std.max()


def test_plain_csv_leaves_no_table_of_the_result_out() -> None:
    """Squareness against both lines, and what is determined, beside the tables of the contract."""
    _, result = measured(1)
    files = export("csv", result)
    assert files["squareness.csv"] is result.tables["squareness"]
    assert "least_squares" in result.tables["squareness"]
    assert files["errors-summary.csv"] is result.tables["errors"]
    held = [one for one in files.values() if not isinstance(one, str)]
    assert len(held) == sum(len(table) > 0 for table in result.tables.values())
    assert "error,value_urad,std_urad" in str(files["errors-squareness.csv"])


def test_tables_are_written_for_the_tool_that_was_measured() -> None:
    """A job may list tools that this measurement did not use: tables with an open angle are not right for them."""
    rng = np.random.default_rng(8)
    machine = sim.random_machine(rng)
    used = {"T2": sim.THREE["T2"]}
    points = sim.points(machine, rng, 400, used)
    result = calibrate_machine.run(calibrate_machine.TASK.job(sim.settings(tools=sim.THREE), points=points))
    tables = error_tables.of(result)
    assert tables.tool == sim.THREE["T2"]
    places = sim.commands(rng, 60)
    true = np.array([machine.first_order(place, np.array(sim.THREE["T2"])) for place in places])
    left = sim.without_motion(true + etalon.CONTROL.moved(etalon.read(etalon.CONTROL.files(tables)), places), places)
    assert np.sqrt((left**2).sum(axis=1).mean()) < 0.002 < 0.03 < np.sqrt((true**2).sum(axis=1).mean())


def test_backlash_is_compensated_where_a_format_has_a_place_for_it_and_told_elsewhere() -> None:
    machine, result = measured(3)
    width = 0.0123
    name, value, std, unit = (np.array([one]) for one in ("width", width, 0.0002, "mm"))
    effect = Table({"name": name, "value": value, "std": std, "unit": unit, "estimated": np.array([True])})
    more = {"effects/backlash.y/parameters": effect, "effects/thermal-growth.x/parameters": effect}
    found = replace(result, tables={**result.tables, **more})
    held = linuxcnc.read({name: str(text) for name, text in export("linuxcnc", found).items()})
    for axis, gap in (("X", 0.0), ("Y", width), ("Z", 0.0)):
        forward, reverse = held[axis]
        assert np.abs(reverse.values - forward.values - gap).max() < 3e-7, "trim takes the error away: less forward"
        assert np.abs((forward.values + reverse.values) / 2 + machine.tables[f"E{axis}{axis}"]).max() < 0.005
    for form in {*COMPENSATION, "csv"} - {"linuxcnc"}:
        told = "\n".join(text for text in export(form, found).values() if isinstance(text, str)).lower()
        assert "backlash of y, 0.0123 mm, is not in these tables" in told, form
        assert "estimated in the result, but not in these tables: thermal-growth.x" in told, form


def test_another_result_has_no_compensation() -> None:
    other = Result("straight-line", "", (), np.zeros((0, 0)), {}, {"residuals": Table({"a": np.arange(2.0)})})
    for name in COMPENSATION:
        with pytest.raises(InputError, match="calibrate-machine"):
            export(name, other)
