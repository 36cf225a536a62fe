"""metrocli compare: text, JSON, shared inputs, and the exit code of a requirement."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metrocli.formats import hdf5
from metrocli.record import InputFile, Record
from metrocli.result import Estimate, Result

Metrocli = Callable[..., Any]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, value, digest in (("a", 1.0, "11"), ("b", 1.5, "11"), ("c", 1.1, "22")):
        estimate = Estimate("T1.x", value, 0.1, "mm")
        result = Result("multilaterate", "", (estimate,), np.array([[0.01]]), {})
        inputs = (InputFile("points.csv", digest, 5),)
        hdf5.write(tmp_path / f"{name}.h5", result, Record("", inputs, "0", "2026-01-01T00:00:00Z"))
    return tmp_path


def test_json_has_difference_uncertainty_and_test(folder: Path, metrocli: Metrocli) -> None:
    ran = metrocli("compare", folder / "a.h5", folder / "b.h5", "--json")
    found = json.loads(ran.out)
    assert ran.code == 0
    row = found["estimates"]["T1.x"]
    assert row == {
        "difference": pytest.approx(0.5),
        "std": pytest.approx(0.1 * 2**0.5),
        "unit": "mm",
        "en": pytest.approx(0.5 / (0.2 * 2**0.5)),
    }
    assert found["chi2"] == pytest.approx(12.5)
    assert found["dof"] == 1
    assert found["p_value"] == pytest.approx(4.07e-4, rel=1e-3)
    assert found["shared"] == ["points.csv"]
    assert json.loads(metrocli("compare", folder / "a.h5", folder / "c.h5", "--json").out)["shared"] == []


def test_a_requirement_that_is_not_met_ends_with_6(folder: Path, metrocli: Metrocli) -> None:
    ran = metrocli("compare", folder / "a.h5", folder / "b.h5", "--require", "max_en < 1")
    assert ran.code == 6
    assert "T1.x" in ran.out and "points.csv" in ran.out
    assert "required max_en < 1: NOT met (1.768)" in ran.err
    ran = metrocli("compare", folder / "a.h5", folder / "c.h5", "--require", "p_value > 0.05")
    assert ran.code == 0 and "no input in common; the uncertainties count as independent" in ran.out
    assert metrocli("compare", folder / "a.h5", folder / "c.h5", "--require", "en < 1").code == 2
    assert metrocli("compare", folder / "a.h5", folder / "none.h5").code == 3


def test_repeated_calibrations(folder: Path, metrocli: Metrocli) -> None:
    files = [folder / f"{name}.h5" for name in "acb"]
    found = json.loads(metrocli("compare", *files, "--days", "0,100,200", "--json").out)
    row = found["drift"]["estimates"]["T1.x"]
    assert row["rate"] == pytest.approx(0.0025) and row["unit"] == "mm/d"
    assert row["std"] == pytest.approx(0.1 / np.sqrt(2e4))
    assert found["pooled"][0] | {"std": 0} == {"group": "estimates", "unit": "mm", "std": 0, "expected": 0.1, "dof": 2}
    assert found["pooled"][0]["std"] == pytest.approx(np.std([1.0, 1.1, 1.5], ddof=1))
    assert [one["max_en"] for one in found["calibrations"]] == pytest.approx(
        [0, 0.1 / 0.2 / 2**0.5, 0.5 / 0.2 / 2**0.5]
    )
    ran = metrocli("compare", *files, "--require", "max_drift_en < 1")
    assert ran.code == 6 and "drift per calibration" in ran.out and "T1.x" in ran.out
    for days in ("0,1", "0,nan,2", "0,1,inf"):
        assert metrocli("compare", *files, "--days", days).code == 2
    assert metrocli("compare", folder / "a.h5").code == 2
