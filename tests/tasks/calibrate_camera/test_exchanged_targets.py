"""Names of two targets that are exchanged in one image of a network: nothing else is lost, and they are named."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tasks.shared.images import small_jobs

from benchmarks.halves import board_job, simulated
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.mistakes import misread
from metrocli.errors import NotConvergedError, UndeterminedError
from metrocli.formats import csv
from metrocli.table import Table
from metrocli.tasks.calibrate_camera import task as calibrate_camera
from metrocli.tasks.calibrate_camera.settings import Files, Settings
from metrocli.tasks.job import Job
from metrocli.tasks.shared.images.search import OBSERVATIONS

SIZE = (2592, 1944)
SWAPS = [("i03", "T3", "T40"), ("i04", "T5", "T70"), ("i02", "T0", "T116")]


def network(*swaps: tuple[str, str, str], outliers: str = "report") -> Job[Settings, Files]:
    """Return five images of unknown targets, with names of targets exchanged in some of them."""
    job = simulated(np.random.default_rng([145, 1]), 5, 0.3)
    seen, listed = job.files.observations, job.files.targets
    assert seen is not None and listed is not None
    image, target = np.array(seen.texts("image")), np.array(seen.texts("target"), dtype=object)
    for where, first, second in swaps:
        rows = [np.flatnonzero((image == where) & (target == name))[0] for name in (first, second)]
        target[rows] = target[rows[::-1]]
    job = board_job(seen.changed({"target": target.astype(str)}), listed, SIZE)
    settings = replace(job.settings, rig="network", noise=0.05, outliers=outliers)
    return replace(job, settings=settings)


@pytest.mark.parametrize("swap", SWAPS)
def test_two_exchanged_names_take_no_right_reading_along(swap: tuple[str, str, str]) -> None:
    """The wrong reading of a target pulled it so far away that four right ones of it were left out as well."""
    image, first, second = swap
    rejected = calibrate_camera.run(network(swap, outliers="remove")).tables["rejected"]
    assert rejected.texts("image") == [image] * 2 and set(rejected.texts("target")) == {first, second}


@pytest.mark.parametrize("swaps", [SWAPS[:1], SWAPS[:2]])
def test_exchanged_names_are_found_in_one_image_and_in_two(swaps: list[tuple[str, str, str]]) -> None:
    """A shape of the lens of 27 px, a tilt of its sensor and a skew of 7 percent were named instead."""
    right, wrong = network(), network(*swaps)
    mistake, other = next(iter(calibrate_camera.other_settings(wrong, fits=False)))
    assert mistake.words == " and ".join(
        f"{first} and {second} are exchanged in image {i}" for i, first, second in swaps
    )
    found, expected = (job.files.observations for job in (other, right))
    assert isinstance(found, Table) and isinstance(expected, Table)
    assert found.texts("target") == expected.texts("target")
    assert list(calibrate_camera.other_settings(right, fits=True)) == []
    assert not [m for m, _ in calibrate_camera.other_settings(right, fits=False) if "exchanged" in m.words]


def test_the_calibration_refuses_exchanged_names_and_states_what_to_write() -> None:
    wrong = network(SWAPS[0])

    def adjusted(inputs: Mapping[str, object]) -> AdjustedJob:
        return calibrate_camera.diagnosed(replace(wrong, files=Files(**inputs)))  # type: ignore[arg-type]

    with pytest.raises(NotConvergedError) as failed:
        adjusted(vars(wrong.files))
    refusal = misread(vars(wrong.files), adjusted, failed.value, partial(calibrate_camera.TASK.others, wrong))
    assert refusal is not None and "T3 and T40 are exchanged in image i03" in refusal.faults[0].message
    assert str(refusal.faults[0].hint) == "write T40 for T3 and T3 for T40 in the rows of i03"


@pytest.mark.parametrize(
    ("kind", "image"),
    [pytest.param("network", "view02.png", marks=pytest.mark.slow), ("board", "view03.png"), ("turned", "image5")],
)
def test_names_that_stand_one_row_too_high_are_named(
    tmp_path: Path, metrocli: Callable[..., Any], kind: str, image: str
) -> None:
    """More images were advised for a network, and a board was clean but for a noise of 1000 times that declared."""
    path, seen = getattr(small_jobs, kind)(tmp_path), tmp_path / "observations.csv"
    table = csv.read(seen, OBSERVATIONS)
    names, rows = np.array(table.texts("target")), np.flatnonzero(np.array(table.texts("image")) == image)
    names[rows] = np.roll(names[rows], -1)
    csv.write(seen, table.changed({"target": names}))
    ran = metrocli("diagnose", path, "--quick")
    assert f"the names of targets in the rows of image {image} stand one row too high" in ran.out, ran.err


def test_readings_that_keep_the_others_from_being_adjusted_are_named() -> None:
    """Without a word on them the calibration ended, or advised more images from other directions."""
    wrong = network(SWAPS[1])
    settings = replace(wrong.settings, noise="estimated")
    with pytest.raises(
        (UndeterminedError, NotConvergedError), match=r"(?s)the points i04/T5, i04/T70 do not fit"
    ) as failed:
        calibrate_camera.run(replace(wrong, settings=settings))
    assert "more images" not in str(failed.value)
