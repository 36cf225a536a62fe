"""Targets in another unit fit a camera as well; where they are nearer than its focal length, the result is doubtful."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tasks.shared.images import small_jobs

Metrocli = Callable[..., Any]


def divided(file: Path, factor: float) -> None:
    """Write the places of a list as numbers of another unit, and leave the rest."""
    header, *rows = file.read_text().splitlines()
    at = [header.split(",").index(f"{axis}_mm") for axis in "xyz"]
    cells = np.array([row.split(",") for row in rows], dtype=object)
    cells[:, at] = (cells[:, at].astype(float) / factor).astype(str)
    file.write_text("\n".join([header, *map(",".join, cells)]) + "\n")


@pytest.mark.parametrize("rig", ["board", "cmm"])
def test_a_list_in_metres_read_as_millimetres(rig: str, tmp_path: Path, metrocli: Metrocli) -> None:
    job = getattr(small_jobs, rig)(tmp_path)
    assert metrocli("calibrate-camera", job).code == 0
    divided(tmp_path / "targets.csv", 1000)
    ran = metrocli("calibrate-camera", job)
    assert ran.code == 6, (ran.out, ran.err)
    assert "nearer than its focal length" in ran.out + ran.err


def test_a_pixel_size_in_millimetres(tmp_path: Path, metrocli: Metrocli) -> None:
    job = small_jobs.board(tmp_path)
    ran = metrocli("calibrate-camera", job, "--set", "camera.pixel_size=2.2 mm")
    assert ran.code == 6, (ran.out, ran.err)
    assert "check the unit of the targets, or the pitch, and pixel_size" in ran.out + ran.err


@pytest.mark.slow
def test_a_wrong_lens_is_no_wrong_unit(tmp_path: Path, metrocli: Metrocli) -> None:
    """Places with a sigma that become smaller yield to any reading, which is not a sign of another unit."""
    assert metrocli("init", tmp_path / "part", "--sample", "raw-part").code == 0
    ran = metrocli("calibrate-camera", tmp_path / "part/jobs/camera.yaml", "--set", "camera.aspect=0.001")
    assert ran.code == 6, (ran.out, ran.err)
    assert "the model does not fit the readings" in ran.out + ran.err


def test_one_point_of_an_image_shows_no_mirror(tmp_path: Path, metrocli: Metrocli) -> None:
    """Images of one dot each were asked whether they are mirrored: four of them for one wrong reading."""
    job, seen = small_jobs.cmm(tmp_path), tmp_path / "observations.csv"
    header, row, *rows = seen.read_text().splitlines()
    column = header.split(",").index("u_px")
    cells = row.split(",")
    cells[column] = str(float(cells[column]) + 300.0)
    seen.write_text("\n".join([header, ",".join(cells), *rows]) + "\n")
    ran = metrocli("calibrate-camera", job)
    assert ran.code == 6 and "mirrored" not in ran.out and ran.out.count("they pull all other values") == 1, ran.out
