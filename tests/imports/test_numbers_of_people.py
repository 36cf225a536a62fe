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
