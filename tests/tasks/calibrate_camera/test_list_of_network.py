"""What a wrong list of targets does to a network whose targets are all unknown, and what a wrong scale does."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metrocli.formats import hdf5

Metrocli = Callable[..., Any]


@pytest.mark.slow
def test_the_result_follows_a_target_and_not_its_list_but_a_wrong_scale_is_its_error(
    tmp_path: Path, metrocli: Metrocli
) -> None:
    assert metrocli("init", tmp_path / "p", "--sample", "raw-part").code == 0
    job = tmp_path / "p/jobs/photogrammetry.yaml"
    assert metrocli("calibrate-camera", job).code == 0
    found = hdf5.read(tmp_path / "p/results/photogrammetry.h5")[0].tables["points"].stacked(("x", "y", "z"))
    candidates = json.loads(metrocli("diagnose", job, "--design", "--json").out)["candidates"]
    hides = {(one["name"], one["where"].get("target", "")): one["hides"] for one in candidates if one["hides"]}
    # a scale of 1 mm/m is the largest usual one; lengths are off by as much
    middle = np.linalg.norm(found - found.mean(axis=0), axis=1).max()
    assert hides["scale-of-targets", ""]["value"] == pytest.approx(1e3 * 1e-3 * middle, rel=0.02)
    # a target may be 5 mm from its place in the list in each direction: the list only gives the frame
    of_one = [one["value"] for (name, target), one in hides.items() if name == "moved-target" and target[0] != "S"]
    assert len(of_one) > 400
    assert max(of_one) < 0.05 * 5e3 * np.sqrt(3)
