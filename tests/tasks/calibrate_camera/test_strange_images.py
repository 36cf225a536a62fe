"""An image that is mirrored, or whose targets are in another order, is named, whatever it makes of the adjustment."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.halves import board_job, selected, simulated
from benchmarks.references import DATA, network_job
from metrocli.diagnosis.other_settings import with_other_setting
from metrocli.errors import InputError, NotConvergedError, UndeterminedError
from metrocli.geometry.rotations import rotation_from_vector
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.calibrate_camera import task as calibrate_camera
from metrocli.tasks.calibrate_camera.settings import Files, Settings
from metrocli.tasks.job import Job

SIZE = (2592, 1944)
MIDDLE = (("u", 648.0), ("v", 486.0))
ODD = "image i03 fits no view of a flat board"


def measured(seed: int, wrong: bool, **changed: object) -> Job[Settings, Files]:
    """Return eight images of a board, of which one has the names of its targets in another order."""
    job = simulated(np.random.default_rng([145, seed]), 8, 0.3)
    seen, listed = job.files.observations, job.files.targets
    assert seen is not None and listed is not None
    target, image = np.array(seen.texts("target")), np.array(seen.texts("image"))
    if wrong:
        mine = image == "i03"
        target[mine] = np.roll(target[mine], [1, 13, 58][seed % 3])
    named = Table({**seen.columns, "target": target}, seen.units)
    job = board_job(named, listed, SIZE)
    return replace(job, settings=replace(job.settings, **changed))  # type: ignore[arg-type]


def words(job: Job[Settings, Files]) -> str:
    """Return the message of a failed calibration, or the doubts of its result."""
    try:
        result: Result = calibrate_camera.run(job)
    except (UndeterminedError, NotConvergedError, InputError) as error:
        return str(error)
    return "\n".join(result.doubts)


@pytest.mark.alike
@pytest.mark.parametrize("seed", range(3))
def test_an_image_with_names_in_another_order_is_named(seed: int) -> None:
    text = words(measured(seed, wrong=True))
    assert ODD in text and text.count("fits no view") == 1
    assert "more images" not in text and "image_size and the poses" not in text


def test_right_images_are_not_named_and_a_wrong_one_can_be_left_out() -> None:
    assert words(measured(0, wrong=False)) == ""
    assert words(measured(0, wrong=True, outliers="remove")) == ""


def test_a_few_wrong_readings_make_no_image_strange() -> None:
    job = measured(7, wrong=False)
    seen = job.files.observations
    assert seen is not None
    u = seen.numbers("u").copy()
    u[[5, 40, 300, 301, 500]] += [300.0, -200, 150, 400, -90]
    spoilt = replace(job, files=replace(job.files, observations=Table({**seen.columns, "u": u}, seen.units)))
    assert "fits no view" not in words(spoilt)


def mirrored(job: Job[Settings, Files], one: str, width: int) -> Job[Settings, Files]:
    """Return a job of which one image is mirrored."""
    seen = job.files.observations
    assert seen is not None
    image, u = np.array(seen.texts("image")), seen.numbers("u")
    turned = np.where(image == one, width - 1 - u, u)
    return replace(job, files=replace(job.files, observations=Table({**seen.columns, "u": turned}, seen.units)))


@pytest.mark.parametrize("rig", ["board", "network"])
def test_a_mirrored_image_of_a_board_is_named(rig: str) -> None:
    """It fits the board seen from behind, so no residual shows it; of a network it was 44 times as noisy as others."""
    text = "image i05: the board is seen from the other side than in the others; mirrored?"
    assert text in calibrate_camera.run(mirrored(measured(2, wrong=False, rig=rig), "i05", SIZE[0])).warnings
    assert not [line for line in calibrate_camera.run(measured(2, wrong=False)).warnings if "other side" in line]


def listed_otherwise(factor: float, shift: float, rows: slice) -> Job[Settings, Files]:
    """Return eight images of a board, of which some targets are listed elsewhere."""
    right = measured(2, wrong=False)
    places = right.files.targets
    assert places is not None
    x = places.numbers("x").copy()
    x[rows] = x[rows] * factor + shift
    return replace(right, files=replace(right.files, targets=Table({**places.columns, "x": x}, places.units)))


def test_targets_that_lie_elsewhere_than_listed_are_named() -> None:
    """The images were named instead, or nothing, for an adjustment that did not converge."""
    job = listed_otherwise(1 / 25.4, 0.0, slice(30, 39))
    text = words(job)
    assert "9 targets lie elsewhere on the board than listed: T30 is seen near (79.9, 39.9, 0) mm" in text
    assert "check the rows of the list" in text and "fits no view" not in text


@pytest.mark.parametrize("rows", [slice(1, None, 2), slice(60, None)], ids=["every second row", "the second half"])
def test_half_of_a_list_in_inches_is_named(rows: slice) -> None:
    """Either half fits a view: nothing was named."""
    right = measured(2, wrong=False)
    places = right.files.targets
    assert places is not None
    inches = {f"{name} [mm]": places.numbers(name).copy() for name in ("x", "y")}
    for column in inches.values():
        column[rows] /= 25.4
    text = words(replace(right, files=replace(right.files, targets=places.joined(inches))))
    assert "targets fit the others with their coordinates times 25.4, as of numbers in inches" in text
    assert "give all rows of the list in one unit" in text and "elsewhere" not in text


@pytest.mark.parametrize("shift", [2.0, 7.0, 35.0])
@pytest.mark.parametrize("rows", [slice(1, None, 2), slice(60, None)], ids=["every second row", "the second half"])
def test_half_of_a_list_in_another_frame_is_named(shift: float, rows: slice) -> None:
    """It was done without a doubt, or lens and poses were not found."""
    text = words(listed_otherwise(1.0, shift, rows))
    assert "the list of targets has two groups, each of which agrees with the images only by itself" in text
    assert f"lie {shift:g} mm off against the other" in text
    assert "T60, T61" in text if rows.step is None else "T1, T3, T5" in text
    assert "elsewhere" not in text and "lens and poses" not in text


def test_a_turned_group_is_named_and_a_stretched_list_is_not() -> None:
    right = measured(2, wrong=False)
    places = right.files.targets
    assert places is not None
    x, y = places.numbers("x"), places.numbers("y")
    first = np.arange(len(x)) < 50

    def listed(x: NDArray[np.float64], y: NDArray[np.float64]) -> str:
        table = Table({**places.columns, "x": x, "y": y}, places.units)
        return words(replace(right, files=replace(right.files, targets=table)))

    turned = listed(np.where(first, x - 0.02 * y + 5.0, x), np.where(first, y + 0.02 * x, y))
    assert "50 targets (T0, T1, T2, T3 and 46 more)" in turned and "and turned by -1.1 deg" in turned
    for stretched in (listed(np.where(first, 1.1 * x, x), y), listed(x + (x / 60) ** 2, y)):
        assert "two groups" not in stretched


def test_a_target_that_spoils_all_images_a_little_is_doubted() -> None:
    """It was done, with k1 off by five standard uncertainties."""
    text = "readings of T30 in 8 of 8 images contradict the place that is listed"
    assert text in words(listed_otherwise(1.0, 3.0, slice(30, 31)))
    assert text in words(listed_otherwise(1.0, 100.0, slice(30, 31)))


def test_a_point_that_is_far_off_is_named_and_no_other_order() -> None:
    right = measured(2, wrong=False)
    seen = right.files.observations
    assert seen is not None
    u = seen.numbers("u").copy()
    at = int(np.argmax(u))
    u[at] -= 1000.0
    spoilt = replace(right, files=replace(right.files, observations=Table({**seen.columns, "u": u}, seen.units)))
    image, target = seen.texts("image")[at], seen.texts("target")[at]
    text = words(spoilt)
    assert f"points of image {image} are off the view" in text and f"{target} by 1000 px" in text
    assert "another order" not in text and "mirrored" not in text


def test_a_diagnosis_has_images_that_no_residual_shows() -> None:
    """It was clean, and listed nothing."""
    (noticed,) = calibrate_camera.diagnosed(mirrored(measured(2, wrong=False), "i05", SIZE[0])).noticed
    assert noticed.startswith("image i05: the board is seen from the other side")
    assert not calibrate_camera.diagnosed(measured(2, wrong=False)).noticed


def test_diagnose_states_which_image_has_its_targets_in_another_order() -> None:
    (noticed,) = calibrate_camera.diagnosed(measured(1, wrong=True)).noticed
    assert "fits no view of a flat board" in noticed and "another order" in noticed


def test_an_image_whose_u_and_v_are_exchanged_is_named() -> None:
    """It was done, with k2 wrong by 10 sigma, and its diagnosis had a law and wrong readings."""
    right = measured(2, wrong=False)
    seen = right.files.observations
    assert seen is not None
    there, u, v = np.array(seen.texts("image")) == "i05", seen.numbers("u"), seen.numbers("v")
    swapped = Table({**seen.columns, "u": np.where(there, v, u), "v": np.where(there, u, v)}, seen.units)
    job = replace(right, files=replace(right.files, observations=swapped))
    _, adjustment = calibrate_camera.with_adjustment(job)
    assert adjustment is not None and calibrate_camera.with_adjustment(right)[1] is None
    mistaken = with_other_setting(adjustment(), partial(calibrate_camera.TASK.others, job))
    assert mistaken is not None
    (wrong,) = mistaken.mistakes
    assert str(wrong) == "observations: u and v of image i05 are exchanged"
    assert wrong.write == "u as v and v as u of image i05"


def near_and_far(seed: int, tilt: float, order: int, estimated: tuple[str, ...]) -> Job[Settings, Files]:
    """Return a board of 48 x 32 targets, near in one image of nine and far in the others, behind a fisheye lens.

    In the near image the targets are named from the one with the number `order` on.
    """
    rng = np.random.default_rng([145, seed])
    x, y = (part.ravel() for part in np.meshgrid(np.arange(48) * 5.0, np.arange(32) * 5.0))
    board, names = np.stack([x, y, 0 * x], axis=1), np.array([f"T{i:04d}" for i in range(len(x))])
    parts = []
    for i in range(9):
        tilted = rotation_from_vector(np.append(rng.uniform(-tilt, tilt, 2), 0.0))
        turn = tilted @ rotation_from_vector(np.array([0.0, 0.0, rng.uniform(0, 6)]))
        seen = (board - board.mean(axis=0)) @ turn.T + [*rng.uniform(-20, 20, 2), rng.uniform(600, 900) if i else 220.0]
        ray = seen[:, :2] / seen[:, 2:]
        radius = np.linalg.norm(ray, axis=1, keepdims=True)
        u, v = (500 * ray * np.arctan(radius) / radius + [319.5, 239.5] + rng.normal(0, 0.1, ray.shape)).T
        shown = (u > 0) & (u < 639) & (v > 0) & (v < 479)
        own = np.roll(names, 0 if i else order)[shown]
        parts.append((np.full(shown.sum(), f"i{i}"), own, u[shown], v[shown]))
    image, target, u, v = (np.concatenate(column) for column in zip(*parts, strict=True))
    seen_targets = Table({"image": image, "target": target, "u": u, "v": v}, {"u": "px", "v": "px"})
    job = board_job(
        seen_targets, Table({"target": names, "x": x, "y": y, "z": 0 * x}, dict.fromkeys("xyz", "mm")), (640, 480)
    )
    settings = job.settings
    camera = replace(settings.camera, estimate=estimated) if estimated else settings.camera
    return replace(job, settings=replace(settings, camera=camera))


@pytest.mark.slow
def test_distortion_is_no_other_order() -> None:
    """Targets stand so densely that distortion moves them by a large part of a step."""
    parallel = words(near_and_far(8, 0.005, 0, ()))
    assert "all views are parallel" in parallel and "fits no view" not in parallel
    (doubt,) = words(near_and_far(9, 0.4, 0, ("f",))).splitlines()
    assert doubt.startswith("half of the points of image i0 are off by more than") and "lack distortion" in doubt
    assert "image i0 fits no view" in words(near_and_far(9, 0.4, 700, ()))


@pytest.mark.slow
@pytest.mark.parametrize("more", [0, 1])
def test_images_of_one_row_of_targets_are_in_no_other_order(more: int) -> None:
    """No homography follows from targets on a line, nor from one more."""
    job = near_and_far(10, 0.0, 0, ())
    seen = job.files.observations
    assert seen is not None
    image, number = np.array(seen.texts("image")), np.array([int(name[1:]) for name in seen.texts("target")])
    rows = (image > "i4") | ((number >= 480) & (number < 528)) | (number == 700) * bool(more)
    few = replace(job, files=replace(job.files, observations=selected(seen, rows)))
    text = words(few)
    assert text and "fits no view" not in text


def test_images_from_both_sides_are_listed() -> None:
    job = measured(2, wrong=False)
    for one in ("i01", "i05", "i06"):
        job = mirrored(job, one, SIZE[0])
    (text,) = [line for line in calibrate_camera.run(job).warnings if "other side" in line]
    assert text.startswith("images i01, i05, i06: the board is seen")


@pytest.mark.slow
@pytest.mark.skipif(not (DATA / "aicon-network").is_dir(), reason=f"no measured network at {DATA}")
def test_a_mirrored_image_of_a_network_makes_it_doubtful() -> None:
    """Every sixth image of a measured network: all other image points are off by 8 px with it."""
    job = network_job()
    seen = job.files.observations
    assert seen is not None
    image = np.array(seen.texts("image"))
    few = replace(job, files=replace(job.files, observations=selected(seen, np.isin(image, np.unique(image)[::6]))))
    assert not calibrate_camera.run(few).doubts
    (doubt,) = calibrate_camera.run(mirrored(few, str(np.unique(image)[6]), 8688)).doubts
    assert doubt.startswith(f"half of the points of image {np.unique(image)[6]} are off by more than")


def test_it_is_left_out_with_all_its_readings() -> None:
    """Its pose, which no reading is left to determine, is not an unknown then."""
    right = measured(0, wrong=False, outliers="remove")
    seen = right.files.observations
    assert seen is not None
    target, mine = np.array(seen.texts("target")), np.array(seen.texts("image")) == "i03"
    target[mine] = np.random.default_rng(146).permutation(target[mine])
    wrong = replace(right, files=replace(right.files, observations=seen.joined({"target [text]": target})))
    result, expected = calibrate_camera.run(wrong), calibrate_camera.run(right)
    assert result.tables["rejected"].texts("image").count("i03") == mine.sum() and result.doubts == ()
    assert not any("from the other side" in line for line in result.warnings)
    for found, of_right in zip(result.estimates[:2], expected.estimates[:2], strict=True):
        assert abs(found.value - of_right.value) < 3 * found.std


@pytest.mark.parametrize("convention", ["forward", "fisheye"])
def test_a_job_that_fails_before_its_adjustment_has_its_files_tried(convention: str) -> None:
    """What looks for mirrored images failed as the job did, and no correction of a file was tried."""
    job = measured(2, wrong=False)
    seen = job.files.observations
    assert seen is not None
    outside = Table({**seen.columns, "v": 2 * seen.numbers("v")}, seen.units)
    camera = replace(job.settings.camera, convention=convention)
    settings, files = replace(job.settings, camera=camera), replace(job.files, observations=outside)
    spoilt = replace(job, settings=settings, files=files)
    with pytest.raises(InputError, match="lie outside an image"):
        calibrate_camera.run(spoilt)
    assert calibrate_camera.TASK.others(spoilt, np.inf) == []


@pytest.mark.alike
def test_an_image_of_another_lens_leaves_a_network_and_takes_no_target_along() -> None:
    """Readings of targets that few images see left instead, until nothing determined these."""
    right = measured(1, wrong=False, outliers="remove", rig="network")
    seen = right.files.observations
    assert seen is not None
    mine = np.array(seen.texts("image")) == "i03"
    half = {f"{name} [px]": np.where(mine, seen.numbers(name) / 2 + at, seen.numbers(name)) for name, at in MIDDLE}
    result = calibrate_camera.run(replace(right, files=replace(right.files, observations=seen.joined(half))))
    assert result.tables["rejected"].texts("image").count("i03") == mine.sum()
    # in units of 1 px, where the noise is 0.05 px
    assert float(str(result.statistics["sigma0"])) == pytest.approx(0.05, rel=0.05)


@pytest.mark.parametrize("images", [2, 3])
def test_a_target_whose_readings_contradict_each_other_leaves_with_them(images: int) -> None:
    """Once a reading of two had left, nothing placed the target, and the whole network had no result."""
    right = measured(1, wrong=False, outliers="remove", rig="network")
    seen = right.files.observations
    assert seen is not None
    own = np.array(seen.texts("target")) == (name := seen.texts("target")[30])
    kept = ~own | np.isin(np.arange(len(seen)), np.flatnonzero(own)[:images])
    shifted = {
        f"{k} [px]": seen.numbers(k) + 40 * own * np.random.default_rng(n).normal(size=len(seen))
        for n, k in enumerate("uv")
    }
    spoilt = seen.joined(shifted).selected(kept)
    result = calibrate_camera.run(replace(right, files=replace(right.files, observations=spoilt)))
    rejected = result.tables["rejected"].texts("target")
    assert rejected == [name] * images and name not in result.tables["points"].texts("point")
    assert f"left out: 1 target is placed by fewer than two right readings: {name}" in result.warnings
    expected = calibrate_camera.run(replace(right, files=replace(right.files, observations=seen.selected(~own))))
    for found, without in zip(result.estimates, expected.estimates, strict=True):
        assert found.value == pytest.approx(without.value, abs=1e-4 * without.std)
        assert found.std == pytest.approx(without.std, rel=1e-5)
    # a scale bar needs its ends: then the readings that left are named as the reason
    bar = Table.of({"from": [name], "to": [seen.texts("target")[5]], "length [mm]": [100.0], "sigma [mm]": [50.0]})
    files = replace(right.files, observations=spoilt, scale_bars=bar)
    with pytest.raises(UndeterminedError, match=rf"(?s)of {name}.*readings left out as outliers.*of {name}"):
        calibrate_camera.run(replace(right, files=files))
