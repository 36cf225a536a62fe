"""A wrong image size beside a table of readings: the readings of the true camera show where its principal point is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tasks.shared.images import small_jobs

from benchmarks.coverage import TRUE_LENS
from metrocli.formats import hdf5

Metrocli = Callable[..., Any]
TRUE = np.array([TRUE_LENS["cx"], TRUE_LENS["cy"]])
HELD = "camera.estimate=[f, k1, k2, p1, p2]"


def numbers_in(text: str, after: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return the two numbers in brackets that follow some words."""
    inside = text.split(after)[1].split(")")[0].split("(")[1]
    return np.array([float(word.partition("±")[0]) for word in inside.split(",")])


def rows(path: Path) -> list[str]:
    return [row for row in hdf5.read(path)[0].tables["not_controlled"].texts("effect") if "image_size" in row]


def test_an_estimated_principal_point_needs_no_word_about_the_image_size(metrocli: Metrocli, tmp_path: Path) -> None:
    ran = metrocli("calibrate-camera", small_jobs.board(tmp_path))
    assert ran.code == 0 and "principal point" not in ran.out + ran.err
    assert not rows(tmp_path / "camera.h5")


def test_one_far_from_the_middle_is_a_warning(metrocli: Metrocli, tmp_path: Path) -> None:
    ran = metrocli("calibrate-camera", small_jobs.board(tmp_path), "--set", "camera.image_size=[5184, 3888]")
    assert ran.code == 0
    assert "lies far from the middle (2591.5, 1943.5) px of an image of 5184 x 3888 px" in ran.out + ran.err
    assert numbers_in(ran.out + ran.err, "the principal point") == pytest.approx(TRUE, abs=2)


def test_one_held_where_the_readings_do_not_see_it_makes_the_result_doubtful(
    metrocli: Metrocli, tmp_path: Path
) -> None:
    """Without the check f is wrong by a tenth and more, with `noise: estimated` and no other sign of it."""
    job = small_jobs.board(tmp_path)
    ran = metrocli(
        "calibrate-camera", job, "--set", "camera.image_size=[5184, 3888]", "--set", HELD, "--set", "noise=estimated"
    )
    assert ran.code == 6
    assert "held at (2591.5, 1943.5) px" in ran.out + ran.err
    assert numbers_in(ran.out + ran.err, "the readings see it at") == pytest.approx(TRUE, abs=2)
    assert rows(tmp_path / "camera.h5")


def test_one_held_near_the_true_one_is_a_warning_and_what_is_left_is_not_controlled(
    metrocli: Metrocli, tmp_path: Path
) -> None:
    job = small_jobs.board(tmp_path)
    ran = metrocli("calibrate-camera", job, "--set", HELD)
    assert "held at (1295.5, 971.5) px" in ran.out + ran.err
    true = metrocli(
        "calibrate-camera", job, "--set", HELD, "--set", f"camera.cx={TRUE[0]} px", "--set", f"camera.cy={TRUE[1]} px"
    )
    assert true.code == 0 and "held at" not in true.out + true.err
    assert rows(tmp_path / "camera.h5")
