"""Compensation files: read back and applied as the control does, they cancel the error; with a wrong sign they double it."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.exports import FORMATS, csv_errors, fanuc, siemens_cec, siemens_lec
from metrocli.exports.compensation import CompensationFormat, places_of
from metrocli.exports.error_tables import AXES, ErrorTable, ErrorTables

MODULES = {name: import_module(form.module) for name, form in FORMATS.items()}
CONTROLS: dict[str, CompensationFormat] = {
    name: one.CONTROL for name, one in MODULES.items() if hasattr(one, "CONTROL")
}
CONTROLS["csv"] = csv_errors.CONTROL
ORDERS = ["".join(order) for order in itertools.permutations(AXES)]
RANGES = {"X": (0.0, 600.0, 13), "Y": (-260.0, 260.0, 11), "Z": (-500.0, 0.0, 11)}


def machine(seed: int, order: str = "XYZ", tool: tuple[float, float, float] = (10.0, -20.0, 120.0)) -> ErrorTables:
    """Return a machine with all 21 errors: tens of um, tens of urad."""
    random = np.random.default_rng(seed)
    curves = {}
    for axis, (low, high, count) in RANGES.items():
        grid = np.linspace(low, high, count)
        for kind in "XYZABC":
            size = 0.02 if kind in AXES else 4e-5
            curves[f"E{kind}{axis}"] = ErrorTable(grid, size * np.cumsum(random.normal(size=count)) / np.sqrt(count))
    squareness = dict(zip(("C0Y", "B0Z", "A0Z"), random.normal(scale=3e-5, size=3).tolist(), strict=True))
    return ErrorTables(curves, squareness, order, tool)


def by_hand(tables: ErrorTables, place: Array) -> Array:
    """Return the error at one position, from the contract's formula with vectors and cross products."""
    error = np.zeros(3)
    for axis in AXES:
        where = place[AXES.index(axis)]
        values = {kind: tables.curves[f"E{kind}{axis}"].at(np.array([where]))[0] for kind in "XYZABC"}
        lever = np.array(tables.tool)
        for nearer in tables.order[tables.order.index(axis) + 1 :]:
            lever[AXES.index(nearer)] += place[AXES.index(nearer)]
        error += [values[k] for k in "XYZ"] + np.cross([values[k] for k in "ABC"], lever)
    _, y, z = place
    c, b, a = (tables.squareness[name] for name in ("C0Y", "B0Z", "A0Z"))
    return error + [-c * y + b * z, -a * z, 0.0]


@pytest.mark.parametrize("order", ORDERS)
def test_the_parts_add_up_to_the_rigid_body_model(order: str) -> None:
    tables = machine(1, order)
    places = places_of(tables)[::7]
    expected = np.array([by_hand(tables, place) for place in places])
    assert np.abs(tables.at(places) - expected).max() < 1e-12
    assert np.abs(expected).max() > 0.01


def test_every_compensation_table_has_lines_written_by_hand() -> None:
    assert set(BY_HAND) == set(CONTROLS) > {"siemens-lec", "heidenhain", "csv"}


BY_HAND = {
    # value = error; 808D: a positive one moves the axis in the negative direction
    "siemens-lec": (
        "X_EEC.INI",
        "%_N_X_EEC_INI",
        "CHANDATA(1)",
        "$AA_ENC_COMP[0,0,X1]=0.000000",
        "$AA_ENC_COMP[0,1,X1]=0.004000",
        "$AA_ENC_COMP[0,2,X1]=-0.006000",
        "$AA_ENC_COMP_STEP[0,X1]=50.000000000",
        "$AA_ENC_COMP_MIN[0,X1]=0.000000",
        "$AA_ENC_COMP_MAX[0,X1]=100.000000",
        "$AA_ENC_COMP_IS_MODULO[0,X1]=0",
        "M17",
    ),
    # value = minus the error of Y, added to the set position of Y
    "siemens-cec": (
        "NC_CEC.INI",
        "%_N_NC_CEC_INI",
        "CHANDATA(1)",
        "$AN_CEC[0,0]=-0.000000000",
        "$AN_CEC[0,1]=-0.002000000",
        "$AN_CEC[0,2]=-0.005000000",
        "$AN_CEC_INPUT_AXIS[0]=(X1)",
        "$AN_CEC_OUTPUT_AXIS[0]=(Y1)",
        "$AN_CEC_STEP[0]=50.000000000",
        "$AN_CEC_MIN[0]=0.000000",
        "$AN_CEC_MAX[0]=100.000000",
        "$AN_CEC_DIRECTION[0]=0",
        "$AN_CEC_MULT_BY_TABLE[0]=0",
        "$AN_CEC_IS_MODULO[0]=0",
        "M17",
    ),
    "heidenhain": (
        "AXIS-X.COM",
        "BEGIN AXIS-X.COM MM",
        "NR        AXISPOS   BACKLASH          X          Y",
        "0         +0.0000    +0.0000    +0.0000    +0.0000",
        "1        +50.0000    +0.0000    +0.0040    +0.0020",
        "2       +100.0000    +0.0000    -0.0060    +0.0050",
        "[END]",
    ),
    # minus the error as increments of 1 um over 25 mm: sums 0 -2 -4 (+1 +6), that is -4 um at 50 mm and +6 um at 100 mm
    "fanuc": (
        "pitch-error.txt",
        "%",
        "N3620A1P0",
        "N3621A1P0",
        "N3622A1P4",
        "N3623A1P1",
        "N3624A1P25.000000",
        "N10000P+0",
        "N10001P-2",
        "N10002P-2",
        "N10003P+5",
        "N10004P+5",
        "%",
    ),
    # type 0: nominal, actual going forward, actual in reverse
    "linuxcnc": (
        "x.comp",
        "0.000000 0.0000000 0.0000000",
        "50.000000 50.0040000 50.0040000",
        "100.000000 99.9940000 99.9940000",
    ),
    "isg-csv": (
        "errors.isg.csv",
        "X EXX EYX",
        "0.000000 0.000000000000 0.000000000000",
        "50.000000 0.004000000000 0.002000000000",
        "100.000000 -0.006000000000 0.005000000000",
    ),
    "etalon": (
        "errors.etalon.txt",
        "[EXX]",
        "Gridpoints = {",
        "  50.000000 0.004000000000",
        "  100.000000 -0.006000000000",
        "[EYX]",
        "  50.000000 0.002000000000",
        "  100.000000 0.005000000000",
    ),
    "csv": (
        "errors.csv",
        "error,position_mm,value_um,std_um",
        "EXX,50.000000,4.000000,nan",
        "EXX,100.000000,-6.000000,nan",
        "EYX,50.000000,2.000000,nan",
        "EYX,100.000000,5.000000,nan",
    ),
}
"""A machine that reaches 4 um more than 50 mm and 6 um less than 100 mm in X, and then is 2 um and 5 um off in Y.

Written by hand after each maker's syntax: Siemens 6FC5397-1BP40 pages 242 and 245 to 268, the 808D manual page 106 (sign),
Heidenhain MANUALplus 620 pages 716 to 718, Fanuc B-63330 (parameters 3620 to 3624), LinuxCNC's ini-config (COMP_FILE_TYPE 0),
ISG and Beckhoff's pages of their two formats.
"""


@pytest.mark.parametrize("name", CONTROLS)
def test_a_file_is_what_its_manual_asks_for_line_by_line(name: str) -> None:
    """Reader and writer may err together; these lines are written by hand."""
    grid = np.array([0.0, 50.0, 100.0])
    errors = {"EXX": np.array([0.0, 0.004, -0.006]), "EYX": np.array([0.0, 0.002, 0.005])}
    file, *lines = BY_HAND[name]
    texts = CONTROLS[name].files(ErrorTables({key: ErrorTable(grid, values) for key, values in errors.items()}, {}))
    written = iter(texts[file].splitlines())
    assert all(line in written for line in lines), texts[file]


@pytest.mark.alike
@pytest.mark.parametrize("name", CONTROLS)
@pytest.mark.parametrize("order", ORDERS)
def test_a_round_trip_leaves_the_rounding(name: str, order: str) -> None:
    control = CONTROLS[name]
    for seed in range(3):
        carried = control.carried(machine(seed, order))
        texts = control.written(carried)
        assert control.remaining_error(carried, texts) <= control.rounding_bound(texts)
        assert np.abs(carried.at(places_of(carried))).max() > 10 * control.rounding_bound(texts)


@pytest.mark.alike
@pytest.mark.parametrize("name", CONTROLS)
@pytest.mark.parametrize("size", [1.0, 10.0])
def test_machines_of_all_sizes_are_written(name: str, size: float) -> None:
    """Axes from 0.1 to 20 m, on both sides of zero or beside it, two knots or a hundred; errors up to some 0.1 mm."""
    random = np.random.default_rng(int(size))
    control = CONTROLS[name]
    for _ in range(6):
        curves = {}
        for axis in AXES:
            length, count = random.choice([100.0, 1234.567, 6000.0, 20000.0]), random.choice([2, 11, 100])
            grid = random.choice([0.0, -length / 2, 37.3]) + np.linspace(0.0, length, count)
            for kind in "XYZABC":
                scale = 0.01 * size / (1.0 if kind in AXES else length)
                curves[f"E{kind}{axis}"] = ErrorTable(
                    grid, scale * np.cumsum(random.normal(size=count)) / np.sqrt(count)
                )
        control.files(ErrorTables(curves, {"C0Y": 1.23456789e-5 * size}, "YXZ", (10.5, -20.0, 120.0)))


@pytest.mark.parametrize("name", ["siemens-cec", "heidenhain", "isg-csv", "etalon", "csv"])
def test_squareness_of_an_axis_without_tables_is_carried(name: str) -> None:
    """A job may ask for ECX and C0Y alone: then the range of Y is known, and no table of it."""
    curve = ErrorTable(np.linspace(0.0, 600.0, 7), 1e-5 * np.arange(7.0))
    tables = ErrorTables({"ECX": curve}, {"C0Y": 5e-5}, "XYZ", (0.0, 0.0, 120.0), {"Y": (-260.0, 260.0)})
    control = CONTROLS[name]
    held = control.read(control.files(tables))
    reached = control.moved(held, np.array([[0.0, -260.0, 0.0], [0.0, 260.0, 0.0]]))
    assert reached[1, 0] - reached[0, 0] == pytest.approx(5e-5 * 520, abs=2e-4)


def test_fanuc_says_how_coarse_it_is() -> None:
    """A step of 60 um between two points of a table of many: increments end at 7, so the unit is magnified."""
    grid = np.linspace(0.0, 600.0, 121)
    curve = ErrorTable(grid, 0.03 * (-1.0) ** np.arange(121))
    control = fanuc.CONTROL
    texts = control.files(ErrorTables({"EXX": curve}, {}))
    assert fanuc.read(texts)[0].magnification == 9
    assert control.rounding_bound(texts) == pytest.approx(0.009)
    assert "SUMS ARE ROUNDED TO X 0.009 MM" in texts["pitch-error.txt"]
    off = ErrorTable(np.linspace(12.3, 587.1, 13), 0.05 * (-1.0) ** np.arange(13))
    (text,) = control.files(ErrorTables({"EXX": off}, {}, left_out=("EAZ",), together=("EXZ",))).values()
    lost = float(re.findall(r"CORNERS ARE ROUNDED BY UP TO (\S+) MM", text)[0])
    carried = control.carried(ErrorTables({"EXX": off}, {})).curves["EXX"]
    assert lost == pytest.approx(np.abs(carried.at(off.positions) - off.values + 0.05).max(), abs=1e-4)
    assert all(line.count("(") <= 1 for line in text.splitlines())


@pytest.mark.parametrize("name", CONTROLS)
def test_a_wrong_sign_doubles_the_error_and_is_caught(name: str) -> None:
    control = CONTROLS[name]
    carried = control.carried(machine(3))
    before = np.abs(carried.at(places_of(carried))).max()
    wrong = replace(control, moved=lambda held, places: -control.moved(held, places))
    assert wrong.remaining_error(carried, control.written(carried)) == pytest.approx(2 * before, rel=0.02)
    with pytest.raises(AssertionError, match="leaves"):
        wrong.files(machine(3))


@pytest.mark.parametrize("name", CONTROLS)
def test_every_file_or_its_note_says_the_sign(name: str) -> None:
    texts = CONTROLS[name].files(machine(4))
    assert any("sign: actual minus commanded" in text.lower() for text in texts.values())
    if name not in ("siemens-lec", "linuxcnc", "csv"):
        assert any("test move" in text.lower() for text in texts.values())


def test_together_both_siemens_files_carry_all_errors() -> None:
    tables = machine(5)
    places = places_of(tables)
    moves = sum(
        control.moved(control.read(control.written(control.carried(tables))), places)
        for control in (siemens_lec.CONTROL, siemens_cec.CONTROL)
    )
    assert np.abs(tables.at(places) + moves).max() < 3e-6
    assert np.abs(tables.at(places)).max() > 0.02


def test_a_multiplied_table_points_at_its_lever() -> None:
    text = siemens_cec.CONTROL.files(machine(6))["NC_CEC.INI"]
    numbers = [int(number) for number in re.findall(r"MULT_BY_TABLE\[\d+\]=(\d+)", text)]
    assert sum(number > 0 for number in numbers) == 6  # EBX z, ECX y, EAX z, EAX y, EBY z, EAY z
    for number in filter(None, numbers):
        assert f"$AN_CEC_MULT_BY_TABLE[{number - 1}]=0" in text


def fine(count: int) -> ErrorTables:
    grid = np.linspace(0.0, 600.0, count)
    return ErrorTables(
        {"EXX": ErrorTable(grid, 0.01 * np.sin(grid / 50)), "EYX": ErrorTable(grid, 0.01 * np.cos(grid / 50))}, {}
    )


@pytest.mark.parametrize(
    ("name", "count"),
    [("linuxcnc", 257), ("heidenhain", 257), ("fanuc", 200), ("siemens-lec", 5001), ("siemens-cec", 2001)],
)
def test_limits_of_the_control_are_told(name: str, count: int) -> None:
    with pytest.raises(InputError, match="take"):
        CONTROLS[name].files(fine(count))
    CONTROLS[name].files(fine(101))


def test_fanuc_rounds_the_sum_and_not_the_increments() -> None:
    grid = np.linspace(0.0, 600.0, 13)
    slow = ErrorTables({"EXX": ErrorTable(grid, -0.0004 * np.arange(13.0))}, {})
    pitch = fanuc.read(fanuc.CONTROL.files(slow))[0]
    assert pitch.increments.tolist().count(1) == 5
    assert pitch.curve.values[-1] == pytest.approx(0.005)


def test_fanuc_takes_a_table_that_is_on_no_grid_through_zero() -> None:
    grid = np.linspace(12.3, 587.1, 13)
    curve = ErrorTable(grid, 0.01 * np.sin(grid / 100))
    pitch = fanuc.read(fanuc.CONTROL.files(ErrorTables({"EXX": curve}, {})))[0]
    assert pitch.curve.at(np.zeros(1)) == 0
    relative = curve.at(grid) - curve.at(np.zeros(1))
    assert np.abs(pitch.curve.at(grid) + relative).max() < 1.2e-3


def test_fanuc_takes_more_points_or_magnifies_where_increments_are_large() -> None:
    grid = np.linspace(0.0, 600.0, 13)
    steep = fanuc.read(fanuc.CONTROL.files(ErrorTables({"EXX": ErrorTable(grid, 0.02 * (-1.0) ** np.arange(13))}, {})))[
        0
    ]
    assert len(steep.increments) > 13
    assert np.abs(steep.increments).max() <= 7


@pytest.mark.parametrize("name", CONTROLS)
def test_nothing_determined_is_nothing_written(name: str) -> None:
    with pytest.raises(InputError, match="determines n"):
        CONTROLS[name].written(ErrorTables({}, {}))
