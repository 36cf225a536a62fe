"""What `import` proposes for a table: it reads the file as it stands, or the file is refused as none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Metrocli = Callable[..., Any]
TABLES = {
    "plain numbers": ("1.5 2.5 3.5\n1.6 2.4 3.3\n", ["space", "none"], (3, "UNIT")),
    "named by a comment": ("#Name\tX\tY\nT1\t1000.1\t2.5\nT2\t1100.1\t2.6\n", ["tab", "none"], (2, "UNIT")),
    "unit in brackets": ("Axis:,X\n\nTarget (mm),Run 1 (um)\n0,0.3\n50,1.2\n", ["comma", "header: 3"], (2, "um")),
    "pixels": ("Name,Photo,X (pixels)\nT1,1,10.5\nT2,1,11.5\n", ["comma", "header: 1"], (3, "px")),
    "unit below the name": ("Trajectories\n,,M1\nFrame,Sub,X\n,,mm\n1,0,1.5\n2,0,1.6\n", ["header: 4"], (3, "mm")),
    "comma as decimal sign": ("Name;X\nP 1;1.200,5\nP 2;100,5\n", ["semicolon", "decimal: comma"], (2, "UNIT")),
    "other comments": ("// program\nA P1 10.5\nA P2 11.5\n", ["space", 'comment: "//"'], (3, "UNIT")),
    "lines after the table": (
        "P1,1.5,2.5,3.5\nP2,1.6,2.6,3.6\n\nFile End.\n",
        ["comma", "remove line 4:"],
        (2, "UNIT"),
    ),
}


@pytest.mark.parametrize("name", TABLES)
def test_the_proposal_is_as_the_file_shows(name: str, tmp_path: Path, metrocli: Metrocli) -> None:
    text, words, (column, unit) = TABLES[name]
    (tmp_path / "t.txt").write_text(text)
    ran = metrocli("import", tmp_path / "t.txt")
    assert ran.code == 0, ran.err
    assert all(word in ran.out for word in words), ran.out
    assert f"QUANTITY{column}: {{column: {column}, unit: {unit}}}" in ran.out, ran.out


def test_text_has_no_unit_and_no_row_is_lost(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "t.txt").write_text("# station point x\nS1 P1 1.5 2.5 3.5\nS1 P2 1.6 2.6 3.6\n")
    mapping = metrocli("import", tmp_path / "t.txt").out
    assert "QUANTITY1: {column: 1}  # e.g. S1" in mapping
    for number, quantity in ((2, "point"), (3, "x"), (4, "y"), (5, "z")):
        mapping = mapping.replace(f"QUANTITY{number}", quantity)
    mapping = (
        mapping.replace("unit: UNIT", "unit: mm")
        .replace("multilaterate", "fit-points")
        .replace("input: lengths", "input: points")
    )
    mapping = "\n".join(line for line in mapping.splitlines() if "QUANTITY" not in line)
    (tmp_path / "map.yaml").write_text(mapping)
    ran = metrocli("import", tmp_path / "t.txt", "--map", tmp_path / "map.yaml", "--out", tmp_path / "out")
    assert ran.code == 0, ran.err
    assert (tmp_path / "out" / "points.csv").read_text().splitlines()[1:] == [
        "point,x_mm,y_mm,z_mm", "P1,1.5,2.5,3.5", "P2,1.6,2.6,3.6",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<?xml version='1.0'?>\n<LandXML/>\n", "this is XML"),
        ('{"fx": 349.7}\n', "this is JSON"),
        ("calib_time: 09-Jan\nS_00: 1392 512\nK_00: 984 0 690 0 980 233 0 0 1\n", "not a table of numbers"),
        (".UNITS METERS GONS\nC P1 1000 1000 100 ! ! !\nDB P1\n", "not a table of numbers"),
        ("Calibration results\n===================\n", "not a table of numbers"),
        (
            "*410004+0000000000000021 42....+0000BP04\n*110015+000000000000BP03 21.322+0000000016901313\n",
            "GSI of Leica",
        ),
        ("For M5|Adr     1|KD1  4 |Rb 1.1 m |HD 6.9 m |\n", "M5 of Zeiss or Trimble"),
        ("<?xml version='1.0'?>\n<ExportAPERO/>\n", "of MicMac"),
        ("Pix4D camera calibration file 0\nF 15.0\nPx 8.4\nPy 6.3\n", "camera of Pix4D"),
        ("target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 6\n", "pattern: {type: aprilgrid"),
    ],
)
def test_what_is_no_table_gets_no_mapping(text: str, words: str, tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "t.txt").write_text(text)
    ran = metrocli("import", tmp_path / "t.txt")
    assert (ran.code, ran.out, words in ran.err) == (3, "", True), ran.err


def test_a_unit_that_the_file_does_not_state_must_be_written(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "t.txt").write_text("P1 1.5 2.5 3.5\nP2 1.6 2.6 3.6\n")
    mapping = metrocli("import", tmp_path / "t.txt").out.replace("multilaterate", "fit-points")
    for number, quantity in ((1, "point"), (2, "x"), (3, "y"), (4, "z")):
        mapping = mapping.replace(f"QUANTITY{number}", quantity)
    (tmp_path / "map.yaml").write_text(mapping.replace("input: lengths", "input: points"))
    ran = metrocli("import", tmp_path / "t.txt", "--map", tmp_path / "map.yaml")
    assert (ran.code, "x is a length and has the unit 'UNIT'" in ran.err) == (3, True), ran.err
