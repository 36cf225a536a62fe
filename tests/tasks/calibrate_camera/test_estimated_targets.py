"""`targets: estimate`: a board whose list is not exact is determined together with the camera."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from places import SHARED

from benchmarks.coverage import TRUE_LENS, Array, board, camera_settings
from metrocli.errors import UndeterminedError
from metrocli.result import Result
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.tasks.calibrate_camera import task as calibrate_camera
from metrocli.tasks.calibrate_camera.settings import Files, Settings
from metrocli.tasks.job import Job

Metrocli = Callable[..., Any]
SB = SHARED / "data" / "opencv-chessboards" / "left_SB"
ERROR = 0.2
"""Standard deviation of the printed board [mm]"""


def printed(seed: int) -> Table:
    """A board that is not as its list: every target is off in all directions."""
    listed = board()
    off = np.random.default_rng(seed).normal(0.0, ERROR, (len(listed), 3))
    places = listed.stacked(("x", "y", "z")) + off
    return Table({"target": listed.columns["target"], **dict(zip("xyz", places.T, strict=True))}, listed.units)


def calibrated(seed: int, **changed: object) -> Result:
    settings = camera_settings("board", images=12)
    job = calibrate_camera.TASK.job(settings, targets=printed(seed))
    seen = calibrate_camera.simulate(job, SimulationOptions(seed + 100)).files["observations.csv"]
    own: Settings = replace(settings, **changed)  # type: ignore[arg-type]
    return calibrate_camera.run(calibrate_camera.TASK.job(own, observations=seen, targets=board()))


def by_name(result: Result) -> dict[str, tuple[float, float]]:
    return {one.name: (one.value, one.std) for one in result.estimates}


def places(result: Result) -> Array:
    return result.tables["points"].stacked(("x", "y", "z"))


@pytest.fixture(scope="module")
def found() -> Result:
    return calibrated(1, targets="estimate")


@pytest.mark.slow
def test_the_camera_is_right_and_the_uncertainty_true() -> None:
    scores = []
    for seed in range(12):
        result = calibrated(seed, targets="estimate")
        scores += [(value - TRUE_LENS[name]) / std for name, (value, std) in by_name(result).items()]
        assert result.statistics["sigma0"] == pytest.approx(1.0, abs=0.15)
    assert np.mean(np.square(scores)) == pytest.approx(1.0, abs=0.45)


def test_as_listed_the_readings_contradict_the_board() -> None:
    assert calibrated(1).statistics["sigma0"] > 5
    assert "points" not in calibrated(1).tables


def test_it_is_the_free_network_of_the_same_targets(found: Result) -> None:
    """Rig network has the camera's pose in the frame of the targets: other equations of the same measurement."""
    network = calibrated(1, rig="network")
    for name, (value, std) in by_name(network).items():
        assert by_name(found)[name][0] == pytest.approx(value, abs=1e-6 * std)
        assert by_name(found)[name][1] == pytest.approx(std, rel=1e-6)
    assert places(found) == pytest.approx(places(network), abs=1e-7)
    assert found.arrays["points_covariance"] == pytest.approx(network.arrays["points_covariance"], rel=1e-5, abs=1e-12)
    for column in ("rays", "ray_angle"):
        assert found.tables["points"].numbers(column) == pytest.approx(network.tables["points"].numbers(column))
    assert found.statistics["datum"] == "inner constraints on the targets"


def test_the_list_gives_place_rotation_and_size(found: Result) -> None:
    listed = board().stacked(("x", "y", "z"))
    off, about = places(found) - listed, listed - listed.mean(axis=0)
    assert off.mean(axis=0) == pytest.approx(0.0, abs=1e-9)
    assert np.cross(about, off).sum(axis=0) == pytest.approx(0.0, abs=1e-5)
    assert (about * off).sum() == pytest.approx(0.0, abs=1e-5)
    assert np.sqrt((off**2).mean()) == pytest.approx(ERROR, rel=0.2)


def test_a_sigma_of_the_list_counts() -> None:
    listed = board()
    sigma = np.where(np.arange(len(listed)) < 4, 0.0, np.nan)
    own = Table({**listed.columns, "sigma": sigma}, {**listed.units, "sigma": "mm"})
    settings = replace(camera_settings("board", images=12), targets="estimate")
    seen = calibrate_camera.simulate(calibrate_camera.TASK.job(settings, targets=listed), SimulationOptions(3))
    result = calibrate_camera.run(
        calibrate_camera.TASK.job(settings, observations=seen.files["observations.csv"], targets=own)
    )
    assert result.tables["points"].numbers("sx")[:4] == pytest.approx(0.0, abs=1e-12)
    assert (result.tables["points"].numbers("sx")[4:] > 0).all()


@pytest.mark.parametrize("rig", ["board", pytest.param("network", marks=pytest.mark.slow)])
def test_a_flat_board_has_unknown_coordinates_in_its_plane_only(rig: str) -> None:
    listed, scores = board(), []
    unknown = {f"sigma_{axis}": np.full(len(listed), 0.0 if axis == "z" else np.nan) for axis in "xyz"}
    own = Table({**listed.columns, **unknown}, {**listed.units, **dict.fromkeys(unknown, "mm")})
    settings = camera_settings("board", images=12)
    for seed in range(3):
        flat = Table({**printed(seed).columns, "z": listed.numbers("z")}, listed.units)
        seen = calibrate_camera.simulate(calibrate_camera.TASK.job(settings, targets=flat), SimulationOptions(seed))
        job = calibrate_camera.TASK.job(
            replace(settings, targets="estimate", rig=rig), observations=seen.files["observations.csv"], targets=own
        )
        result = calibrate_camera.run(job)
        scores += [(value - TRUE_LENS[name]) / std for name, (value, std) in by_name(result).items()]
        off = places(result) - listed.stacked(("x", "y", "z"))
        assert off[:, 2] == pytest.approx(0.0, abs=1e-12)
        assert off.mean(axis=0) == pytest.approx(0.0, abs=1e-9)
        assert result.tables["points"].numbers("sz") == pytest.approx(0.0, abs=1e-12)
        assert (result.tables["points"].numbers("sx") > 0).all()
    assert np.mean(np.square(scores)) == pytest.approx(1.0, abs=0.6)


def test_a_target_in_one_image_is_left_out_with_its_name() -> None:
    settings = replace(camera_settings("board", images=12), targets="estimate")
    seen = calibrate_camera.simulate(calibrate_camera.TASK.job(settings, targets=board()), SimulationOptions(3))
    table = seen.files["observations.csv"]
    names, images = np.array(table.texts("target")), np.array(table.texts("image"))
    kept = (names != "T7") | (images == images[0])
    rest = Table({name: values[kept] for name, values in table.columns.items()}, table.units)
    result = calibrate_camera.run(calibrate_camera.TASK.job(settings, observations=rest, targets=board()))
    assert any("seen in one image only" in line and "T7" in line for line in result.warnings)
    assert "T7" not in result.tables["points"].texts("point")


@pytest.mark.parametrize("rig", ["board", "network"])
def test_one_image_places_no_target(rig: str) -> None:
    with pytest.raises(UndeterminedError, match="one image only shows each of them"):
        calibrate_camera.run(of_images(1, rig))


def test_outliers_that_were_nearly_all_readings_of_a_target_take_it_along() -> None:
    job = of_images(6, "board")
    table = job.files.observations
    assert table is not None
    u, names, images = table.numbers("u").copy(), np.array(table.texts("target")), np.array(table.texts("image"))
    wrong = (names == "T7") & (images != images[0])
    u[wrong] += np.random.default_rng(4).uniform(20, 60, wrong.sum())
    spoiled = replace(table, columns={**table.columns, "u": u})
    job = replace(
        job, files=replace(job.files, observations=spoiled), settings=replace(job.settings, outliers="remove")
    )
    result = calibrate_camera.run(job)
    assert any("fewer than two right readings: T7" in line for line in result.warnings)
    assert set(result.tables["rejected"].texts("target")) == {"T7"}
    assert "T7" not in result.tables["points"].texts("point")


def of_images(count: int, rig: str) -> Job[Settings, Files]:
    settings = replace(camera_settings("board", images=12), targets="estimate", rig=rig)
    seen = calibrate_camera.simulate(calibrate_camera.TASK.job(settings, targets=board()), SimulationOptions(3))
    table = seen.files["observations.csv"]
    images = np.array(table.texts("image"))
    kept = np.isin(images, np.unique(images)[:count])
    few = Table({name: values[kept] for name, values in table.columns.items()}, table.units)
    return calibrate_camera.TASK.job(settings, observations=few, targets=board())


def test_rig_cmm_refuses_it(folder: Path, metrocli: Metrocli) -> None:
    (folder / "o.csv").write_text("image,target,u_px,v_px\na,T1,1,1\n")
    (folder / "t.csv").write_text("target,x_mm,y_mm,z_mm\nT1,0,0,0\n")
    job = folder / "job.yaml"
    job.write_text(
        "metrocli: 1\njob: calibrate-camera\nrig: cmm\ninputs: {observations: o.csv, targets: t.csv}\n"
        "camera: {image_size: [640, 480]}\nnoise: 0.1 px\ntargets: estimate\noutput: r.h5\n"
    )
    ran = metrocli("calibrate-camera", job)
    assert ran.code == 3
    assert "rig: cmm sees each target from one place" in ran.err


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.skipif(not SB.parent.is_dir(), reason=f"no measured data at {SB.parent}")
def test_a_real_board_as_opencv_determines_it(folder: Path, metrocli: Metrocli) -> None:
    """OpenCV's calibrateCameraRO (Strobl and Hirzinger 2011) fixes three coordinates more; the camera is the same."""
    (folder / "job.yaml").write_text(
        "metrocli: 1\njob: calibrate-camera\nrig: board\n"
        f"inputs: {{observations: {SB}.observations.csv, targets: {SB}.targets.csv}}\n"
        "camera: {image_size: [640, 480], estimate: [f, cx, cy, k1, k2, p1, p2]}\n"
        "noise: estimated\ntargets: estimate\noutput: r.h5\n"
    )
    ran = metrocli("calibrate-camera", folder / "job.yaml", "--json")
    assert ran.code == 0, ran.err
    ours = json.loads(ran.out)["estimates"]
    theirs = released_object()
    for name, value in theirs.items():
        assert ours[name]["value"] == pytest.approx(value, abs=1e-3 * ours[name]["std"]), name


def released_object() -> dict[str, float]:
    """The camera by OpenCV, with an unknown board."""
    points = np.genfromtxt(f"{SB}.targets.csv", delimiter=",", skip_header=1, usecols=(1, 2, 3), dtype=np.float32)
    rows = np.genfromtxt(f"{SB}.observations.csv", delimiter=",", skip_header=1, dtype=None, encoding="utf-8")
    images = dict.fromkeys(row[0] for row in rows)
    seen = [np.array([(row[2], row[3]) for row in rows if row[0] == name], np.float32)[:, None] for name in images]
    held = ("ASPECT_RATIO", "K3", "K4", "K5", "K6", "S1_S2_S3_S4", "TAUX_TAUY")
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_DISABLE_SCHUR_COMPLEMENT
    for name in held:
        flags |= getattr(cv2, f"CALIB_FIX_{name}")
    start = np.array([[530.0, 0, 319.5], [0, 530, 239.5], [0, 0, 1]])
    end = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 500, 1e-15)
    _, matrix, terms, *_ = cv2.calibrateCameraRO(
        [points] * len(seen), seen, (640, 480), 8, start, np.zeros(5), flags=flags, criteria=end
    )
    lens = dict(zip(("k1", "k2", "p1", "p2"), terms.ravel()[:4].tolist(), strict=True))
    return {"f": float(matrix[0, 0]), "cx": float(matrix[0, 2]), "cy": float(matrix[1, 2]), **lens}
