"""Numbers with grouped digits, other encodings, and a mapping that is proposed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Metrocli = Callable[..., Any]
MAP = """job: multilaterate
input: points
{more}
columns:
  point: Punkt
  x: {{column: X, unit: mm}}
  y: {{column: Y, unit: mm}}
  z: {{column: Z, unit: mm}}
"""


@pytest.mark.parametrize(
    ("more", "text", "row"),
    [
        ("thousands: point\ndecimal: comma", "Punkt;X;Y;Z\nA;1.234,5;-12.345.678,25;7\n", "A,1234.5,-12345678.25,7"),
        ("thousands: comma\nseparator: semicolon", "Punkt;X;Y;Z\nA;1,234.5;7;-2,000\n", "A,1234.5,7,-2000"),
        ("thousands: apostrophe", "Punkt,X,Y,Z\nA,1'234.5,7,8\n", "A,1234.5,7,8"),
        ("thousands: space\ndecimal: comma", "Punkt;X;Y;Z\nA;1\u00a0234,5;1 000;8\n", "A,1234.5,1000,8"),
        ("header: 3", "Instrument: X\n\nPunkt,X,Y,Z\nA,1,2,3\n", "A,1,2,3"),
    ],
)
def test_they_are_read(more: str, text: str, row: str, tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "map.yaml").write_text(MAP.format(more=more))
    (tmp_path / "in.txt").write_text(text, encoding="utf-8")
    ran = metrocli(
        "import", tmp_path / "in.txt", "--from", "columns", "--map", tmp_path / "map.yaml", "--out", tmp_path
    )
    assert ran.code == 0, ran.err
    assert (tmp_path / "points.csv").read_text().splitlines()[-1] == row


@pytest.mark.parametrize("encoding", ["latin-1", "cp1252", "utf-16"])
def test_encodings(encoding: str, tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "map.yaml").write_text(MAP.format(more=f"encoding: {encoding}"))
    (tmp_path / "in.txt").write_bytes("Punkt,X,Y,Z\r\nSüd,1,2,3\r\n".encode(encoding))
    ran = metrocli(
        "import", tmp_path / "in.txt", "--from", "columns", "--map", tmp_path / "map.yaml", "--out", tmp_path
    )
    assert ran.code == 0, ran.err
    assert (tmp_path / "points.csv").read_text(encoding="utf-8").splitlines()[-1] == "Süd,1,2,3"


def test_a_group_of_two_digits_is_no_number(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "map.yaml").write_text(MAP.format(more="thousands: comma\nseparator: semicolon"))
    (tmp_path / "in.txt").write_text("Punkt;X;Y;Z\nA;1,23;7;8\n")
    ran = metrocli(
        "import", tmp_path / "in.txt", "--from", "columns", "--map", tmp_path / "map.yaml", "--out", tmp_path
    )
    assert ran.code == 3 and "'1,23' is not a number" in ran.err


def test_a_mapping_is_proposed(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "in.txt").write_text("Instrument: X\n\nPt;Dist;Temp\n1;1000,25;20,1\n2;1001,5;20,2\n")
    ran = metrocli("import", tmp_path / "in.txt")
    assert ran.code == 0
    for words in (
        "separator: semicolon",
        "decimal: comma",
        "header: 3",
        "{column: 2, unit: UNIT}  # Dist, e.g. 1000,25",
    ):
        assert words in ran.out


def test_angles_in_degrees_minutes_and_seconds(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "map.yaml").write_text(
        "job: adjust-network\ninput: readings\nseparator: space\nheader: none\ncolumns:\n  station: {value: S}\n"
        "  point: {column: 1}\n  hz: {column: 2, unit: d.mmss}\n  zd: {column: 3, unit: d.mmss}\n  d: {column: 4, unit: m}\n"
    )
    (tmp_path / "in.txt").write_text("1 73.0632 90.2450 3.513\n2 21.0602 56.30 4.696\n3 -0.00001 100 5\n")
    words = ("import", tmp_path / "in.txt", "--map", tmp_path / "map.yaml", "--out", tmp_path / "out")
    assert metrocli(*words).code == 0
    rows = [line.split(",") for line in (tmp_path / "out" / "readings.csv").read_text().splitlines()[1:]]
    assert rows[0] == ["station", "point", "hz_deg", "zd_deg", "d_m"]
    read = [[float(cell) for cell in row[2:4]] for row in rows[1:]]
    expected = [
        [73 + 6 / 60 + 32 / 3600, 90 + 24 / 60 + 50 / 3600],
        [21 + 6 / 60 + 2 / 3600, 56.5],
        [-0.1 / 3600, 100.0],
    ]
    assert all(
        abs(a - b) < 1e-9 for one, other in zip(read, expected, strict=True) for a, b in zip(one, other, strict=True)
    )
    (tmp_path / "in.txt").write_text("1 73.0662 90.2450 3.513\n2 21.7002 56.30 4.696\n")
    ran = metrocli(*words)
    assert ran.code == 3 and "'73.0662' is not an angle in d.mmss" in ran.err and "'21.7002'" in ran.err
