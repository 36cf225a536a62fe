"""Files of instruments become CSV that jobs read, with the digits of the file; faults have file and row."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from metrocli.formats import csv
from metrocli.imports import FORMATS
from metrocli.settings import settings_of
from metrocli.tasks import KINDS

DOCS = Path(__file__).parents[2] / "docs"
LENGTHS = """Instrument: LT1;;;
Pt No;Zeit (s);Dist;Temp
1;0;-1000,25;20,1
2;12,5;-1033,5e0;20,2
3;25;7;20,2
"""
MAP = """job: multilaterate
input: lengths
header: 2
decimal: comma
columns:
  point: Pt No
  tracer: {value: LT1}
  length: {column: Dist, unit: um, sign: -1}
  t: {column: 2, unit: s}
  temp: {column: Temp, unit: degC}
"""
SA = """// SpatialAnalyzer 2020
// Working frame: A::WORLD
A, Floor, P1, 1.25, -2.5E+00, 3
A, Floor, P2, 4.0, 5.0, 6.0

A, Roof, P1, 7, 8, 9
"""
VNL = """## generated with mrgingham
# filename x y level
a.jpg - - -
b.jpg 1385.433000 1471.719000 0
b.jpg 1483.597000 1469.825000 1
c.jpg 10.5 20.25 0
c.jpg 30.5 -0.25 0
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "LT1.txt").write_text(LENGTHS)
    (tmp_path / "map.yaml").write_text(MAP)
    (tmp_path / "points.txt").write_text(SA)
    (tmp_path / "corners.vnl").write_text(VNL)
    return tmp_path


Metrocli = Callable[..., Any]


def rows_of(path: Path) -> list[str]:
    return [line for line in path.read_text().splitlines() if not line.startswith("#")]


def test_any_table_becomes_the_input_of_a_job(folder: Path, metrocli: Metrocli) -> None:
    ran = metrocli("import", "LT1.txt", "--from", "columns", "--map", "map.yaml", "--out", "data")
    assert (ran.code, ran.out) == (0, "data/lengths.csv\n")
    assert rows_of(folder / "data/lengths.csv") == [
        "point,tracer,length_um,t_s,temp_degC",
        "1,LT1,1000.25,0,20.1",
        "2,LT1,1033.5e0,12.5,20.2",
        "3,LT1,-7,25,20.2",
    ]
    inputs = settings_of(KINDS["multilaterate"].settings())["inputs"][0].spec
    columns = settings_of(inputs.section)["lengths"][0].spec.columns  # type: ignore[attr-defined]
    table = csv.read(folder / "data/lengths.csv", columns)
    assert table.numbers("length").tolist() == pytest.approx([1.00025, 1.0335, -0.007], rel=1e-12)


def test_a_table_without_names_is_read_by_numbers(folder: Path, metrocli: Metrocli) -> None:
    (folder / "plain.txt").write_text("% stops\nA  1.5 2 3\nB -4 5 6.25\n")
    (folder / "plain.yaml").write_text(
        "job: multilaterate\ninput: points\nfile: stops.csv\nheader: none\nseparator: space\ncomment: '%'\n"
        "columns: {point: 1, x: {column: 2, unit: m}, y: {column: 3, unit: m}, z: {column: 4, unit: m, sign: -1}}\n"
    )
    ran = metrocli("import", "plain.txt", "--from", "columns", "--map", "plain.yaml")
    assert (ran.code, ran.out) == (0, "stops.csv\n")
    assert rows_of(folder / "stops.csv") == ["point,x_m,y_m,z_m", "A,1.5,2,-3", "B,-4,5,-6.25"]


def test_a_decimal_comma_does_not_separate(folder: Path, metrocli: Metrocli) -> None:
    """The first row has more commas than semicolons."""
    (folder / "plain.txt").write_text("A;0,5;1,25;3,75\nB;4,5;5,5;6,5\n")
    (folder / "plain.yaml").write_text(
        "job: multilaterate\ninput: points\nheader: none\ndecimal: comma\n"
        "columns: {point: 1, x: {column: 2, unit: mm}, y: {column: 3, unit: mm}, z: {column: 4, unit: mm}}\n"
    )
    assert metrocli("import", "plain.txt", "--from", "columns", "--map", "plain.yaml").code == 0
    assert rows_of(folder / "points.csv") == ["point,x_mm,y_mm,z_mm", "A,0.5,1.25,3.75", "B,4.5,5.5,6.5"]


def test_points_of_spatial_analyzer(folder: Path, metrocli: Metrocli) -> None:
    ran = metrocli("import", "points.txt", "--from", "sa-ascii", "--unit", "mm", "--out", "data", "--json")
    assert ran.code == 0
    assert "data/points.csv" in ran.out
    assert rows_of(folder / "data/points.csv") == [
        "point,x_mm,y_mm,z_mm", "Floor::P1,1.25,-2.5E+00,3", "Floor::P2,4.0,5.0,6.0", "Roof::P1,7,8,9",
    ]  # fmt: skip
    (folder / "short.txt").write_text("P1 1 2 3\nP2 4 5 6\n")
    assert metrocli("import", "short.txt", "--from", "sa-ascii", "--unit", "um", "--out", "um").code == 0
    assert rows_of(folder / "um/points.csv") == ["point,x_um,y_um,z_um", "P1,1,2,3", "P2,4,5,6"]


def test_corners_of_mrgingham(folder: Path, metrocli: Metrocli) -> None:
    assert metrocli("import", "corners.vnl", "--from", "vnl", "--out", "data").code == 0
    assert rows_of(folder / "data/observations.csv") == [
        "image,target,u_px,v_px",
        "b.jpg,0,1385.433000,1471.719000",
        "b.jpg,1,1483.597000,1469.825000",
        "c.jpg,0,10.5,20.25",
        "c.jpg,1,30.5,-0.25",
    ]


@pytest.mark.parametrize("level", ["-", "-1"])
def test_corners_that_were_not_found_are_left_out_and_counted(level: str, folder: Path, metrocli: Metrocli) -> None:
    """Their coordinates may be numbers; the corners after them keep their names."""
    (folder / "corners.vnl").write_text(VNL.replace("10.5 20.25 0", f"0 0 {level}"))
    ran = metrocli("import", "corners.vnl", "--from", "vnl", "--out", "data")
    assert ran.code == 0 and "1 corners that the file calls not found are left out" in ran.err
    assert [row for row in rows_of(folder / "data/observations.csv") if row.startswith("c.")] == ["c.jpg,1,30.5,-0.25"]


def test_an_input_is_never_overwritten(folder: Path, metrocli: Metrocli) -> None:
    """Neither with --force nor under another spelling of its path."""
    before = (folder / "LT1.txt").read_text()
    (folder / "map.yaml").write_text(f"{MAP}file: LT1.txt\n")
    for more in ((), ("--out", f"../{folder.name}")):
        ran = metrocli("import", "LT1.txt", "--from", "columns", "--map", "map.yaml", "--force", *more)
        assert ran.code == 3 and "the file it reads" in ran.err
    assert (folder / "LT1.txt").read_text() == before


def test_nothing_is_replaced_without_force(folder: Path, metrocli: Metrocli) -> None:
    arguments = ("import", "corners.vnl", "--from", "vnl")
    (folder / "observations.csv").write_text("mine\n")
    ran = metrocli(*arguments)
    assert ran.code == 3
    assert "use --force" in ran.err
    assert (folder / "observations.csv").read_text() == "mine\n"
    assert metrocli(*arguments, "--force").code == 0
    assert (folder / "observations.csv").read_text().startswith("# from corners.vnl (vnl)\n")


FAULTS: dict[str, tuple[str, str, str, int, list[str]]] = {
    # file, text to replace, by what, exit code, what the message has
    "no number": ("LT1.txt", "-1033,5e0", "overload", 3, ["LT1.txt:4", "length: 'overload' is not a number"]),
    "two rows": ("LT1.txt", "20,", "x", 3, ["LT1.txt:3", "LT1.txt:4", "LT1.txt:5", "temp: 'x1'"]),
    "empty": ("LT1.txt", "3;25;7", "3;25;", 3, ["LT1.txt:5", "the cell is empty"]),
    "short row": ("LT1.txt", "3;25;7;20,2", "3;25;7", 3, ["LT1.txt:5", "3 cells instead of 4"]),
    "decimal": ("map.yaml", "decimal: comma", "decimal: point", 3, ["LT1.txt:3", "write `decimal: comma`"]),
    "open quote": ("LT1.txt", "2;12,5", '"2;12,5', 3, ["LT1.txt:4", "1 cells instead of 4"]),
    "thousands": ("LT1.txt", "-1000,25", "-1.000", 3, ["LT1.txt:3", "'-1.000' has a point", "decimal: point"]),
    "column": ("map.yaml", "column: Dist", "column: Dst", 3, ["map.yaml:8", "did you mean 'Dist'?"]),
    "quantity": ("map.yaml", "  length:", "  lenght:", 3, ["map.yaml:8", "'length'", "the input also needs length"]),
    "unit": ("map.yaml", "unit: um", "unit: kg", 3, ["map.yaml:8", "length is a length and has the unit 'kg'", "mm"]),
    "no unit": ("map.yaml", "unit: um, ", "", 3, ["map.yaml:8", "has no unit"]),
    "sign": ("map.yaml", "sign: -1", "sign: minus", 3, ["map.yaml:8"]),
    "input": ("map.yaml", "input: lengths", "input: length", 3, ["map.yaml:2", "did you mean 'lengths'?"]),
    "folder": ("map.yaml", "header: 2", "file: ../a.csv", 3, ["map.yaml:3", "a name without folders"]),
    "key": ("map.yaml", "decimal", "decimals", 3, ["map.yaml:4", "did you mean 'decimal'?"]),
    "value": ("map.yaml", "t: {column: 2", "t: {value: noon", 3, ["map.yaml:9", "'noon' is not a number"]),
    "coordinate": ("points.txt", "-2.5E+00", "nan", 3, ["points.txt:3", "'nan' is not a number"]),
    "uncertainties": ("points.txt", "7, 8, 9", "7, 8, 9, .1, .1, .1", 3, ["points.txt:6", "9 fields"]),
    "one more": ("points.txt", "A, Roof, P1, 7, 8, 9", "P1, 7.5, 8, 9, .1", 3, ["points.txt:6", "the name '7.5'"]),
    "twice": ("points.txt", "Roof, P1", "Floor, P1", 3, ["the point 'A::Floor::P1' is there 2 times"]),
    "legend": ("corners.vnl", "# filename x y level", "# file x y", 3, ["corners.vnl:2", "the legend lacks filename"]),
    "pixel": ("corners.vnl", "20.25", "20,25", 3, ["corners.vnl:6", "'20,25' is not a number"]),
    "lost corner": ("corners.vnl", "c.jpg 30.5 -0.25 0\n", "", 3, ["c.jpg has 1 corners, but b.jpg has 2"]),
}
COMMANDS = {
    "LT1.txt": ("LT1.txt", "--from", "columns", "--map", "map.yaml"),
    "map.yaml": ("LT1.txt", "--from", "columns", "--map", "map.yaml"),
    "points.txt": ("points.txt", "--from", "sa-ascii", "--unit", "mm"),
    "corners.vnl": ("corners.vnl", "--from", "vnl"),
}


@pytest.mark.parametrize("case", FAULTS)
def test_faults_have_file_and_row(folder: Path, metrocli: Metrocli, case: str) -> None:
    file, old, new, code, expected = FAULTS[case]
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new))
    ran = metrocli("import", *COMMANDS[file], "--out", "data")
    assert ran.code == code, ran.err
    for part in expected:
        assert part in ran.err
    assert not (folder / "data").exists()


@pytest.mark.parametrize(
    ("arguments", "code", "expected"),
    [
        (("points.txt", "--from", "sa-ascii"), 2, "--unit"),
        (("points.txt", "--from", "sa-ascii", "--unit", "inch"), 2, "--unit inch is not a unit of length: "),
        (("LT1.txt", "--from", "columns"), 2, "--map"),
        (("corners.vnl", "--from", "vnl", "--unit", "mm"), 2, "--from vnl takes no --unit"),
        (("points.txt", "--from", "sa-ascii", "--unit", "mm", "--map", "map.yaml"), 2, "takes no --map"),
        (("absent.txt", "--from", "vnl"), 3, "absent.txt"),
        (("LT1.txt", "--from", "xlsx"), 2, "xlsx"),
        (("LT1.txt", "--from", "columns", "--map", "absent.yaml"), 3, "absent.yaml"),
    ],
)
def test_wrong_use_is_refused(
    folder: Path, metrocli: Metrocli, arguments: tuple[str, ...], code: int, expected: str
) -> None:
    ran = metrocli("import", *arguments)
    assert ran.code == code
    assert expected in ran.err


def test_each_format_is_on_the_page_with_its_source() -> None:
    page = (DOCS / "imports.md").read_text(encoding="utf-8")
    for name, form in FORMATS.items():
        assert f"`{name}`" in page
        assert form.source.split(",")[0] in page or form.source == "docs/imports.md"
