"""The shared castings: the pose is that of a dense solver, wherever the casting stands."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import ROOT
from simulated.castings import Casting, turn
from tasks.fit_part.test_fit import SCALE, Metrocli, dense, even, fitted, largest_least, moved, pose_of

CASES = ROOT.parent / "shared" / "cases" / "fit-part"


@pytest.mark.skipif(not CASES.is_dir(), reason="../shared/cases/fit-part is not there")
@pytest.mark.parametrize("number", ["001", "002", "003", "004"])
def test_a_shared_casting(number: str, tmp_path: Path, metrocli: Metrocli) -> None:
    folder = CASES / number
    rows: list[dict[str, Any]] = list(csv.DictReader((folder / "points.csv").read_text().splitlines()))
    points = np.array([[float(row[f"{axis}_mm"]) for axis in "xyz"] for row in rows])
    truth = json.loads((folder / "truth.json").read_text())["pose"]
    pose = np.array([truth[name] for name in ("x", "y", "z", "alpha", "beta", "gamma")])
    one = Casting(pose, np.array([row["surface"] for row in rows]), points, points, points[:0], 0.05)
    for name in ("job.yaml", "part.yaml", "points.csv"):
        (tmp_path / name).write_text((folder / name).read_text())
    result = fitted(tmp_path / "job.yaml", metrocli, "--output", str(tmp_path / "part.h5"))
    found = pose_of(result)
    if "least-motion" in (folder / "job.yaml").read_text():
        value, best = moved(one), dense(one, found, moved(one), 0.5)
    else:
        value, best = even(one), dense(one, pose, even(one), 0.5)
        assert np.abs((found - best) / SCALE).max() < 5e-3
    assert value(found) <= value(best) * (1 + 1e-6)
    assert one.overstock_at(found).min() >= 0.5 - 1e-9
    # the points of 004 leave more than the minimum, although its README calls it infeasible
    assert result.statistics["largest_least_overstock"] == pytest.approx(largest_least(one, pose)[1], abs=1e-6)
    assert np.abs(turn(found[3:]) - turn(pose[3:])).max() < 0.01
