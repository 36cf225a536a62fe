"""metrocli verify: text, JSON, remarks, and exit codes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metrocli.formats import hdf5
from metrocli.record import Record
from metrocli.result import Result
from metrocli.table import Table

Metrocli = Callable[..., Any]
CORNERS = np.array([[0.0, 0, 0], [300, 0, 0], [0, 400, 0], [0, 0, 500]])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    columns = {"point": np.array(["A", "B", "C", "D"])} | dict(zip("xyz", CORNERS.T, strict=True))
    columns |= {f"s{axis}": np.full(4, 0.01) for axis in "xyz"}
    points = Table(columns, dict.fromkeys(("x", "y", "z", "sx", "sy", "sz"), "mm"))
    covariance = np.broadcast_to(1e-4 * np.eye(3), (4, 3, 3)).copy()
    result = Result(
        "multilaterate", "", (), np.zeros((0, 0)), {}, {"points": points}, {"points_covariance": covariance}
    )
    hdf5.write(tmp_path / "r.h5", result, Record("", (), "0", "2026-01-01T00:00:00Z"))
    empty = Result("align-part", "", (), np.zeros((0, 0)), {})
    hdf5.write(tmp_path / "none.h5", empty, Record("", (), "0", "2026-01-01T00:00:00Z"))
    (tmp_path / "lengths.csv").write_text("from,to,length_mm,sigma_mm\nA,B,300.03,0.01\nB,C,499.96,0\n")
    (tmp_path / "points.csv").write_text("point,x_mm,y_mm,z_mm\nA,0,0,0.03\nB,300,0,0\nC,0,400.01,0\n")
    return tmp_path


def test_json_of_lengths(folder: Path, metrocli: Metrocli) -> None:
    ran = metrocli("verify", folder / "r.h5", folder / "lengths.csv", "--json")
    found = json.loads(ran.out)
    assert ran.code == 0
    first, second = 2 * np.sqrt(3) * 0.01, 2 * np.sqrt(2) * 0.01
    expected = [("A - B", 0.03, first), ("B - C", -0.04, second)]
    assert found["points"] == [
        {
            "point": name,
            "deviation": pytest.approx(value),
            "unit": "mm",
            "U": pytest.approx(u),
            "en": pytest.approx(abs(value) / u),
        }
        for name, value, u in expected
    ]
    assert found["mean"] == pytest.approx(-0.005)
    assert found["rms"] == pytest.approx(np.sqrt((9 + 16) / 2) / 100)
    assert found["largest"] == pytest.approx(0.04)
    assert found["inside"] == 0.5
    assert found["max_en"] == pytest.approx(0.04 / second)


def test_length_errors_against_an_mpe(folder: Path, metrocli: Metrocli) -> None:
    """By hand: errors of -30 and +40 um, U of 20 and 0 um, MPE of 30 um + 60 um/m: 48 and 60 um (to 0.1 um)."""
    files = (folder / "r.h5", folder / "lengths.csv")
    found = json.loads(metrocli("verify", *files, "--mpe", "30 um + 60 um/m", "--json").out)
    first, second = found["length_errors"]
    assert (first["error"], first["mpe"], first["U"]) == pytest.approx((-0.03, 0.0480018, 0.02))
    assert (second["error"], second["mpe"], second["U"]) == pytest.approx((0.04, 0.0599976, 0.0))
    assert [one["conforms"] for one in (first, second)] == ["undecided", "yes"]
    assert found["mpe_ratio"] == pytest.approx(0.05 / 0.0480018)
    ran = metrocli("verify", *files, "--mpe", "30 um + 60 um/m", "--require", "mpe_ratio <= 1")
    assert ran.code == 6 and "required mpe_ratio <= 1: NOT met (1.042)" in ran.err
    assert "ISO 10360-2:2009 has 105" in ran.out
    assert metrocli("verify", *files, "--mpe", "0.06 mm", "--require", "mpe_ratio <= 1").code == 0
    tight = json.loads(metrocli("verify", *files, "--mpe", "5 um", "--json").out)["length_errors"]
    assert [one["conforms"] for one in tight] == ["no", "no"]
    assert metrocli("verify", *files, "--require", "mpe_ratio <= 1").code == 2
    for wrong in ("30", "30 um + 2 kg", "0 um", "1 um + 1 um/m + 1 um"):
        ran = metrocli("verify", *files, "--mpe", wrong)
        assert ran.code == 2 and "write e.g. '1.5 um + 3 um/m'" in ran.err
    (folder / "none.csv").write_text("from,to,length_mm,sigma_mm\nA,B,300,0.01\nB,C,0,0\n")
    ran = metrocli("verify", folder / "r.h5", folder / "none.csv", "--mpe", "0 um + 3 um/m")
    assert ran.code == 3 and "none.csv:3" in ran.err and "the MPE of this length is zero" in ran.err
    ran = metrocli("verify", folder / "r.h5", folder / "points.csv", "--mpe", "5 um")
    assert ran.code == 3 and "points.csv: error: --mpe needs lengths" in ran.err


def test_few_degrees_of_freedom_have_the_t_factor(folder: Path, metrocli: Metrocli) -> None:
    """t(95.45 %) of 5 degrees of freedom is 2.65; the share of the calibrated length counts as certain."""
    result, record = hdf5.read(folder / "r.h5")
    few = replace(result, statistics={"noise_estimated": True, "dof": 5})
    hdf5.write(folder / "few.h5", few, record)
    ran = metrocli("verify", folder / "few.h5", folder / "lengths.csv")
    assert "the result has 5 degrees of freedom: U has the t factor, up to 1.32 times that of many" in ran.out
    assert "degrees of freedom" not in metrocli("verify", folder / "r.h5", folder / "lengths.csv").out


def test_a_requirement_that_is_not_met_ends_with_6(folder: Path, metrocli: Metrocli) -> None:
    ran = metrocli("verify", folder / "r.h5", folder / "lengths.csv", "--require", "max_en < 1")
    assert ran.code == 6
    assert "required max_en < 1: NOT met (1.414)" in ran.err
    assert "inside U: 50 %" in ran.out and "A - B" in ran.out
    assert metrocli("verify", folder / "r.h5", folder / "lengths.csv", "--require", "inside >= 0.5").code == 0
    assert metrocli("verify", folder / "r.h5", folder / "lengths.csv", "--require", "p_value > 1").code == 2
    assert metrocli("verify", folder / "r.h5", folder / "lengths.csv", "--require", "max_en < 1e").code == 2


def test_aligned_points_are_taken_as_they_are(folder: Path, metrocli: Metrocli) -> None:
    ran = metrocli("verify", folder / "r.h5", folder / "points.csv", "--aligned", "--json")
    rows = json.loads(ran.out)["points"]
    assert [row["deviation"] for row in rows] == pytest.approx([0.03, 0.0, 0.01])
    # k of three components, with 10 um each
    assert [row["U"] for row in rows] == pytest.approx([0.028329] * 3, rel=1e-4)
    assert rows[0]["vector"] == pytest.approx([0.0, 0.0, 0.03])
    assert "no column 'sigma_mm'" in ran.err
    laid = json.loads(metrocli("verify", folder / "r.h5", folder / "points.csv", "--json").out)
    # three points are laid in their plane: only their distances can deviate
    assert laid["largest"] < 0.01


def test_wrong_files_are_refused_with_row_and_reason(folder: Path, metrocli: Metrocli) -> None:
    (folder / "wrong.csv").write_text("from,to,length_mm,sigma_mm\nA,Q,300,0.01\nB,C,500,-1\n")
    ran = metrocli("verify", folder / "r.h5", folder / "wrong.csv")
    assert ran.code == 3 and "wrong.csv:3:" in ran.err
    (folder / "wrong.csv").write_text("from,to,length_mm,sigma_mm\nA,Q,300,0.01\nB,B,500,1\n")
    ran = metrocli("verify", folder / "r.h5", folder / "wrong.csv")
    assert ran.code == 3 and "wrong.csv:2: error: the result has no point 'Q' (column 'to')" in ran.err
    ran = metrocli("verify", folder / "none.h5", folder / "points.csv")
    assert ran.code == 3 and "align-part predicts neither points" in ran.err
