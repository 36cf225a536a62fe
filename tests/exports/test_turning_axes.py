"""Positioning of rotary axes in files of controls: in degrees, in the count of the axis, over a whole turn."""

from __future__ import annotations

from importlib import import_module

import numpy as np
import pytest

from metrocli.errors import InputError
from metrocli.exports import FORMATS, export
from metrocli.exports.compensation import positioning_of
from metrocli.result import Result
from metrocli.table import Table

CONTROLS = ("siemens-lec", "fanuc", "heidenhain", "linuxcnc")
AT = np.array([0.0, 90.0, 180.0, 270.0, 360.0])
ERROR = np.array([0.0, 0.004, -0.003, -0.006, 0.0])
"""[deg]"""


def result(
    at: np.ndarray = AT, error: np.ndarray = ERROR, sense: int = 1, more: dict[str, str] | None = None
) -> Result:
    """Return the result of a test of C alone, whose right-handed error is `error` [deg]."""
    table = {"position [rad]": np.radians(at), "value [rad]": np.radians(error), "std [rad]": np.full(len(at), 1e-7)}
    axis = {
        "axis": ["C"], "low high [rad]": np.radians([[at[0], at[-1]]]), "knots": [len(at)], "reference [rad]": [0.0],
        "place": [1], "x y z [mm]": np.zeros((1, 3)), "sense": [sense], "head": [False], "periodic": [True],
    }  # fmt: skip
    linear = {"axis": np.zeros(0, dtype=str), "low high [mm]": np.zeros((0, 2)), "place": np.zeros(0)}
    named = {"error": ["ECC"], "status": ["determined"]}
    tables = {
        "tables/ECC": Table.of(table), "rotary_axes": Table.of(axis), "axes": Table.of(linear), "errors": Table.of(named),
    }  # fmt: skip
    return Result("calibrate-machine", "", (), np.zeros((0, 0)), more or {}, tables)


BY_HAND = {
    # the value is the error, which the control adds to the actual position; modulo from 0 to 360 deg (808D manual, p. 109)
    "siemens-lec": (
        "C_EEC.INI",
        "$AA_ENC_COMP[0,0,C1]=0.000000",
        "$AA_ENC_COMP[0,1,C1]=0.004000",
        "$AA_ENC_COMP[0,3,C1]=-0.006000",
        "$AA_ENC_COMP[0,4,C1]=0.000000",
        "$AA_ENC_COMP_STEP[0,C1]=90.000000000",
        "$AA_ENC_COMP_MIN[0,C1]=0.000000",
        "$AA_ENC_COMP_MAX[0,C1]=360.000000",
        "$AA_ENC_COMP_IS_MODULO[0,C1]=1",
    ),
    # points at each 90 deg: -4, +3, +6, 0 units of 0.001 deg, so -4 +7 +3 -6, 0 in sum; the reference point is the first
    # one, with the value of the last (B-63980EN, p. 100)
    "fanuc": (
        "pitch-error.txt",
        "N3620A6P0",
        "N3621A6P0",
        "N3622A6P4",
        "N3623A6P1",
        "N3624A6P90.000000",
        "N3625A6P360.000000",
        "N10000P-6",
        "N10001P-4",
        "N10002P+7",
        "N10003P+3",
        "N10004P-6",
    ),
    "heidenhain": (
        "AXIS-C.COM",
        "BEGIN AXIS-C.COM MM",
        "1        +90.0000    +0.0000    +0.0040",
        "2       +180.0000    +0.0000    -0.0030",
        "4       +360.0000    +0.0000    +0.0000",
    ),
    "linuxcnc": (
        "c.comp",
        "0.000000 0.0000000 0.0000000",
        "90.000000 90.0040000 90.0040000",
        "270.000000 269.9940000 269.9940000",
    ),
}


@pytest.mark.parametrize("name", CONTROLS)
def test_a_file_is_what_its_manual_asks_for_line_by_line(name: str) -> None:
    file, *lines = BY_HAND[name]
    texts = export(name, result())
    written = iter(str(texts[file]).splitlines())
    assert all(line in written for line in lines), texts[file]
    told = " ".join(map(str, texts.values())).lower()
    # the axis is 0.006 deg short at 270 deg, so it must move on by this
    assert "test move" in told and "+0.006" in told and "270.000 deg" in told


@pytest.mark.parametrize("name", CONTROLS)
@pytest.mark.parametrize("sense", [1, -1])
def test_the_control_cancels_what_the_axis_errs_in_its_own_count(name: str, sense: int) -> None:
    control = import_module(FORMATS[name].module).CONTROL
    texts = export(name, result(error=sense * ERROR, sense=sense))
    places = np.zeros((5, 6))
    places[:, 5] = AT
    moved = control.moved(control.read(texts), places)
    assert np.abs(moved[:, 5] + ERROR).max() < 1.1 * control.resolution
    assert not moved[:, :5].any()


@pytest.mark.parametrize("name", CONTROLS)
def test_a_turn_from_minus_180_is_written_from_0(name: str) -> None:
    """The same errors listed from -180 to 180 deg."""
    texts = export(name, result(AT - 180, ERROR[[2, 3, 0, 1, 2]]))
    assert texts == export(name, result())


def test_of_one_turn_the_increments_add_up_to_zero() -> None:
    random = np.random.default_rng(4)
    at = np.linspace(0.0, 360.0, 25)
    error = np.append(0.004 * random.normal(size=24), 0.0)
    error[-1] = error[0]
    text = str(export("fanuc", result(at, error))["pitch-error.txt"])
    values = [int(line.split("P")[1]) for line in text.splitlines() if line.startswith("N1")]
    assert sum(values[1:]) == 0 and values[0] == values[-1] and any(values)


@pytest.mark.parametrize("name", CONTROLS)
@pytest.mark.parametrize("key", ["undetermined", "together"])
def test_what_is_known_only_together_is_not_written(name: str, key: str) -> None:
    with pytest.raises(InputError):
        export(name, result(more={key: "ECC EAC"}))


def test_a_backlash_is_in_degrees() -> None:
    held = result(sense=-1)
    held.tables["effects/backlash.c/parameters"] = Table.of({"parameter": ["width"], "value": [np.radians(-0.002)]})  # type: ignore[index]
    assert positioning_of(held).reversal["C"] == pytest.approx(0.002)
    line = str(export("linuxcnc", held)["c.comp"]).splitlines()[1]
    # the error in the count is -0.004 deg, and half of the backlash comes on top in forward travel
    assert line == "90.000000 89.9970000 89.9950000"


def test_fanuc_writes_no_table_of_zeros() -> None:
    """An error of 1.8 arcsec is half of its unit of 0.001 deg; a smaller one leaves no increment."""
    with pytest.raises(InputError, match="ECC would be tables of zeros"):
        export("fanuc", result(error=ERROR / 13))
    assert "c.comp" in export("linuxcnc", result(error=ERROR / 13))


def test_what_a_job_asks_for_and_does_not_get_has_its_reason_beside() -> None:
    """The place of the axis is known only together with the tool, its positioning alone."""
    held = result(more={"together": "EX0C EY0C"})
    texts = export("linuxcnc", held)
    assert "c.comp" in texts and "do not determine EX0C EY0C" in str(texts["not-written.txt"])
    assert "not-written.txt" not in export("linuxcnc", result())
